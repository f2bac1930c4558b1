"""Carrying a box with a Panda: against rigid-body mechanics by differences, and by what must follow from what."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from panda_allegro import arm_with_allegro
from panda_path import INTERVALS, JOINTS, WAYPOINTS

import pinograsp as pg
from pinograsp.carry import ArmPath, plan_carry
from pinograsp.carry.cautions import doubt_squeeze
from pinograsp.errors import CarryInfeasible, InvalidInput, Status
from pinograsp.handover import JointTrajectory
from pinograsp.planner import plan_best
from pinograsp.spatial import inverse_of


def pose_of_box(arm, grasp, q):
    """Where the box is (4, 4) when the palm carries it."""
    palm = [arm.palm]
    before = arm.frame_placements(np.array(grasp.motion.q[-1]), palm)[0]
    return arm.frame_placements(q, palm)[0] @ np.linalg.inv(before) @ grasp.problem.object.pose


@pytest.mark.slow
def test_the_optimum_is_certified(carried):
    assert carried.gap < 1e-5
    assert carried.lower_bound <= carried.duration
    assert carried.residual < 1e-6
    assert carried.times[-1] == pytest.approx(carried.duration) == pytest.approx(carried.fastest)
    assert (np.diff(carried.times) > 0).all()
    np.testing.assert_allclose(carried.speed[[0, -1]], 0.0, atol=1e-12)
    assert "no timing of this path takes less" in carried.describe()


def test_loads_are_newtons_and_eulers(arm, grasp, carried):
    """Against differences of the box's pose along the motion, turned into the axes of the grasp."""
    path, h, body = carried.path, 1e-4, grasp.problem.object
    moving = [arm.joint_names.index(joint) for joint in path.joints]
    for i in (3, 20, 41):
        s, v, a = (float(part[0]) for part in carried.timing.at(carried.instants[[i]])[:3])

        def box(t):
            q = np.array(grasp.motion.q[-1])
            q[moving] = path.at([s + v * t + a * t * t / 2]).q[0]
            return pose_of_box(arm, grasp, q)

        before, now, after = box(-h), box(0.0), box(h)
        linear = (before[:3, 3] + after[:3, 3] - 2 * now[:3, 3]) / h**2
        spin = [pin.log3(two[:3, :3] @ one[:3, :3].T) / h for one, two in ((before, now), (now, after))]
        inertia = now[:3, :3] @ body.inertia_b @ now[:3, :3].T
        omega = (spin[0] + spin[1]) / 2
        moment = inertia @ (spin[1] - spin[0]) / h + np.cross(omega, inertia @ omega)
        force = body.mass * (linear + [0, 0, 9.81])
        # Axes that turn with the box, as the world's lay when the grasp was planned.
        turned = body.pose[:3, :3] @ now[:3, :3].T
        expected = -np.concatenate([turned @ force, turned @ moment])
        np.testing.assert_allclose(carried.loads[i], expected, atol=2e-4)


def test_forces_balance_the_loads_within_friction(grasp, carried):
    problem = grasp.problem
    for i in range(0, INTERVALS, 7):
        arms = problem.contacts.points_o - problem.contacts.com_o
        normals = problem.contacts.rotations_oc[:, :, 2]
        force = carried.forces_o[i]
        wrench = np.concatenate([force.sum(axis=0), np.cross(arms, force).sum(axis=0) + carried.torsion[i] @ normals])
        np.testing.assert_allclose(wrench + carried.loads[i], 0.0, atol=1e-5)
    assert (carried.friction_use < 1 + 1e-5).all()
    assert (carried.normal_forces >= 0).all()


