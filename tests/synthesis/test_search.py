"""Searching grasps: what is found holds, whatever the number of processes; the ranking; how failures are told."""

from __future__ import annotations

import os
import secrets
import signal
import subprocess
import sys
import time
import weakref
from dataclasses import replace

import numpy as np
import own_hands
import pinocchio as pin
import pytest
import trimesh
from marks import slow_except
from scipy.optimize import linprog

from pinograsp.contacts import PALM, Friction, clearance
from pinograsp.contacts.clearance import behind_hulls
from pinograsp.errors import GraspNotFound, InvalidInput, NoGrasp, PinograspError, Status
from pinograsp.forces import GraspConditions, Reserve, force_closure
from pinograsp.hands import load_hand
from pinograsp.objects import Box, Cylinder, Mesh, Scene, Sphere
from pinograsp.planner import plan_grasp, plan_grasp_on
from pinograsp.spatial import pose_of
from pinograsp.synthesis import Approach, Wishes, find_grasps
from pinograsp.synthesis.preshapes import preshapes
from pinograsp.synthesis.seeds import find_pairs

CONDITIONS = GraspConditions(mu=0.7, friction=Friction(model="soft", torsion=0.005))
SETTINGS = {"conditions": CONDITIONS, "progress": False}


class Nowhere:
    def refuse(self, hand, q):
        return "no licence"


def test_hands_keep_their_distance_from_what_stands_around():
    """Jaws at a can under a shelf: they come from the side that is left, and above the table."""
    hand, seed = load_hand("panda"), secrets.randbelow(10**6)
    can = Cylinder(radius=0.03, height=0.12, mass=0.2, pose=pose_of((0.5, 0.0, 0.06)))
    scene = Scene.on_table().with_box("shelf", (0.3, 0.3, 0.02), at=(0.5, 0.0, 0.15))
    found = find_grasps(hand, can, GraspConditions(mu=0.6), scene=scene, count=24, seed=seed, progress=False)
    assert found.grasps, seed
    for grasp in found.grasps:
        closure = grasp.closure
        for name, least in (("shelf", scene.clearance), ("table", 0.0)):
            for q in (closure.start, closure.q):
                assert clearance(closure.hand, scene.obstacles[name], q) > least - 1e-4, (name, seed)
    above = {"wishes": Wishes(approach=Approach(direction=(0, 0, -1), cone=0.2)), "count": 8, "progress": False}
    assert find_grasps(hand, can, GraspConditions(mu=0.6, table=True), seed=seed, **above).grasps, seed
    blocked = find_grasps(hand, can, GraspConditions(mu=0.6), seed=seed, scene=scene, **above)
    assert not blocked.grasps and "no place for the open hand (hit shelf)" in blocked.causes, seed


def test_what_there_is_no_place_for_is_told_at_once(ball):
    hand = load_hand("panda")
    found = find_grasps(hand, ball, CONDITIONS, scene=Nowhere(), count=8, seed=1, progress=False)
    assert not found.grasps and found.tried == 8
    assert found.outcomes == {"no place for the open hand (no licence)": 8}
    with pytest.raises(GraspNotFound, match="no licence"):
        _ = found.best


@pytest.fixture(scope="module")
def allegro():
    return load_hand("allegro_right")


@pytest.fixture(scope="module")
def ball():
    pose = np.eye(4)
    pose[:3, 3] = [0.3, -0.1, 0.5]
    return Sphere(radius=0.03, mass=0.15, pose=pose)


@pytest.fixture(scope="module")
def found(allegro, ball):
    return find_grasps(allegro, ball, count=16, seed=3, jobs=1, **SETTINGS)


