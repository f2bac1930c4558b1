"""Contact-phase postures, grasp phase, approach, torques: round trips, finite differences, energy balance."""

from __future__ import annotations

import math

import numpy as np
import pinocchio as pin
import pytest
from conftest import POINTS

from pinograsp.contacts import Contact, ContactSet, Friction, PenetrationProfile, contacts_at
from pinograsp.errors import ContactNotReached, InvalidInput, Status
from pinograsp.forces import ForceProblem, GraspConditions, GridSpec, grid_search
from pinograsp.hands import load_hand
from pinograsp.hands.catalogue import file_of
from pinograsp.motion import MotionSpec, contact_postures, plan_motion, preload_slope
from pinograsp.motion.approach import approach
from pinograsp.motion.grasp_ik import ContactPath, press_points
from pinograsp.motion.jacobian import point_jacobian
from pinograsp.motion.torques import contact_torques, inverse_dynamics
from pinograsp.objects import Sphere
from pinograsp.spatial import pose_of, tangent_frame


def on_link(hand, finger, q, link, length):
    """World position of the point at ``length`` along a link (its x axis in the paper's hand)."""
    placement = hand.frame_placements(q, [hand.finger(finger).links[link]])[0]
    return placement[:3, :3] @ [length, 0, 0] + placement[:3, 3]


# -- contact phase -----------------------------------------------------------------------------------------------------


def test_table_iv_comes_back(hand, contacts, final_angles):
    """Eqs. (1)-(3): the published final angles are among the candidates, and all candidates reach the points."""
    found = contact_postures(hand, contacts, reference=final_angles)
    assert list(found) == ["thumb", "index", "middle"]
    for name, postures in found.items():
        assert postures.method == "closed form"
        assert len(postures.angles) >= 10
        assert np.abs(postures.angles - final_angles[name]).max(axis=1).min() < 1e-8
        assert np.abs(postures.angles[:, 1] - final_angles[name][1]).max() <= math.radians(3) + 1e-12
        finger = hand.finger(name)
        for angles in postures.angles:
            tip = hand.frame_placements(hand.configuration({name: angles}), [finger.tip])[0][:3, 3]
            assert np.linalg.norm(tip - POINTS[name]) < 1e-9
            assert np.all(angles >= hand.lower[finger.dofs]) and np.all(angles <= hand.upper[finger.dofs])


def test_curled_fingertip_past_the_knuckle(hand, final_angles):
    """Eq. (1) by atan2 alone would land 180 deg away: the index tip lies at negative x1."""
    index = hand.finger("index")
    base = hand.frame_placements(np.zeros(20), [index.joints[0]])[0]
    local = np.linalg.inv(base) @ [*POINTS["index"], 1]
    q1 = final_angles["index"][0]
    assert local[0] * math.cos(q1) + local[1] * math.sin(q1) == pytest.approx(-0.0211, abs=2e-4)


SPLITS = {
    "4": [3],
    "3+1": [2, 3],
    "2+2": [1, 3],
    "2+1+1": [1, 2, 3],
    "3, tip free": [2],
    "2, rest free": [1],
    "2+1": [1, 2],
}


@pytest.mark.parametrize("split", SPLITS)
@pytest.mark.parametrize("finger", ["thumb", "index", "little"])
@pytest.mark.parametrize("given", [True, False])
def test_every_split_of_figure_5_comes_back(hand, contact_set, split, finger, given):
    """Random postures -> contact points by forward kinematics -> all postures -> the one we started from."""
    rng = np.random.default_rng(7 * len(split) + len(finger))
    chain = hand.finger(finger)
    for _ in range(12):
        angles = rng.uniform(hand.lower[chain.dofs] + 0.05, hand.upper[chain.dofs] - 0.05)
        q = hand.configuration({finger: angles})
        rows = []
        for i in SPLITS[split]:
            length = rng.uniform(0.4, 1.0) * [0, 0.0448, 0.0258, 0.0204][i]
            alone = i == 1 or (i > 0 and i - 1 in SPLITS[split])  # one joint: the length may be left to the point
            where = on_link(hand, finger, q, i, length)
            rows.append((finger, chain.links[i], where, rng.normal(size=3), length if given or not alone else None))
        found = contact_postures(hand, contact_set(rows), reference={finger: angles})[finger]
        assert np.abs(found.angles - angles).max(axis=1).min() < 1e-6
        for posture, points_l in zip(found.angles, found.points_l):
            q = hand.configuration({finger: posture})
            for (_, link, where, _, _), local in zip(rows, points_l):
                placement = hand.frame_placements(q, [link])[0]
                assert np.linalg.norm(placement[:3, :3] @ local + placement[:3, 3] - where) < 1e-9