def test_torques_are_those_of_the_arm_with_the_box_welded_on(arm, grasp, carried):
    model = arm.model.copy()
    model.gravity.linear = np.array([0.0, 0.0, -9.81])
    frame = model.frames[model.getFrameId(arm.palm)]
    body = grasp.problem.object
    oMj = pin.SE3(arm.frame_placements(np.array(grasp.motion.q[-1]), [arm.palm])[0]) * frame.placement.inverse()
    box = pin.Inertia(body.mass, np.zeros(3), body.inertia_b)
    model.inertias[frame.parentJoint] = model.inertias[frame.parentJoint] + (oMj.inverse() * pin.SE3(body.pose)).act(
        box
    )
    data, moving = model.createData(), [arm.joint_names.index(joint) for joint in JOINTS]
    for i in (0, 17, 59):
        expected = pin.rnea(model, data, carried.q[i], carried.dq[i], carried.ddq[i])
        np.testing.assert_allclose(carried.torques[i, moving], expected[moving], atol=1e-6)
    assert (np.abs(carried.torques[:, moving]) <= arm.effort[moving] * (1 - carried.reserve) * (1 + 1e-5)).all()
    assert (np.abs(carried.dq[:, moving]) <= arm.velocity[moving]).all()


def test_less_friction_and_more_reserve_take_longer(arm, grasp, carried):
    free = plan_carry(arm, grasp, WAYPOINTS, intervals=INTERVALS, reserve=0.0, ramp=0)
    assert free.duration < carried.duration
    slow = plan_carry(arm, grasp, WAYPOINTS, intervals=INTERVALS, acceleration=1.0)
    assert slow.duration > carried.duration
    assert np.abs(slow.ddq).max() <= 0.9 * (1 + 1e-5)
    assert any(what.startswith("acceleration of") for what in slow.binding)


def test_the_object_goes_no_faster_than_is_wished(arm, grasp, carried):
    robot, body = arm, grasp.body

    def speeds(plan):
        way = plan.trajectory(rate=1000.0)
        palms = robot.frame_placements(way.q, [robot.palm])[:, 0]
        at_grasp = robot.frame_placements(np.array(grasp.motion.q[-1]), [robot.palm])[0]
        centres = (palms @ inverse_of(at_grasp) @ body.pose)[:, :3, 3]
        return np.linalg.norm(np.gradient(centres, way.times, axis=0), axis=1)

    cap = 0.5 * speeds(carried).max()
    for ramp in (0, 0.05):
        slow = plan_carry(arm, grasp, WAYPOINTS, intervals=INTERVALS, ramp=ramp, object_speed=cap)
        assert slow.duration > carried.duration
        assert 0.98 * cap < speeds(slow).max() < 1.001 * cap
        assert "speed of the joints or of the object" in slow.binding
    with pytest.raises(CarryInfeasible, match="speed of the object"):
        plan_carry(arm, grasp, ArmPath.of(carried.trajectory()), timing="given", object_speed=cap)


def test_slippery_contacts_bind(arm, grasp):
    """Where the grasp bears little, friction says how fast the arm may be."""
    weak = replace(grasp.solution, problem=replace(grasp.problem, max_normal_force=1.3))
    found = plan_carry(arm, replace(grasp, solution=weak), WAYPOINTS, intervals=INTERVALS, disturbance=0.0)
    assert found.duration > plan_carry(arm, grasp, WAYPOINTS, intervals=INTERVALS, disturbance=0.0).duration
    assert any(what.startswith(("friction of", "largest force of")) for what in found.binding)
    assert found.normal_forces.max() <= 1.3 * 0.9 * (1 + 1e-6)


def test_a_grasp_that_cannot_hold_it_at_rest_is_proven(arm, grasp):
    weak = replace(grasp.solution, problem=replace(grasp.problem, max_normal_force=0.2))
    with pytest.raises(CarryInfeasible, match=r"even at rest.*proven") as raised:
        plan_carry(arm, replace(grasp, solution=weak), WAYPOINTS, intervals=20, disturbance=0.0)
    assert 0 <= raised.value.at <= 1
    assert raised.value.solution.infeasibility is not None