def test_grasps_hold_what_they_say(found, ball):
    assert found.tried == 16 == sum(found.outcomes.values()) and not found.interrupted
    assert 1 <= len(found.grasps) <= min(4, found.outcomes["holds"])  # the best of every four
    for grasp in found.grasps:
        closure, forces = grasp.closure, grasp.forces
        assert np.array_equal(closure.object.pose, ball.pose)  # the object stays, the hand is placed
        assert np.array_equal(closure.hand.pose, grasp.pose)
        assert clearance(closure.hand, ball, closure.q) > -1e-6
        assert forces.status is Status.OK and forces.problem.balance == "wrench"
        assert forces.certificate.residual_force < 1e-8 and forces.certificate.residual_moment < 1e-8
        torque = forces.problem.torques.torques(
            np.einsum("kij,kj->ki", forces.problem.contacts.rotations_oc, forces.forces_c),
            forces.torsion[:, None] * forces.problem.contacts.rotations_oc[:, :, 2],
        )
        assert np.all(np.abs(torque) <= closure.hand.effort * (1 + 1e-6))
        assert grasp.energy == forces.certificate.objective and grasp.load_factor >= 1
    # Of grasps that are alike in all that ranks before it, the one that presses least is first.
    kinds = [one.worth[:5] for one in found.grasps]
    assert found.best.withstands and kinds == sorted(kinds, reverse=True)
    for kind in set(kinds):
        squeezes = [one.squeeze for one, own in zip(found.grasps, kinds) if own == kind]
        assert squeezes == sorted(squeezes)
    assert [one.sound for one in found.grasps] == sorted((one.sound for one in found.grasps), reverse=True)


@pytest.mark.slow
def test_quality_is_what_the_weakest_direction_withstands(found):
    """A linear program over finely sampled friction: the least of some directions is not below the quality."""
    grasp = found.best
    contacts, mu = grasp.forces.problem.contacts, 0.8 * 0.7
    arm = Reserve().arm(grasp.closure.object)
    turns = np.arange(32) * np.pi / 16
    edges = []
    for contact in contacts:
        lever = contact.point_o - contacts.com_o
        normal, torsion = contact.rotation_oc[:, 2], 0.8 * 0.005
        sides = contact.rotation_oc[:, :2] @ np.stack([np.cos(turns), np.sin(turns)])
        # On the ellipsoid of friction and torsion.
        forces = [
            (normal + mu * np.cos(tilt) * side, torsion * np.sin(tilt))
            for side in sides.T
            for tilt in np.linspace(-np.pi / 2, np.pi / 2, 17)
        ]
        edges += [[*force, *(np.cross(lever, force) + spin * normal) / arm] for force, spin in forces]
    rng, least = np.random.default_rng(1), np.inf
    for _ in range(30):
        direction = rng.normal(size=6)
        direction /= np.linalg.norm(direction)
        # max s with edges' weights of sum 1 making s * direction
        rows = np.column_stack([np.array(edges).T, -direction])
        solved = linprog(
            np.append(np.zeros(len(edges)), -1.0),
            A_eq=np.vstack([rows, np.append(np.ones(len(edges)), 0.0)]),
            b_eq=np.append(np.zeros(6), 1.0),
        )
        least = min(least, solved.x[-1])
    assert 0 < grasp.quality <= least * 1.01


@pytest.mark.parametrize("name", slow_except(["allegro_left", "psyonic_right", "talos_left", "panda"], "panda"))
@pytest.mark.no_cover
def test_what_is_found_closes_by_force(name):
    """Any disturbance can be borne, not the weight alone: no cradle."""
    hand = load_hand(name)
    radius = 0.03 if name != "talos_left" else 0.02
    search = find_grasps(hand, Sphere(radius=radius, mass=0.1), count=8, seed=20, jobs=1, **SETTINGS)
    closed = force_closure(search.best.forces.problem.contacts, 0.8 * 0.7, friction=CONDITIONS.friction).closed
    assert closed and search.best.quality > 0.1


@pytest.mark.slow
def test_sizes_that_no_hand_opens_to_are_named(allegro):
    search = find_grasps(allegro, Sphere(radius=40.0, density=1.0), count=2, jobs=1, **SETTINGS)
    with pytest.raises(
        GraspNotFound, match="too large: .* 8e.04 mm apart .* opens by .* mm; millimetres read as metres"
    ):
        _ = search.best
    search = find_grasps(allegro, Sphere(radius=0.25, density=1.0), count=2, jobs=1, **SETTINGS)
    assert not search.grasps and "too large" in search.explain() and "read as metres" not in search.explain()
    least, largest = search.opening
    assert least > 0
    for width, units in ((17 * largest, True), (5 * largest, False), (least / 20, False), (least / 200, True)):
        assert ("read as metres" in replace(search, width=width).explain()) == units