def test_both_elbows_are_returned(hand, contact_set):
    index = hand.finger("index")
    wide = hand.with_limits({name: (-3.0, 3.0) for name in index.joints})
    angles = np.array([0.3, 0.5, 0.9, 0.6])
    where = on_link(wide, "index", wide.configuration({"index": angles}), 3, 21.36e-3)
    contacts = contact_set([("index", "index_distal", where, [0, 0, 1.0], 21.36e-3)])
    found = contact_postures(wide, contacts, reference={"index": angles}, samples=1)["index"].angles
    assert len(found) == 2 and np.allclose(np.sort(found[:, 3]), [-0.6, 0.6])


def test_eq_3b_divides_by_the_contact_length(hand, contact_set):
    """With l_i for l_c the last joint would miss whenever the contact is not at the fingertip."""
    angles = np.array([0.3, 0.5, 0.9, 0.6])
    where = on_link(hand, "index", hand.configuration({"index": angles}), 3, 0.01)
    contacts = contact_set([("index", "index_distal", where, [0, 0, 1.0], 0.01)])
    found = contact_postures(hand, contacts, reference={"index": angles}, samples=1)["index"].angles
    assert np.abs(found - angles).max(axis=1).min() < 1e-9


def test_without_a_reference_the_whole_range_is_sampled(hand, contacts):
    found = contact_postures(hand, contacts, samples=61)
    assert all(len(postures.angles) >= 5 for postures in found.values())
    spread = np.ptp(found["index"].angles[:, 1])
    assert spread > math.radians(6)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        ([("index", "index_distal", (0.3, 0.3, 0.3), (0, 0, 1), 0.02136)], "too far"),
        ([("index", "index_distal", (0.0988, 0.0366, 0.0711), (0, 0, 1), 0.02136)], "outside|limits"),
        ([("index", "index_base", (0.08, 0.05, 0.07), (0, 0, 1), 0.01)], "joint angles|workspace"),
    ],
)
def test_unreachable_points_say_why(hand, contact_set, final_angles, rows, message):
    with pytest.raises(ContactNotReached, match=message) as caught:
        contact_postures(hand, contact_set(rows), reference={"index": final_angles["index"]})
    assert caught.value.finger == "index"


def test_a_point_behind_a_joint_limit_names_the_joint(contacts, final_angles, paper_case):
    narrow = load_hand("humanoid", pose=paper_case.load_hand().pose)  # the thumb's own 90 deg
    with pytest.raises(ContactNotReached, match=r"thumb_abduction at 130.0 deg, limits -15.0..90.0"):
        contact_postures(narrow, contacts, reference=final_angles)


def test_contacts_out_of_the_flexion_plane_are_refused(hand, contact_set, final_angles):
    q = hand.configuration(final_angles)
    first, second = on_link(hand, "index", q, 2, 0.02), on_link(hand, "index", q, 3, 0.02) + [0, 0, 0.002]
    rows = [("index", "index_intermediate", first, [0, 1, 0], 0.02), ("index", "index_distal", second, [0, 1, 0], 0.02)]
    with pytest.raises(ContactNotReached, match="flexion plane"):
        contact_postures(hand, contact_set(rows), reference={"index": final_angles["index"]})