def test_paths(arm, grasp):
    times = np.linspace(0, 2, 9)
    s = ArmPath.through(WAYPOINTS)
    q = s.at(times / 2).q
    zero = np.zeros_like(q)
    trajectory = JointTrajectory(names=JOINTS, times=times, q=q, dq=zero, ddq=zero, effort=zero)
    path = ArmPath.of(trajectory)
    assert path.duration == 2
    np.testing.assert_allclose(path.at([0.0, 0.5, 1.0]).q, q[[0, 4, 8]], atol=1e-12)
    step = 1e-5
    near = s.at([0.3 - step, 0.3, 0.3 + step])
    np.testing.assert_allclose(near.slope[1], (near.q[2] - near.q[0]) / (2 * step), atol=1e-6)
    np.testing.assert_allclose(near.bend[1], (near.slope[2] - near.slope[0]) / (2 * step), atol=1e-6)


@pytest.mark.parametrize(
    ("path", "message"),
    [
        ({}, "expected .joint: positions"),
        ({"panda_joint1": [0.0]}, "two or more"),
        ({"panda_joint1": [0.0, 1.0], "panda_joint2": [0.0]}, "as many of each joint"),
        ({"panda_joint1": [0.0, 0.0, 1.0]}, "numbers 0 and 1 are the same"),
        ({"panda_finger_joint1": [0.0, 0.01]}, "joints of the arm"),
        ({"elbow": [0.0, 1.0]}, "joints of the arm"),
        ({"panda_jiont3": [0.0, 1.0]}, "did you mean 'panda_joint3'"),
        ({"left_panda_joint2": [0.0, 1.0]}, "did you mean 'panda_joint2'"),
        ({"joint5": [0.0, 1.0], "Panda_joint6": [0.0, 1.0]}, "'panda_joint5' for .*'panda_joint6' for"),
        ({"panda_joint4": [-2.0, 1.0]}, "beyond its limit"),
        ({"panda_joint1": [0.0, np.nan]}, "waypoints of 'panda_joint1'"),
    ],
)
def test_paths_that_cannot_be(arm, grasp, path, message):
    with pytest.raises(InvalidInput, match=message):
        plan_carry(arm, grasp, path, intervals=10)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"intervals": 1}, "intervals"),
        ({"reserve": 1.0}, "reserve"),
        ({"speed": 0.0}, "speed"),
        ({"acceleration": [1.0, 2.0]}, "acceleration"),
        ({"gravity_o": [0.0, 1.0]}, "gravity"),
        ({"timing": "given"}, "give a trajectory"),
        ({"timing": "soon"}, "timing"),
        ({"squeeze": "hard"}, "squeeze"),
        ({"squeeze": -1.0}, "squeeze"),
        ({"ramp": -1.0}, "ramp"),
        ({"ramp": np.nan}, "ramp"),
        ({"jerk": 0.0}, "jerk"),
        ({"scenarios": [1.2]}, "scenarios"),
    ],
)
def test_options_that_cannot_be(arm, grasp, options, message):
    with pytest.raises(InvalidInput, match=message):
        plan_carry(arm, grasp, WAYPOINTS, **{"intervals": 10, **options})


def points_on(hand, q, links, points, before):
    """Where points (k, 3) that lie on links at joint positions ``before`` go (k, 3)."""
    there, here = hand.frame_placements(q, list(links)), hand.frame_placements(before, list(links))
    moved = [pose @ np.linalg.inv(old) @ [*point, 1] for pose, old, point in zip(there, here, points)]
    return np.array(moved)[:, :3]