def test_jaws_that_are_through_each_other_all_the_way_are_named(tmp_path, ball):
    jaw = own_hands.link("{}", 0.05, "box 0.034 0.02 0.05")
    slide = {"limit": "0 0.03 20 1", "kind": "prismatic"}
    parts = [
        *(own_hands.link("palm", 0.3, "box 0.1 0.1 0.02", "0 0 -0.05"), jaw.format("left"), jaw.format("right")),
        own_hands.joint("slide", "palm", "left", "-0.012 0 0", "1 0 0", **slide),
        own_hands.joint("other", "palm", "right", "0.012 0 0", "-1 0 0", mimic="slide 1 0", **slide),
    ]
    path = tmp_path / "through.urdf"
    path.write_text(own_hands.robot("through", *parts), encoding="utf-8")
    search = find_grasps(load_hand(path), ball, count=2, jobs=1, **SETTINGS)
    assert not search.grasps and "come together nowhere" in search.explain()


@pytest.mark.parametrize("shape", ["sphere", "box", "tube"])
def test_pairs_face_each_other(shape):
    """On a ball all run through its middle; of a box they are as far apart as its faces; of a tube either wall to
    wall, or across.
    """
    rng = np.random.default_rng(3)
    if shape == "tube":
        tube = trimesh.creation.annulus(0.027, 0.03, 0.08)
        body = Mesh(vertices=tube.vertices, faces=tube.faces, density=300)
    else:
        body = {"sphere": Sphere(radius=0.02, mass=0.1), "box": Box(size=(0.02, 0.03, 0.05), mass=0.1)}[shape]
    pairs = find_pairs(body, rng)
    assert len(pairs.widths) > 50 and np.all(np.diff(pairs.aside) >= 0)
    ends = pairs.middles_o + 0.5 * pairs.widths[:, None] * pairs.axes_o * np.array([[[-1.0]], [[1.0]]])
    first, second = body.project(ends[0])[1], body.project(ends[1])[1]
    assert np.abs(np.concatenate([body.project(end)[2] for end in ends])).max() < 1e-3 * body.bounding_radius
    assert np.einsum("pi,pi->p", first, -second).min() > 0.8
    if shape == "sphere":
        assert np.allclose(pairs.widths, 0.04, rtol=1e-3) and pairs.aside.max() < 1e-4
    elif shape == "box":
        sizes = np.array([0.02, 0.03, 0.05])
        assert np.abs(pairs.widths[:, None] - sizes).min(axis=1).max() < 2e-4
    else:
        assert (pairs.widths < 0.004).any() and (pairs.widths > 0.05).any()


@pytest.mark.slow
def test_preshapes_oppose():
    """Fingertips of a gripper face each other, and a thumb is turned against the fingers."""
    for name, most in (("panda", 0.081), ("allegro_right", 0.3)):
        hand = load_hand(name)
        best = preshapes(hand, np.random.default_rng(7))[0]
        assert best.imbalance < 0.1 and 0 <= best.width < most
        assert np.isclose(np.linalg.norm(best.axis_h), 1) and abs(best.axis_h @ best.out_h) < 1e-9
        assert np.all(best.opened >= hand.lower - 1e-9) and np.all(best.closed <= hand.upper + 1e-9)


def test_without_a_reserve_samples_are_ranked_by_what_they_withstand(allegro, ball):
    """Quickly looked at, too: their squeezes say nothing there."""
    from pinograsp.synthesis.found import hold

    closure = find_grasps(allegro, ball, count=4, seed=3, jobs=1, **SETTINGS).best.closure
    bare = replace(CONDITIONS, reserve=None)
    (_, quick), (_, whole) = (hold(closure, bare, quick=quick) for quick in (True, False))
    assert quick.quality > 0.0 and quick.worth == whole.worth
    (_, quick), (_, whole) = (hold(closure, CONDITIONS, quick=quick) for quick in (True, False))
    assert quick.sound == whole.sound and quick.squeeze >= 0.9 * whole.squeeze