def test_bad_references_are_refused(hand, contacts):
    with pytest.raises(InvalidInput, match="shape"):
        contact_postures(hand, contacts, reference={"index": [1, 2]})
    with pytest.raises(InvalidInput, match="finger"):
        contact_postures(hand, contacts, reference={"pinky": [1, 2, 3, 4]})
    with pytest.raises(InvalidInput, match="samples"):
        contact_postures(hand, contacts, samples=0)


@pytest.mark.slow
@pytest.mark.no_cover
def test_fingers_of_any_hand_reach_their_points(contact_set):
    """The Allegro: its fingers are planar (first joint about the finger's own axis), its thumb is not."""
    hand = load_hand(file_of("allegro_right"), fingers={"thumb": "link_15.0", "index": "link_3.0", "ring": "link_11.0"})
    rng = np.random.default_rng(0)
    methods = {}
    for finger in hand.fingers:
        for _ in range(3):
            angles = rng.uniform(hand.lower[finger.dofs] + 0.1, hand.upper[finger.dofs] - 0.1)
            tip = hand.frame_placements(hand.configuration({finger.name: angles}), [finger.tip])[0][:3, 3]
            length = np.linalg.norm(hand.model.frames[hand.frame_id(finger.tip)].placement.translation)
            rows = [(finger.name, finger.links[-1], tip, [0, 0, 1.0], length)]
            found = contact_postures(hand, contact_set(rows), reference={finger.name: angles})[finger.name]
            methods[finger.name] = found.method
            assert len(found.angles) >= 3
            if found.method == "closed form":
                assert np.abs(found.angles - angles).max(axis=1).min() < 1e-6
            for posture in found.angles:
                q = hand.configuration({finger.name: posture})
                assert np.linalg.norm(hand.frame_placements(q, [finger.tip])[0][:3, 3] - tip) < 1e-9
            anywhere = contact_postures(hand, contact_set(rows), samples=5)[finger.name]
            assert len(anywhere.angles) >= 1
    assert methods == {"thumb": "numerical", "index": "closed form", "ring": "closed form"}
    finger = hand.finger("thumb")
    with pytest.raises(ContactNotReached):
        contact_postures(hand, contact_set([(finger.name, finger.links[-1], [1.0, 1, 1], [0, 0, 1.0], length)]))


# -- Jacobians and grasp phase -----------------------------------------------------------------------------------------


def test_point_jacobian_by_finite_differences(hand):
    rng = np.random.default_rng(1)
    data = hand.model.createData()
    for _ in range(5):
        q, point = rng.uniform(hand.lower, hand.upper), rng.normal(size=3) * 0.02
        for j in (4, 12, 20):
            pin.computeJointJacobians(hand.model, data, q)
            J = point_jacobian(hand.model, data, j, point)
            numerical = np.empty_like(J)
            for i, step in enumerate(np.eye(hand.n) * 1e-6):
                moved = []
                for sign in (1, -1):
                    pin.forwardKinematics(hand.model, data, pin.integrate(hand.model, q, sign * step))
                    moved.append(data.oMi[j].act(point))
                numerical[:, i] = (moved[0] - moved[1]) / 2e-6
            assert np.abs(J - numerical).max() < 1e-9


def press_finger(hand, contact_set, finger, angles, links, depths=(2e-3,), **options):
    chain = hand.finger(finger)
    q = hand.configuration({finger: angles})
    placements = hand.frame_placements(q, [chain.links[i] for i in links])
    rows, points_l = [], []
    data = hand.model.createData()
    for i, placement in zip(links, placements):
        local = np.array([0.015, 0, 0])
        # Press across the link, in the flexion plane.
        rows.append((finger, chain.links[i], placement[:3, :3] @ local + placement[:3, 3], placement[:3, 1], 0.015))
        points_l.append(local)
    profile = PenetrationProfile(acceleration=[2 * d / 0.01 for d in depths], impact_time=0.9, final_time=1.0)
    times = np.linspace(0.9, 1.0, 101)
    contacts = contact_set(rows)
    path = ContactPath(list(contacts), profile, list(range(len(links))), times)
    (motion,) = press_points(hand, chain, path, angles[None], np.array([points_l]), **options)
    return motion, contacts, profile, times, data