@pytest.mark.slow
def test_a_grasp_of_the_hand_alone(tmp_path):
    """What an Allegro was planned to hold by itself, on an arm: the same contacts, turned with the palm."""
    robot, hand, conditions = arm_with_allegro(tmp_path), pg.load_hand("allegro_right"), pg.GraspConditions(mu=0.6)
    search = pg.find_grasps(hand, pg.Sphere(radius=0.035, mass=0.15), conditions, count=8, seed=3, jobs=1)
    grasp = plan_best(search, conditions)
    found = plan_carry(robot, grasp, WAYPOINTS, intervals=40)
    assert found.gap < 1e-5
    assert found.residual < 1e-6
    # Gravity pulls as the palm lies: the first load is next to the weight, since the arm begins at rest.
    size = np.linalg.norm(found.loads[:, :3], axis=1)
    assert (np.abs(size / (0.15 * 9.81) - 1) < 1.5).all()
    fingers = np.concatenate([finger.dofs for finger in robot.fingers])
    limit = (1 - found.reserve) * robot.effort[fingers]
    assert (np.abs(found.torques[:, fingers]) <= limit * (1 + 1e-5) + 1e-6).all()
    limits = np.where(robot.effort > 0, robot.effort, np.inf)
    # Fingers are sent deeper without dragging contacts along the surface, where friction would hold against it.
    normals, points = grasp.contacts.rotations_oc[:, :, 2], grasp.contacts.points_o
    names, q = [robot.joint_names.index(joint) for joint in hand.joint_names], np.array(grasp.motion.q[-1])
    for i in (0, 20):
        moved = (
            points_on(grasp.hand, q + (found.commanded_q - found.q)[i, names], grasp.contacts.links, points, q) - points
        )
        deeper = np.einsum("kx,kx->k", moved, normals)
        wanted = (found.commanded[i] / grasp.law.stiffness) ** (1 / grasp.law.exponent) - grasp.forces.final_depths
        np.testing.assert_allclose(deeper, wanted, atol=5e-5)
        assert np.linalg.norm(moved - deeper[:, None] * normals, axis=1).max() < 1e-4
    same = plan_carry(robot, grasp, WAYPOINTS, intervals=40, torque_limit=limits)
    assert same.duration == pytest.approx(found.duration, rel=1e-5)
    # Nothing speaks against it, but would if contacts pressed past the ball's centre, or slid.
    assert found.status is Status.OK and not found.cautions
    first, most, loads = grasp.solution, found.normal_forces.max(axis=0), found.loads
    assert not doubt_squeeze(grasp, first, found.closing, most, loads)
    (sways,) = doubt_squeeze(grasp, first, found.closing, most, 20 * loads)
    assert "sways" in sways
    deep = doubt_squeeze(grasp, first, found.closing, np.full(len(most), 400.0), loads)
    assert len(deep) == len(most) and all("face" in one for one in deep)
    slid = doubt_squeeze(grasp, first, replace(found.closing, slip=np.eye(len(most))[0] * 2e-3), most, loads)
    assert len(slid) == 1 and grasp.contacts.names[0] in slid[0] and "slides 2 mm" in slid[0]
    doubtful = replace(found, cautions=tuple(slid))
    assert doubtful.status is Status.DOUBTFUL
    assert slid[0] in doubtful.describe() and doubtful.summary()["cautions"] == slid


def test_a_robot_without_the_hand(grasp):
    with pytest.raises(InvalidInput, match="expected the grasp's hand in it"):
        plan_carry(pg.load_hand("allegro_right"), grasp, WAYPOINTS)


def test_motors_of_the_arm_that_act_one_way_are_told(arm, grasp, carried):
    """A motor that can only act against the torques of the path is a warning, one that acts with them is none."""
    i = arm.joint_names.index("panda_joint2")
    ways = np.sign(carried.torques[:, i])
    for sign in (1.0, -1.0):
        drives = [
            replace(one, efforts=(0.0, one.limit) if sign > 0 else (-one.limit, 0.0))
            if "panda_joint2" in one.joints
            else one
            for one in arm.drives
        ]
        plan = plan_carry(replace(arm, drives=tuple(drives)), grasp, WAYPOINTS, intervals=INTERVALS, ramp=0)
        told = [one for one in plan.cautions if "other direction" in one]
        assert bool(told) == bool((ways == -sign).any())
    assert set(ways) == {-1.0} or set(ways) == {1.0}