@pytest.mark.no_cover
def test_the_result_depends_on_the_seed_alone(allegro, ball, found):
    again = find_grasps(allegro, ball, count=16, seed=3, jobs=2, **SETTINGS)
    assert again.outcomes == found.outcomes
    assert [p.quality for p in again.grasps] == pytest.approx([p.quality for p in found.grasps], rel=1e-6)
    other = find_grasps(allegro, ball, count=4, seed=4, jobs=1, **SETTINGS)
    assert [p.quality for p in other.grasps] != [p.quality for p in found.grasps][: len(other.grasps)]


def test_the_best_placement_can_be_planned(found):
    plan = plan_grasp_on(found.best.closure.hand, found.best.closure, CONDITIONS)
    assert plan.forces.status is Status.OK and plan.forces.certificate.relative_gap <= 1e-6
    assert plan.motion.tracking_error.max() < 1e-6


def test_hands_with_coupled_joints_are_placed():
    gripper = load_hand("panda")
    search = find_grasps(gripper, Sphere(radius=0.02, mass=0.1), count=6, jobs=2, **SETTINGS)
    assert search.tried == 6 and search.best.load_factor > 1


@pytest.mark.parametrize(
    "name, shape",
    [
        # One thing for one of the hands; the others take minutes.
        pytest.param(name, shape, marks=[] if shape == quick else [pytest.mark.slow])
        for name, quick in zip(own_hands.HANDS, ("", "", "cylinder"))
        for shape in ("cylinder", "box", "sphere")
    ],
)
@pytest.mark.no_cover
def test_hands_that_nobody_ships_hold_things(tmp_path, name, shape):
    """Mimic jaws, coupled fingers, sliding jaws from plain URDF text: certified, balanced, within their effort limits."""
    hand = load_hand(own_hands.write(tmp_path, name))
    thing = {
        "cylinder": Cylinder(radius=0.015, height=0.08, mass=0.1),
        "box": Box(size=(0.025, 0.03, 0.07), mass=0.1),
        "sphere": Sphere(radius=0.018, mass=0.05),
    }[shape]
    best = find_grasps(hand, thing, count=16, seed=1, **SETTINGS).best
    plan = plan_grasp_on(best.closure.hand, best.closure, CONDITIONS)
    certificate = plan.forces.certificate
    assert plan.forces.status is Status.OK and plan.problem.balance == "wrench" and certificate.relative_gap <= 1e-6
    assert plan.forces.residual_force < 1e-8 and plan.forces.residual_moment < 1e-8
    assert np.all(np.abs(plan.motion.torques[-1]) <= hand.effort * (1 + 1e-6))
    assert best.load_factor > 1.2


@pytest.mark.slow
def test_wrapped_grasps_rest_on_the_palm():
    hand, pen = load_hand("humanoid"), Cylinder(radius=0.022, height=0.14, mass=0.1)
    wrapped, loose = (find_grasps(hand, pen, count=24, seed=2, wrap=wrap, **SETTINGS) for wrap in (True, False))

    def touches(search):
        return [len(one.closure.touches) for one in search.grasps]

    assert len(wrapped.grasps) >= 2 and len(loose.grasps) >= 2
    assert np.mean(touches(wrapped)) > np.mean(touches(loose)) + 1
    at_start = [touch for one in wrapped.grasps for touch in one.closure.touches if touch.at == 0]
    assert any(touch.finger == PALM for touch in at_start)
    for one in wrapped.grasps:
        assert clearance(one.closure.hand, pen, one.closure.q) > -1e-6


@pytest.mark.parametrize("jobs", slow_except([1, 2], 2))
def test_objects_of_ones_own_class_are_placed(jobs):
    class Ball(Sphere):
        """No module knows it by name."""

    search = find_grasps(load_hand("humanoid"), Ball(radius=0.02, mass=0.05), count=8, jobs=jobs, **SETTINGS)
    assert search.tried % 8 == 0 and not search.interrupted  # in one round or several
    assert all(type(one.closure.object) is Ball for one in search.grasps)