PARTS = {(3,): [(0, 4)], (2, 3): [(0, 3), (3, 4)], (1, 3): [(0, 2), (2, 4)], (1, 2, 3): [(0, 2), (2, 3), (3, 4)]}


@pytest.mark.parametrize("links", PARTS)
def test_contact_points_follow_their_normals(hand, contact_set, links):
    """Eqs. (17a), (17b): sub-manipulators one after the other; positions, rates and accelerations agree."""
    angles = np.array([0.4, 0.5, 0.7, 0.6])
    depths = [1e-3 * (i + 1) / len(links) for i in range(len(links))]
    motion, contacts, profile, times, _ = press_finger(hand, contact_set, "index", angles, list(links), depths=depths)
    rates = profile.rate(times)
    for c, (contact, (first, last)) in enumerate(zip(contacts, PARTS[links])):
        # Before any error has built up: least squares on the joints of the part, less what those before it cause.
        J, dq, wanted = motion.jacobians[0, c, :3], motion.dq[0], rates[0, c] * contact.normal_o
        rest = wanted - J[:, :first] @ dq[:first]
        expected = np.linalg.lstsq(J[:, first:last], rest, rcond=None)[0]
        assert np.abs(dq[first:last] - expected).max() < 1e-9 * np.abs(expected).max()
    if len(links) == 1:  # four joints for one point: followed exactly
        velocity = np.einsum("mxn,mn->mx", motion.jacobians[:, 0, :3], motion.dq)
        assert np.abs(velocity - rates * contacts[0].normal_o).max() < 1e-4 * rates.max()
        assert motion.errors.max() < 1e-9
    assert motion.errors.max() < max(depths) and motion.limited == ()
    assert np.abs(np.gradient(motion.q, times, axis=0)[1:-1] - motion.dq[1:-1]).max() < 2e-3 * np.abs(motion.dq).max()
    assert np.allclose(motion.ddq, np.gradient(motion.dq, times, axis=0, edge_order=2), atol=1e-9)


def test_euler_drifts_and_the_closed_loop_does_not(hand, contact_set):
    """Eq. (18) as printed leaves the path; the drift shrinks with the step, feedback removes it."""
    angles = np.array([0.4, 0.5, 0.7, 0.6])
    paper, *_ = press_finger(hand, contact_set, "index", angles, [3], feedback=False, euler=True)
    ours, *_ = press_finger(hand, contact_set, "index", angles, [3])
    held, *_ = press_finger(hand, contact_set, "index", angles, [3], euler=True)
    assert paper.errors[-1, 0] > 5e-6
    assert held.errors[-1, 0] < paper.errors[-1, 0] / 20
    assert ours.errors.max() < 1e-9


def test_joint_limits_are_respected_and_reported(hand, contact_set):
    angles = np.array([0.4, 0.5, 0.7, 0.6])
    tight = hand.with_limits({"index_mcp": (-0.5, 0.505), "index_pip": (0.0, 0.701)})
    motion, *_ = press_finger(tight, contact_set, "index", angles, [3], depths=(4e-3,))
    index = tight.finger("index")
    assert "index_mcp" in motion.limited
    assert np.all(motion.q <= tight.upper[index.dofs] + 1e-9) and np.all(motion.q >= tight.lower[index.dofs] - 1e-9)
    blocked = hand.with_limits({name: (a - 1e-4, a + 1e-4) for name, a in zip(index.joints, angles)})
    motion, *_ = press_finger(blocked, contact_set, "index", angles, [3])
    assert motion.errors[-1, 0] > 1e-4 and len(motion.limited) >= 2


def test_near_a_singular_posture_rates_stay_bounded(hand, contact_set):
    straight = hand.with_limits({name: (-1.0, 2.0) for name in hand.finger("index").joints})
    angles = np.array([0.4, 0.3, 1e-5, 1e-5])  # a straight finger, pressed along itself
    chain = straight.finger("index")
    placement = straight.frame_placements(straight.configuration({"index": angles}), [chain.links[3]])[0]
    local = np.array([0.02, 0, 0])
    contacts = contact_set(
        [("index", chain.links[3], placement[:3, :3] @ local + placement[:3, 3], placement[:3, 0], 0.02)]
    )
    profile = PenetrationProfile(acceleration=[0.2], impact_time=0.9, final_time=1.0)
    path = ContactPath(list(contacts), profile, [0], np.linspace(0.9, 1.0, 101))
    (motion,) = press_points(straight, chain, path, angles[None], local[None, None])
    assert np.all(np.isfinite(motion.q)) and np.abs(motion.dq).max() < 200


def test_press_needs_samples(contact_set):
    contacts = contact_set([("index", "index_distal", [0, 0, 0], [0, 0, 1.0], 0.02)])
    profile = PenetrationProfile(acceleration=[0.2], impact_time=0.9, final_time=1.0)
    with pytest.raises(InvalidInput, match="at least 3"):
        ContactPath(list(contacts), profile, [0], [0.9, 1.0])


# -- approach ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("start", "first"), [("rest", 0.0), ("paper", -1.0)])
def test_approach_meets_its_boundary_conditions(start, first):
    """Eq. (19) with conditions (i) and (ii); "paper" starts with -ddq, "rest" with 0."""
    rng = np.random.default_rng(0)
    q0, q, dq, ddq = rng.normal(size=(4, 5))
    T = 0.9
    times = np.linspace(0, T, 4001)
    path = approach(times, T, q0, (q, dq, ddq), acceleration_at_start=start)
    p, v, a = path.q, path.dq, path.ddq
    for got, wanted in ((p[0], q0), (v[0], 0 * dq), (a[0], first * ddq), (p[-1], q), (v[-1], dq), (a[-1], ddq)):
        assert np.abs(got - wanted).max() < 1e-10
    assert np.abs(np.gradient(p, times, axis=0)[1:-1] - v[1:-1]).max() < 1e-4
    assert np.abs(np.gradient(v, times, axis=0)[1:-1] - a[1:-1]).max() < 1e-3
    assert np.abs(np.diff(p, n=6, axis=0)).max() < 1e-10  # a polynomial of fifth order
    with pytest.raises(InvalidInput, match="acceleration at start"):
        approach(times, T, q0, (q, dq, ddq), acceleration_at_start="jump")


# -- torques -----------------------------------------------------------------------------------------------------------


def test_torques_are_the_equation_of_motion(hand):
    """tau = M ddq + h + J^T f with f on the object; Pinocchio's own RNEA with -f as external force agrees."""
    rng = np.random.default_rng(2)
    q, dq, ddq = rng.uniform(hand.lower, hand.upper, (7, 20)), rng.normal(size=(7, 20)), rng.normal(size=(7, 20))
    f = rng.normal(size=(7, 1, 3))
    joint, point = hand.finger("ring").joint_ids[3], np.array([0.01, 0.002, 0.003])
    data, other = hand.model.createData(), hand.model.createData()
    jacobians, expected, by_rnea = [], [], []
    for i in range(7):
        pin.computeJointJacobians(hand.model, data, q[i])
        J = point_jacobian(hand.model, data, joint, point)
        jacobians.append(J[None])
        M = pin.crba(hand.model, other, q[i])
        M = np.triu(M) + np.triu(M, 1).T
        h = pin.nonLinearEffects(hand.model, other, q[i], dq[i])
        expected.append(M @ ddq[i] + h + J.T @ f[i, 0])
        external = [pin.Force.Zero() for _ in range(hand.model.njoints)]
        local = data.oMi[joint].rotation.T @ -f[i, 0]
        external[joint] = pin.Force(local, np.cross(point, local))
        by_rnea.append(pin.rnea(hand.model, other, q[i], dq[i], ddq[i], external))
    total = inverse_dynamics(hand, q, dq, ddq) + contact_torques(np.array(jacobians), f)
    assert np.abs(total - expected).max() < 1e-12
    assert np.abs(total - by_rnea).max() < 1e-12