@pytest.mark.slow
def test_no_grasp_says_why(allegro):
    heavy = Cylinder(radius=0.03, height=0.1, mass=500.0)
    search = find_grasps(allegro, heavy, count=3, jobs=1, **SETTINGS)
    assert search.grasps == ()
    with pytest.raises(GraspNotFound, match="no grasp of 12 samples holds the object: .*"):
        _ = search.best
    with pytest.raises(InvalidInput, match="count"):
        find_grasps(allegro, heavy, count=0, **SETTINGS)


@pytest.mark.parametrize(
    "settings, message",
    [
        ({"mu": [0.7, 0.7]}, "mu: expected a finite number"),
        ({"mu": 0.7, "friction": 3}, "friction"),
        ({"mu": 0.7, "torque_limit": "plenty"}, "torque limit"),
        ({"mu": 0.7, "torque_limit": [1, 2]}, "torque limit"),
        ({"mu": 0.7, "max_depth": -1.0}, "maximum depth"),
        ({"mu": -0.1}, "mu"),
    ],
)
def test_unusable_settings_are_told_before_anything_is_tried(allegro, ball, settings, message):
    with pytest.raises(InvalidInput, match=message) as told:
        find_grasps(allegro, ball, GraspConditions(**settings), count=10_000, progress=False)
    assert told.value.__cause__ is None
    with pytest.raises(InvalidInput, match="impact time"):
        find_grasps(allegro, ball, count=10_000, impact_time=2.0, **SETTINGS)
    for other in (0.7, {"mu": 0.7}, None):
        with pytest.raises(InvalidInput, match="conditions: expected a GraspConditions"):
            find_grasps(allegro, ball, other)


class Failing(Sphere):
    """What others write may fail, though not as it is made."""

    made = False

    def __post_init__(self):
        super().__post_init__()
        self._set(made=True)

    @property
    def bounding_radius(self):
        if self.made:
            raise ValueError("no radius today")
        return self.radius


class Deadly(Sphere):
    """In copies of the test's own process."""

    home = os.getpid()

    @property
    def bounding_radius(self):
        if os.getpid() != self.home:
            os._exit(1)
        return self.radius


@pytest.mark.parametrize("jobs", [1, 2])
def test_errors_of_samples_are_one_message(jobs):
    with pytest.raises(PinograspError, match="ValueError: no radius today .in bounding_radius") as told:
        find_grasps(load_hand("panda"), Failing(radius=0.02, mass=0.1), count=4, jobs=jobs, **SETTINGS)
    assert told.value.__cause__ is None and "joblib" not in str(told.value)


def test_lost_processes_are_one_message():
    with pytest.raises(PinograspError, match="a process was lost"):
        find_grasps(load_hand("panda"), Deadly(radius=0.02, mass=0.1), count=12, jobs=2, **SETTINGS)


@pytest.mark.slow
@pytest.mark.no_cover
def test_effort_limits_mean_the_same_everywhere():
    """Joints without one are not limited, and named."""
    ball, free = Sphere(radius=0.02, mass=0.05), load_hand("humanoid", hulls=True)
    first = find_grasps(free, ball, count=4, jobs=1, **SETTINGS).best.closure
    model = first.hand.model.copy()
    model.effortLimit[::2] = 0.0
    drives = list(first.hand.drives)
    drives[::2] = [replace(drive, limit=np.inf) for drive in drives[::2]]
    part = replace(first.hand, model=model).with_drives(drives)
    closure = replace(first, hand=part)
    plan = plan_grasp_on(part, closure, CONDITIONS)
    limited = plan.problem.torques.limited
    assert not limited[::2].any() and limited[1::2].all()
    (caution,) = [text for text in plan.cautions if "no torque limits are known" in text]
    moving = np.abs(plan.problem.torques.jacobian).max(axis=(0, 1)) > 0
    assert [name in caution for name in np.array(part.joint_names)[::2][moving[::2]]] == [True] * moving[::2].sum()
    assert find_grasps(part, ball, count=2, jobs=1, **SETTINGS).grasps
    model.effortLimit[:] = 0.0
    part = part.with_drives([replace(drive, limit=np.inf) for drive in part.drives])
    closure = replace(first, hand=part)
    assert plan_grasp_on(part, closure, CONDITIONS).problem.torques is None
    assert plan_grasp(part, plan.problem, torque_limit="effort").problem.torques is None
    assert find_grasps(part, ball, count=2, jobs=1, **SETTINGS).grasps


class Interrupting(Sphere):
    """Ctrl-C comes while samples are made, the second time where exceptions get lost."""

    asked = 0
    lost = False

    @property
    def bounding_radius(self):
        type(self).asked += 1
        if self.asked == 200:
            if self.lost:
                gone = {0}
                keep = weakref.ref(gone, lambda _: signal.raise_signal(signal.SIGINT))
                del gone
                assert keep() is None
            else:
                signal.raise_signal(signal.SIGINT)
        return self.radius


@pytest.mark.slow
@pytest.mark.parametrize("lost", [False, True])
def test_what_was_found_until_ctrl_c_is_kept(lost, monkeypatch):
    monkeypatch.setattr(sys, "unraisablehook", lambda _: None)
    monkeypatch.setattr(Interrupting, "asked", 0)
    monkeypatch.setattr(Interrupting, "lost", lost)
    search = find_grasps(load_hand("panda"), Interrupting(radius=0.02, mass=0.1), count=200, jobs=1, **SETTINGS)
    assert search.interrupted and 0 < search.tried < 200 and sum(search.outcomes.values()) == search.tried


STOPPED = """
import pinograsp as pg
from pinograsp.synthesis import find_grasps
from pinograsp.synthesis.preshapes import preshapes
from pinograsp.synthesis.seeds import find_pairs
if __name__ == "__main__":
    print("started", flush=True)
    search = find_grasps(pg.load_hand("allegro_right"), pg.Sphere(radius=0.03, mass=0.15), count=100_000, conditions=pg.GraspConditions(mu=0.7), jobs=2, progress=False)
    print(search.interrupted, search.tried < 100_000, sum(search.outcomes.values()) == search.tried)
"""