def test_the_slope_of_torques_under_constant_forces_is_the_curvature_of_their_work():
    """J^T F is the gradient of F . p(q), p being the points that are fixed in the links."""
    hand = load_hand("allegro_right")
    q = 0.4 * hand.lower + 0.6 * hand.upper
    tips = [finger.tip for finger in hand.fingers]
    where = hand.frame_placements(q, tips)[:, :3, 3]
    normals = np.array([[1.0, 0, 0], [0, 1.0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    contacts = ContactSet(
        contacts=tuple(
            Contact(
                finger=finger.name,
                link=finger.links[-1],
                point_o=point - 2e-3 * normal,
                rotation_oc=tangent_frame(normal),
                length=None,
                distance=0.0,
            )
            for finger, point, normal in zip(hand.fingers, where, normals)
        ),
        com_o=where.mean(axis=0),
    )
    forces = np.random.default_rng(1).normal(size=(4, 3))
    found = preload_slope(hand, contacts, q, forces, depth=2e-3)

    def work(q):
        return float((hand.frame_placements(q, tips)[:, :3, 3] * forces).sum())

    step, n = 1e-3, hand.n
    unit = step * np.eye(n)
    expected = np.array(
        [[work(q + a + b) - work(q + a - b) - work(q - a + b) + work(q - a - b) for b in unit] for a in unit]
    ) / (4 * step**2)
    np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())
    assert np.abs(found).max() > 0.01
    with pytest.raises(InvalidInput, match="forces"):
        preload_slope(hand, contacts, q, forces[:2])


def test_gravity_can_point_anywhere(hand):
    q = np.random.default_rng(0).uniform(hand.lower, hand.upper, (3, 20))
    zero = np.zeros_like(q)
    down = inverse_dynamics(hand, q, zero, zero)
    assert np.abs(inverse_dynamics(hand, q, zero, zero, gravity_o=(0, 0, 9.81)) + down).max() < 1e-15
    assert np.abs(inverse_dynamics(hand, q, zero, zero, gravity_o=(0, 0, 0))).max() < 1e-15
    with pytest.raises(InvalidInput, match="equal lengths"):
        inverse_dynamics(hand, q, zero, zero[:2])


@pytest.fixture(scope="module")
def paper_motion(hand, make_problem, final_angles):
    solution = grid_search(make_problem(measure="work"))
    return solution, plan_motion(hand, solution, MotionSpec(posture=final_angles))


def energy(hand, motion, i):
    data = hand.model.createData()
    pin.computeAllTerms(hand.model, data, motion.q[i], motion.dq[i])
    return pin.computeKineticEnergy(hand.model, data) + pin.computePotentialEnergy(hand.model, data)


def energy_gap(hand, motion):
    """Work of the joints less contact work less change of mechanical energy, over the whole motion [J]."""
    joints = np.trapezoid((motion.torques * motion.dq).sum(axis=1), motion.times)
    contact = np.trapezoid((motion.forces_o * motion.contact_velocities).sum(axis=(1, 2)), motion.times)
    return joints - contact - (energy(hand, motion, -1) - energy(hand, motion, 0)), contact


def test_energy_balances_over_the_whole_motion(hand, paper_motion, make_problem):
    solution, motion = paper_motion
    gap, contact = energy_gap(hand, motion)
    assert abs(gap) < 1e-6 * contact
    # The contact work is the integral of Eq. (4) over depth: K delta^(rho+1) / (rho+1) plus what damping takes.
    elastic = (5e4 * solution.profile.final_depth**2.5 / 2.5).sum()
    assert elastic < contact < 1.01 * elastic


def test_motion_is_continuous_and_tracks(hand, paper_motion):
    solution, motion = paper_motion
    assert motion.status is Status.OK and motion.tracking_error.max() < 1e-9
    assert motion.times[motion.impact] == solution.impact_time and motion.times[-1] == 1.0
    assert np.abs(np.gradient(motion.q, motion.times, axis=0) - motion.dq)[2:-2].max() < 2e-2
    step = np.abs(np.diff(motion.ddq, axis=0)).max(axis=0)
    assert step.max() < 0.02 * np.abs(motion.ddq).max()  # no jump at t_I
    assert np.all(motion.q[0] == 0) and np.all(motion.dq[0] == 0)
    idle = [i for name in ("ring", "little") for i in hand.finger(name).dofs]
    assert np.all(motion.q[:, idle] == 0)
    assert np.all(motion.forces_o[: motion.impact] == 0)
    assert np.allclose(
        np.einsum("kij,ki->kj", solution.problem.contacts.rotations_oc, motion.forces_o[-1]), solution.forces_c
    )


@pytest.mark.slow
def test_selected_posture_has_the_least_peak_torque(hand, make_problem, final_angles, paper_motion):
    """Step 15, by planning every candidate on its own."""
    solution, motion = paper_motion
    postures = contact_postures(hand, solution.problem.contacts, reference=final_angles)
    for name, found in postures.items():
        dofs = hand.finger(name).dofs
        peaks = []
        for angles in found.angles:
            alone = plan_motion(
                hand, solution, MotionSpec(posture={**final_angles, name: angles}, samples=1, spread=0.0)
            )
            peaks.append(np.abs(alone.torques[:, dofs]).max())
        assert np.abs(motion.torques[:, dofs]).max() == pytest.approx(min(peaks), abs=1e-8)


def test_posture_start_and_idle_fingers_are_followed(hand, make_problem, final_angles):
    solution = grid_search(make_problem())
    spec = MotionSpec(
        posture={**final_angles, "ring": np.radians([0, 30, 20, 10])},
        start={"index": np.radians([5, 10, 10, 10]), "little": np.radians([0, 20, 0, 0])},
        samples=1,
        time_step=5e-3,
        acceleration_at_start="paper",
    )
    motion = plan_motion(hand, solution, spec)
    index, ring, little = (hand.finger(name).dofs for name in ("index", "ring", "little"))
    assert np.allclose(motion.q[0, index], np.radians([5, 10, 10, 10]))
    assert np.allclose(motion.q[-1, ring], np.radians([0, 30, 20, 10])) and np.allclose(motion.dq[-1, ring], 0)
    assert np.all(motion.q[:, little] == np.radians([0, 20, 0, 0]))
    assert np.allclose(motion.ddq[0, index], -motion.ddq[motion.impact, index], atol=1e-9)
    assert np.diff(motion.times).max() <= 5e-3 + 1e-12
    gap, contact = energy_gap(hand, motion)
    assert abs(gap) < 1e-4 * contact


def test_effort_limits_are_reported(hand, make_problem, final_angles):
    weak = hand.placed(hand.pose)
    weak.model.effortLimit = np.full(20, 0.5)
    motion = plan_motion(weak, grid_search(make_problem()), MotionSpec(posture=final_angles, samples=1))
    assert any("effort limit" in note and "thumb_cmc" in note for note in motion.notes)


def test_a_finger_with_three_contacts_does_what_it_can(hand, contact_set):
    """A power grasp's finger, 2+1+1: fewer joints than three paths ask for. The least-squares motion, and its status."""
    angles = np.array([0.2, 0.7, 0.8, 0.5])
    chain = hand.finger("middle")
    q = hand.configuration({"middle": angles})
    rows = []
    for i, length in ((1, 0.03), (2, 0.02), (3, 0.02)):
        placement = hand.frame_placements(q, [chain.links[i]])[0]
        where = placement[:3, :3] @ [length, 0, 0] + placement[:3, 3]
        rows.append(("middle", chain.links[i], where, placement[:3, 1], length))
    contacts = contact_set(rows, com=np.mean([row[2] for row in rows], axis=0))
    load = np.zeros(6)
    load[:3] = -sum(1.5 * contact.normal_o for contact in contacts)
    problem = ForceProblem(contacts=contacts, load=load, mu=0.8, balance="force", friction=Friction(), max_depth=5e-3)
    solution = grid_search(problem, GridSpec(accelerations=np.linspace(0.05, 1, 39)))
    assert solution.status is Status.OK
    motion = plan_motion(hand, solution, MotionSpec(posture={"middle": angles}))
    assert motion.status is Status.NOT_TRACKED
    assert 1e-6 < motion.tracking_error.max() < 2e-3
    gap, contact_work = energy_gap(hand, motion)
    assert abs(gap) < 1e-4 * contact_work


def test_an_allegro_hand_holds_a_ball(contact_set):
    """Any hand from a plain URDF: thumb and three fingertips around a sphere."""
    hand = load_hand(
        file_of("allegro_right"), fingers={"index": "link_3.0", "middle": "link_7.0", "thumb": "link_15.0"}
    )
    posture = {"index": [0.0, 0.9, 0.8, 0.7], "middle": [0.0, 0.9, 0.8, 0.7], "thumb": [1.2, 0.3, 0.6, 0.8]}
    q = hand.configuration(posture)
    tips = {name: hand.frame_placements(q, [hand.finger(name).tip])[0][:3, 3] for name in posture}
    a, b, c = tips.values()
    # The smallest sphere through three points has its centre in their plane.
    u, v = b - a, c - a
    n = np.cross(u, v)
    centre = a + (np.cross(n, u) * (v @ v) + np.cross(v, n) * (u @ u)) / (2 * n @ n)
    ball = Sphere(radius=float(np.linalg.norm(a - centre)), mass=0.1, pose=pose_of(centre))
    contacts = contacts_at(hand, ball, tips)
    problem = ForceProblem.holding(ball, contacts, mu=1.0, balance="wrench", friction=Friction(), max_depth=5e-3)
    solution = grid_search(problem)
    assert solution.status is Status.OK and solution.residual_norm < 1e-9
    motion = plan_motion(hand, solution, MotionSpec(posture=posture, samples=3))
    assert motion.tracking_error.max() < 1e-6
    gap, contact = energy_gap(hand, motion)
    assert abs(gap) < 1e-3 * contact


@pytest.mark.parametrize(
    "settings", [{"spread": -1}, {"time_step": 0}, {"samples": 0}, {"samples": 1.5}, {"acceleration_at_start": "x"}]
)
def test_bad_motion_settings_are_refused(settings):
    with pytest.raises(InvalidInput, match="expected"):
        MotionSpec(**settings)


def test_remedies_name_the_cause(hand, make_problem, final_angles):
    """A joint's limit, joints that are too few, steps that are too long: each by its name."""
    problem = make_problem()
    forces = grid_search(problem, search="hybrid", progress=False)
    tight = plan_motion(
        hand.with_limits({"index_dip": (0.0, 0.53)}), forces, MotionSpec(posture=final_angles, samples=1, spread=0.0)
    )
    assert tight.status is Status.JOINT_LIMIT and "index_dip" in tight.remedy and "time step" not in tight.remedy
    assert any("index_dip" in note and "approach" in note for note in tight.notes)
    rough = plan_motion(hand, forces, MotionSpec(posture=final_angles, time_step=0.5))
    assert rough.status is Status.NOT_TRACKED and "smaller time step" in rough.remedy
    assert plan_motion(hand, forces, MotionSpec(posture=final_angles)).remedy == ""


@pytest.mark.slow
def test_jaws_on_one_actuator_are_named():
    from pinograsp.objects import Box
    from pinograsp.planner import plan_grasp_on
    from pinograsp.synthesis import find_grasps

    friction = Friction(model="soft", torsion=0.005)
    box = Box(size=(0.03, 0.03, 0.08), mass=0.1)
    conditions = GraspConditions(mu=0.7, friction=friction, reserve=None)
    best = find_grasps(load_hand("panda"), box, conditions, count=6, jobs=1, progress=False).best
    plan = plan_grasp_on(best.closure.hand, best.closure, conditions)
    assert plan.status is Status.NOT_TRACKED and plan.remedy == plan.summary()["remedy"] == plan.motion.remedy
    assert (
        "panda_finger_joint1" in plan.remedy
        and "the others of its 2 follow" in plan.remedy
        and "time step" not in plan.remedy
    )