@pytest.mark.slow
@pytest.mark.parametrize(("everybody", "pause"), [(True, 6.0), (False, 7.0)])
def test_ctrl_c_stops_a_search_on_all_cores(tmp_path, everybody, pause):
    """From a terminal, which tells all processes, and to the one alone."""
    running = subprocess.Popen(
        [sys.executable, "-c", STOPPED],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    assert running.stdout.readline() == "started\n"
    time.sleep(pause)
    (os.killpg if everybody else os.kill)(running.pid, signal.SIGINT)
    out, err = running.communicate(timeout=240)
    assert (out.split(), err, running.returncode) == (["True"] * 3, "", 0)


@pytest.mark.slow
@pytest.mark.parametrize("everybody", [True, False])
def test_ctrl_c_writes_nothing_and_exits_with_130(tmp_path, everybody):
    command = [
        sys.executable,
        "-m",
        "pinograsp.cli",
        "plan",
        "--hand",
        "allegro_right",
        "--object",
        "sphere:radius=0.03,mass=0.15",
        "--samples",
        "5000",
    ]
    running = subprocess.Popen(
        command,
        cwd=tmp_path,
        env={name: value for name, value in os.environ.items() if name != "LOKY_MAX_CPU_COUNT"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    time.sleep(12.0)
    (os.killpg if everybody else os.kill)(running.pid, signal.SIGINT)
    out, err = running.communicate(timeout=240)
    assert running.returncode == 130 and "of 5000 samples tried" in err and "Traceback" not in err
    assert out == "" and list(tmp_path.iterdir()) == []


@pytest.mark.slow
def test_contacts_where_links_are_hollow_come_last_and_are_told(monkeypatch):
    """Against trimesh: how far the links' own meshes are from contact points on their hulls."""
    monkeypatch.setattr(
        "pinograsp.synthesis.samples._MOST_TRIES", 0
    )  # the search leaves hollow places alone where it can
    monkeypatch.setattr("pinograsp.synthesis.search_run.BATCH", 1)
    body = Cylinder(radius=0.03, height=0.12, mass=0.2)
    search = find_grasps(load_hand("talos_left"), body, count=12, seed=3, jobs=1, **SETTINGS)
    seen = []
    for grasp in search.grasps:
        hand, contacts = grasp.closure.hand, grasp.closure.contacts()
        data = hand.model.createData()
        pin.forwardKinematics(hand.model, data, contacts.posture)
        gaps = behind_hulls(hand, contacts)
        for contact, gap in zip(contacts, gaps):
            joint = 0 if contact.finger == PALM else hand.finger(contact.finger).joint_of(contact.link)
            near = [
                trimesh.proximity.closest_point(
                    trimesh.Trimesh(
                        own.vertices(), [[own.tri_indices(i)[c] for c in range(3)] for i in range(own.num_tris)]
                    ),
                    [(data.oMi[joint] * one.placement).actInv(contact.point_o)],
                )[1][0]
                for one, own in zip(hand.geometry.geometryObjects, hand.own_shapes)
                if one.parentJoint == joint
            ]
            assert gap == pytest.approx(min(near), abs=1e-5)
            seen.append(gap > 1e-3)
        try:
            plan = plan_grasp_on(hand, grasp.closure, CONDITIONS)
        except NoGrasp:
            assert grasp is not search.best
            continue
        share = plan.forces.normal_forces[gaps > 1e-3].sum() / plan.forces.normal_forces.sum()
        if plan.reserve is not None and share > 0.05:
            assert plan.status is not Status.OK
        assert any("hollow" in caution for caution in plan.cautions) == bool((gaps > 1e-3).any())
    assert any(seen) and not all(seen)  # both kinds were looked at
    ranks = [grasp.sound for grasp in search.grasps]
    assert ranks == sorted(ranks, reverse=True)


@pytest.mark.slow
def test_fingers_that_are_not_mirror_images_hold_a_box():
    """Both fingers of this hand bend the same way: they oppose each other where one is further on its way."""
    body = Box(size=(0.037, 0.037, 0.098), mass=0.04)
    search = find_grasps(load_hand("sake_left"), body, count=16, seed=4, jobs=1, **SETTINGS)
    q = np.array([grasp.closure.q for grasp in search.grasps if grasp.withstands])
    assert len(q) and (np.abs(q[:, 0] - q[:, 1]) > 0.3).any()


@pytest.mark.slow
def test_what_in_a_description_is_in_the_way_is_said(tmp_path):
    """Fingers that cannot touch are refused; joints that no motor moves are named where nothing is found."""
    path = tmp_path / "gripper.urdf"
    path.write_text(own_hands.PLANAR_GRIPPER)
    gripper = load_hand(path)
    bare = gripper.geometry.copy()
    for one in list(bare.geometryObjects):
        if one.parentJoint:
            bare.removeGeometryObject(one.name)
    with pytest.raises(InvalidInput, match="no finger has collision geometry"):
        find_grasps(replace(gripper, geometry=bare), Sphere(radius=0.02, mass=0.05), count=4, **SETTINGS)
    limp = gripper.with_drives([])
    nothing = find_grasps(limp, Sphere(radius=0.3, mass=0.05), count=4, jobs=1, **SETTINGS)
    assert not nothing.grasps and "No motor moves the finger joints left_hinge" in nothing.explain()


def test_fingers_take_part_before_the_squeeze_counts(allegro, ball, found):
    """Three of four fingers as a person would, two where pinches are wished; more than there are, never."""
    for grasps, wanted in ((found.grasps, 3), (_pinches(allegro, ball).grasps, 2)):
        assert {one.wanted_fingers for one in grasps} == {wanted}
        ranks = [(one.sound, min(one.fingers, wanted), -one.squeeze) for one in grasps]
        assert ranks == sorted(ranks, reverse=True)
        for one in grasps:
            assert one.fingers == len({touch.finger for touch in one.closure.touches if touch.finger not in ("", PALM)})
    with pytest.raises(InvalidInput, match="least_fingers"):
        find_grasps(allegro, ball, wishes=Wishes(least_fingers=5), **SETTINGS)


def _pinches(allegro, ball):
    return find_grasps(allegro, ball, count=16, seed=3, jobs=1, wishes=Wishes(least_fingers=2), **SETTINGS)
