"""The hand-over: smoothness by finite differences, round trips, ROS 2's message definition, MuJoCo's own kinematics and
forces.
"""

from __future__ import annotations

import csv
import itertools
import json
import os
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import mujoco
import numpy as np
import pinocchio as pin
import pytest
from marks import slow_except

import pinograsp as pg
from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.handover import JointTrajectory, joint_trajectory, read_csv, read_ros2
from pinograsp.motion import MotionSpec, plan_motion
from pinograsp.planner import load_run, save_run
from pinograsp.simulation import Servo
from pinograsp.simulation.scene import build

COLUMNS = ("q", "dq", "ddq", "effort")


def closed(name, body, position, quaternion):
    """The hand closed on the body from a place [m] and orientation (x, y, z, w) of its root that a search has found."""
    turn = pin.Quaternion(np.array(quaternion)).normalized().toRotationMatrix()
    hand = pg.load_hand(name).placed(pin.SE3(turn, np.array(position)).homogeneous)
    friction = pg.Friction(model="cone", safety=1.2)
    return pg.plan_grasp_on(hand, body, pg.GraspConditions(mu=0.7, friction=friction, reserve=None))


@pytest.fixture(scope="module")
def paper(paper_plan):
    return paper_plan


@pytest.fixture(scope="module")
def psyonic():
    """Coupled joints; the acceleration of one finger jumps at impact."""
    return closed(
        "psyonic_left", pg.Sphere(radius=0.03, mass=0.1), (0.1085, 0.0016, 0.0123), (0.6187, -0.5553, -0.4522, 0.3231)
    )


@pytest.fixture(scope="module")
def panda():
    """A sliding joint that another follows."""
    return closed(
        "panda", pg.Box(size=[0.03, 0.03, 0.08], mass=0.1), (0.0769, 0.0, 0.0848), (0.0, 0.9351, 0.0, -0.3545)
    )


@pytest.fixture(scope="module")
def allegro():
    """Joints that are stopped by their limits within the grasp phase, and still move at t_F."""
    return closed(
        "allegro_right", pg.Sphere(radius=0.03, mass=0.1), (0.0511, -0.0154, -0.02), (0.1018, 0.7958, -0.3877, -0.454)
    )


@pytest.fixture(params=["paper", "psyonic", "panda", "allegro"])
def plan(request):
    return request.getfixturevalue(request.param)


def elsewhere(plan, by=0.1):
    """A start posture that is not the plan's first, within the limits."""
    hand, first = plan.hand, plan.motion.q[0]
    middle = 0.5 * (hand.lower + hand.upper)
    return first + by * (hand.upper - hand.lower) * np.where(first > middle, -1, 1)


def inside_blends(trajectory, times):
    return np.any([(times > a - 1e-9) & (times < b + 1e-9) for a, b in trajectory.blends], axis=0)


# -- smoothness --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_plans_come_up_to_the_acceleration_at_impact(psyonic, allegro, paper):
    """The last step of the approach's acceleration is no larger than its steps before."""
    for plan in (psyonic, allegro, paper):
        motion = plan.motion
        steps = np.abs(np.diff(motion.ddq[: motion.impact + 1], axis=0)).max(axis=1)
        assert steps[-1] < 2 * steps[:-1].max()
        assert len(joint_trajectory(plan).blends) >= 1  # there is always one at t_F


@pytest.mark.parametrize("start", [False, True])
def test_acceleration_is_continuous_everywhere(plan, start):
    """The largest step of ddq, with rest before and after, goes to zero with the time step."""
    settings = {"start": elsewhere(plan), "lead": 0.5} if start else {}
    steps = []
    for rate in (2e3, 4e3, 8e3, 16e3):
        one = joint_trajectory(plan, rate=rate, **settings)
        padded = np.vstack([np.zeros(plan.hand.n), one.ddq, np.zeros(plan.hand.n)])
        steps.append(np.abs(np.diff(padded, axis=0)).max())
    assert all(finer < 0.55 * coarser for coarser, finer in itertools.pairwise(steps))
    assert steps[-1] < 0.04 * np.abs(one.ddq).max()


def test_rates_are_the_derivatives(plan):
    """A central difference is the mean of the rate over two steps: no further off than the rate changes in one."""
    one = joint_trajectory(plan, rate=32e3, start=elsewhere(plan))
    two_steps = 2 / 32e3
    for values, rates in ((one.q, one.dq), (one.dq, one.ddq)):
        numeric = (values[2:] - values[:-2]) / two_steps
        step = np.abs(np.diff(rates, axis=0)).max()
        assert np.abs(numeric - rates[1:-1]).max() < 0.6 * step + 1e-9
        assert step < 0.02 * np.abs(rates).max()
    # Where it is a plain polynomial, to the error of central differences.
    lead = one.times[1:-1] < one.begin - two_steps
    numeric = (one.q[2:] - one.q[:-2]) / two_steps
    assert np.abs(numeric - one.dq[1:-1])[lead].max() < 1e-6


def test_starts_and_ends_at_rest(plan):
    start = elsewhere(plan)
    one = joint_trajectory(plan, start=start, rate=333.0)
    assert np.array_equal(one.q[0], start) and np.array_equal(one.q[-1], plan.motion.q[-1])
    for values in (one.dq, one.ddq):
        assert not values[0].any() and not values[-1].any()
    assert one.effort[-1] == pytest.approx(plan.motion.holding_torques, abs=1e-9)
    assert one.times == pytest.approx(np.arange(one.times.size) / 333.0, abs=1e-12)
    assert one.final_time <= one.times[-1] <= one.final_time + 0.005 + 1 / 333.0
    limit = plan.hand.velocity
    before = one.times < one.begin
    assert np.all((np.abs(one.dq[before]).max(axis=0) <= 0.5 * limit + 1e-12) | (limit == 0))


def test_the_way_from_the_start_takes_its_time(psyonic, panda):
    """At half the velocity limits and 1 rad/s, 0.05 m/s at most; a shorter one on request, down to the limits."""
    model = psyonic.hand.model.copy()
    model.velocityLimit[:] = 0.5
    slow = replace(psyonic, hand=replace(psyonic.hand, model=model))
    for plan, peak in ((slow, 0.25), (psyonic, 1.0), (panda, 0.05)):
        one = joint_trajectory(plan, start=elsewhere(plan, 0.5), rate=200.0)
        assert 0.97 * peak < np.abs(one.dq[one.times < one.begin]).max() <= peak * (1 + 1e-9)
    way = np.abs(slow.motion.q[0] - elsewhere(slow, 0.5)).max()
    shortest = joint_trajectory(slow, start=elsewhere(slow, 0.5), lead=1.875 * way / 0.5)
    before = shortest.times < shortest.begin
    assert np.abs(shortest.dq[before]).max() == pytest.approx(0.5, rel=1e-4)


def test_a_start_with_the_papers_acceleration_is_blended(paper):
    moved = plan_motion(paper.hand, paper.solution, MotionSpec(start={}, acceleration_at_start="paper", samples=1))
    plan = replace(paper, motion=moved)
    assert np.abs(moved.ddq[0]).max() > 1.0
    steps = []
    for rate in (4e3, 16e3):
        one = joint_trajectory(plan, rate=rate, start=elsewhere(plan), lead=0.5)
        assert one.begin == pytest.approx(0.505) and one.blends[0] == pytest.approx((0.5, 0.51))
        assert one.deviation.max() < 1e-4
        steps.append(np.abs(np.diff(one.ddq, axis=0)).max())
    assert steps[1] < 0.3 * steps[0]
    alone = joint_trajectory(plan)
    assert not alone.dq[0].any() and not alone.ddq[0].any() and alone.begin == pytest.approx(0.005)


# -- fidelity ----------------------------------------------------------------------------------------------------------


def test_stays_within_the_stated_deviation(plan):
    """At every sample of the plan; contact points by Pinocchio's kinematics, written again."""
    motion, hand, contacts = plan.motion, plan.hand, plan.problem.contacts
    for settings in ({"rate": 1000.0}, {"rate": 125.0}, {"rate": 1000.0, "blend": 0.02, "start": elsewhere(plan)}):
        one = joint_trajectory(plan, **settings)
        q = one.at(one.begin + motion.times)[0]
        off = np.abs(q - motion.q)
        assert np.all(off.max(axis=0) <= one.deviation + 1e-12)
        assert one.deviation.max() < 2e-3 and max(one.contact_deviation.values()) < 5e-5
        data, worst = hand.model.createData(), np.zeros(len(contacts))
        frames = [hand.model.frames[hand.frame_id(contact.link)] for contact in contacts]

        def points(q, local):
            pin.forwardKinematics(hand.model, data, q)
            return np.array([data.oMi[frame.parentJoint].act(p) for frame, p in zip(frames, local)])

        pin.forwardKinematics(hand.model, data, motion.q[motion.impact])
        local = [data.oMi[frame.parentJoint].actInv(contact.point_o) for frame, contact in zip(frames, contacts)]
        for i in range(0, motion.times.size, 5):
            worst = np.maximum(worst, np.linalg.norm(points(q[i], local) - points(motion.q[i], local), axis=1))
        assert list(one.contact_deviation) == list(contacts.names)
        assert np.all(worst <= np.array(list(one.contact_deviation.values())) + 1e-12)
    default = joint_trajectory(plan)
    assert default.deviation.max() < 3e-4 and max(default.contact_deviation.values()) < 1e-5  # 10 micrometres


def test_outside_the_blends_it_is_the_plan(plan):
    motion, one = plan.motion, joint_trajectory(plan, rate=1000.0)
    free = ~inside_blends(one, motion.times)
    assert free.sum() > 0.9 * free.size
    q, dq, ddq, _ = one.at(motion.times)
    approach = free & (np.arange(free.size) < motion.impact)
    assert np.abs(q - motion.q)[free].max() < 1e-6
    for mine, theirs in ((q, motion.q), (dq, motion.dq), (ddq, motion.ddq)):
        assert np.abs(mine - theirs)[approach].max() < 2e-4 * max(1.0, np.abs(theirs).max())


def test_shorter_blends_stay_closer(psyonic):
    off = [joint_trajectory(psyonic, rate=4000.0, blend=blend).deviation.max() for blend in (0.02, 0.01, 0.005)]
    assert off[0] > 1.5 * off[1] > 2 * off[2]


def test_efforts_are_the_plans_torques(paper, psyonic, panda):
    for plan in (paper, psyonic, panda):
        motion, one = plan.motion, joint_trajectory(plan, rate=1000.0)
        at = np.rint(1000 * motion.times).astype(int)
        assert np.abs(one.times[at] - motion.times).max() < 1e-12  # these plans are sampled in whole milliseconds
        free, before = ~inside_blends(one, motion.times), np.arange(at.size) < motion.impact
        off = np.abs(one.effort[at] - motion.torques)
        assert off[free & before].max() < 1e-9 * max(1.0, motion.peak_torque)
        assert off[free].max() < 1e-3 * motion.peak_torque  # rates of the grasp phase come from positions here


@pytest.mark.slow
def test_a_stored_run_gives_the_same(panda, tmp_path):
    folder = save_run(panda, tmp_path / "run")
    mine, theirs = joint_trajectory(panda), joint_trajectory(load_run(folder))
    for name in ("times", *COLUMNS, "deviation"):
        assert getattr(theirs, name) == pytest.approx(getattr(mine, name), abs=1e-12)
    assert theirs.contact_deviation == pytest.approx(mine.contact_deviation)
    assert theirs.notes == mine.notes and str(panda.status) in mine.notes[0]


def test_followers_follow(psyonic, panda):
    for plan in (psyonic, panda):
        one = joint_trajectory(plan, rate=100.0)
        every, hand = one.with_followers(), plan.hand
        assert one.names == hand.joint_names and every.names == tuple(hand.model.names)[1:]
        assert set(every.names) - set(one.names) == set(hand.couplings)
        for name, coupling in hand.couplings.items():
            i, leader = every.names.index(name), every.names.index(coupling.followed)
            assert every.q[:, i] == pytest.approx(coupling.factor * every.q[:, leader] + coupling.offset, abs=1e-15)
            assert every.dq[:, i] == pytest.approx(coupling.factor * every.dq[:, leader], abs=1e-15)
            assert every.ddq[:, i] == pytest.approx(coupling.factor * every.ddq[:, leader], abs=1e-13)
            assert not every.effort[:, i].any()
            assert every.deviation[i] == pytest.approx(abs(coupling.factor) * every.deviation[leader], abs=1e-18)
        for name in one.names:
            assert np.array_equal(every.q[:, every.names.index(name)], one.q[:, one.names.index(name)])
        assert every.with_followers() is every


# -- files -------------------------------------------------------------------------------------------------------------


def same(one, other):
    assert one.names == other.names
    for name in ("times", *COLUMNS):
        assert getattr(one, name) == pytest.approx(getattr(other, name), rel=0, abs=1e-9)


@pytest.mark.parametrize("followers", [False, True])
def test_csv_comes_back(psyonic, tmp_path, followers):
    path = tmp_path / "deeper" / "plan.csv"
    written = psyonic.to_csv(path, rate=250.0, start=elsewhere(psyonic), followers=followers)
    same(read_csv(path), written)
    assert len(written.names) == (10 if followers else 6)
    with open(path, newline="") as file:
        header = next(csv.reader(file))
    assert header[:2] == ["time", f"{written.names[0]}/position"] and header[-1] == f"{written.names[-1]}/effort"
    assert [one.name for one in path.parent.iterdir()] == ["plan.csv"]


# The definitions, as ROS 2 has them.
MESSAGES = {
    "trajectory_msgs/JointTrajectory": """
        std_msgs/Header header
        string[] joint_names
        trajectory_msgs/JointTrajectoryPoint[] points""",
    "trajectory_msgs/JointTrajectoryPoint": """
        float64[] positions
        float64[] velocities
        float64[] accelerations
        float64[] effort
        builtin_interfaces/Duration time_from_start""",
    "std_msgs/Header": """
        builtin_interfaces/Time stamp
        string frame_id""",
    "builtin_interfaces/Time": """
        int32 sec
        uint32 nanosec""",
    "builtin_interfaces/Duration": """
        int32 sec
        uint32 nanosec""",
}


def conforms(value, kind):
    if kind.endswith("[]"):
        assert isinstance(value, list)
        for one in value:
            conforms(one, kind[:-2])
    elif kind in MESSAGES:
        fields = dict(reversed(line.split()) for line in MESSAGES[kind].strip().splitlines())
        assert set(value) == set(fields)
        for name, one in fields.items():
            conforms(value[name], one)
    elif kind == "float64":
        assert type(value) is float and np.isfinite(value)
    elif kind == "string":
        assert type(value) is str
    else:
        low, high = {"int32": (-(2**31), 2**31 - 1), "uint32": (0, 2**32 - 1)}[kind]
        assert type(value) is int and low <= value <= high


def check_message(message, names):
    """Structure, and what JointTrajectoryController asks for: sizes, increasing times, rest at the end."""
    conforms(message, "trajectory_msgs/JointTrajectory")
    assert tuple(message["joint_names"]) == names
    before = -1
    for point in message["points"]:
        at = point["time_from_start"]
        assert 0 <= at["nanosec"] < 10**9
        now = at["sec"] * 10**9 + at["nanosec"]
        assert now > before
        before = now
        assert {len(point[name]) for name in ("positions", "velocities", "accelerations")} == {len(names)}
    assert not any(message["points"][-1]["velocities"])


@pytest.mark.parametrize("suffix", [".yaml", ".yml", ".json"])
@pytest.mark.parametrize("goal", [False, True])
def test_ros2_message_comes_back(psyonic, tmp_path, suffix, goal):
    path, settings = tmp_path / f"plan{suffix}", {"rate": 40.0, "start": elsewhere(psyonic), "lead": 1.0}
    message = psyonic.to_ros2(path, goal=goal, **settings)
    same(read_ros2(path), joint_trajectory(psyonic, **settings))
    if suffix == ".json":
        assert json.loads(path.read_text()) == message
    inner = message["trajectory"] if goal else message
    check_message(inner, psyonic.hand.joint_names)
    assert {len(point["effort"]) for point in inner["points"]} == {psyonic.hand.n}
    assert inner["points"][40]["time_from_start"] == {"sec": 1, "nanosec": 0}
    assert message == psyonic.to_ros2(goal=goal, **settings)


def test_ros2_tools_read_the_same(panda, tmp_path):
    """They read YAML 1.1, where 1e-05 and on are no number and no name."""
    yaml = pytest.importorskip("yaml")
    one = replace(joint_trajectory(panda, rate=50.0), names=("on",), couplings={})
    numbers = np.array(one.dq)
    numbers[1:5, 0] = 1e-5, -1e-300, 1e16, 1.5e-7
    message = replace(one, dq=numbers).to_ros2(tmp_path / "plan.yaml", frame="yes: no")
    read = yaml.safe_load((tmp_path / "plan.yaml").read_text())
    check_message(read, ("on",))
    assert read == message


def test_ros2_without_efforts_and_with_followers(panda):
    message = panda.to_ros2(rate=50.0, effort=False, followers=True, frame="palm")
    check_message(message, tuple(panda.hand.model.names)[1:])
    assert all(point["effort"] == [] for point in message["points"])
    assert message["header"]["frame_id"] == "palm"


def test_files_are_whole_or_not_there(panda, tmp_path, monkeypatch):
    path = tmp_path / "plan.csv"
    path.write_text("as it was")

    def broken(*_):
        raise OSError("no space left")

    monkeypatch.setattr(os, "replace", broken)
    with pytest.raises(ResultsNotWritten, match="no space left"):
        panda.to_csv(path)
    monkeypatch.undo()
    assert path.read_text() == "as it was" and list(tmp_path.iterdir()) == [path]
    with pytest.raises(ResultsNotWritten, match="cannot write"):
        panda.to_ros2(path / "below.json")
    panda.to_csv(path, rate=50.0)
    assert read_csv(path).names == panda.hand.joint_names
    umask = os.umask(0)
    os.umask(umask)
    assert path.stat().st_mode & 0o777 == 0o666 & ~umask


# -- MuJoCo ------------------------------------------------------------------------------------------------------------


def mjcf_of(hand, *, actuators="", tendons="", include="", mirrored=False, extra=""):
    """A hand's tree in MuJoCo's XML, from Pinocchio's placements to full precision; ``mirrored``: its branches in
    another order.
    """
    model, data = hand.model, hand.model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))

    def text(values):
        return " ".join(repr(float(v)) for v in values)

    def body(j):
        at, motion = model.jointPlacements[j], np.array(data.joints[j].S).ravel()
        slides = hand.is_prismatic(j)
        axis = (motion[:3] if slides else motion[3:]) / hand.ratio(j)
        children = [c for c in range(1, model.njoints) if model.parents[c] == j]
        return (
            f'<body name="link {j}" pos="{text(at.translation)}" '
            f'quat="{text(pin.Quaternion(at.rotation).coeffs()[[3, 0, 1, 2]])}">'
            f'<joint name="{model.names[j]}" type="{"slide" if slides else "hinge"}" axis="{text(axis)}"/>'
            f'<inertial pos="0 0 0" mass="0.1" diaginertia="1e-4 1e-4 1e-4"/>'
            + "".join(body(c) for c in (children[::-1] if mirrored else children))
            + "</body>"
        )

    roots = [j for j in range(1, model.njoints) if model.parents[j] == 0]
    bodies = "".join(body(j) for j in (roots[::-1] if mirrored else roots))
    return (
        f'<mujoco><compiler angle="radian"/><worldbody>{extra}{bodies}</worldbody>'
        f"<tendon>{tendons}</tendon><actuator>{actuators}</actuator>{include}</mujoco>"
    )


def at_links(hand, data, q):
    wanted = hand.model.createData()
    pin.forwardKinematics(hand.model, wanted, np.array(q))
    for j in range(1, hand.model.njoints):
        assert data.body(f"link {j}").xpos == pytest.approx(wanted.oMi[j].translation, abs=1e-9)
        assert data.body(f"link {j}").xmat.reshape(3, 3) == pytest.approx(wanted.oMi[j].rotation, abs=1e-9)


def keys_of(model):
    return [model.key(i).name for i in range(model.nkey)]


def test_keyframes_of_a_hand_alone(plan, tmp_path):
    """Included in a model of the hand with one position servo per actuated joint."""
    hand = plan.hand
    one = plan.to_mujoco(tmp_path / "grasp.xml", rate=500.0, start=elsewhere(plan))
    servos = "".join(f'<position name="{name}" joint="{name}" kp="50"/>' for name in hand.joint_names)
    (tmp_path / "hand.xml").write_text(mjcf_of(hand, actuators=servos, include='<include file="grasp.xml"/>'))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    assert keys_of(model) == ["start", "impact", "final"]
    data = mujoco.MjData(model)
    impact = int(np.ceil(one.impact_time * 500 - 1e-9))
    for key, i in (("start", 0), ("impact", impact), ("final", -1)):
        mujoco.mj_resetDataKeyframe(model, data, model.key(key).id)
        mujoco.mj_forward(model, data)
        at_links(hand, data, one.q[i])
        assert data.time == pytest.approx(one.times[i], abs=1e-12)
        assert data.ctrl == pytest.approx(one.q[i], abs=1e-12)
        assert [data.qvel[model.joint(name).dofadr[0]] for name in hand.joint_names] == pytest.approx(
            one.dq[i], abs=1e-12
        )
    assert model.key("final").qpos.size == hand.model.njoints - 1
    stored = np.load(tmp_path / "grasp.npz", allow_pickle=False)
    assert tuple(stored["actuators"]) == hand.joint_names and np.array_equal(stored["ctrl"], one.q)
    assert tuple(stored["joints"]) == tuple(hand.model.names)[1:] and stored["qpos"].shape == (one.times.size, model.nq)


@pytest.mark.slow
def test_keyframes_for_somebodys_model(psyonic, tmp_path):
    """Joints in another order, under a prefix, beside a free object; the include brings the model's own numbers."""
    hand = psyonic.hand
    extra = '<body name="thing" pos="1 2 3"><freejoint/><geom size="0.01"/></body>'
    servos = "".join(f'<position name="{name}" joint="{name}" kp="50"/>' for name in reversed(hand.joint_names))
    plain = mjcf_of(hand, actuators=servos, mirrored=True, extra=extra)
    model = mujoco.MjModel.from_xml_string(plain)
    assert [model.joint(j).name for j in range(1, model.njnt)] != list(hand.model.names)[1:]
    one = psyonic.to_mujoco(tmp_path / "grasp.xml", model=model)
    (tmp_path / "hand.xml").write_text(plain.replace("</mujoco>", '<include file="grasp.xml"/></mujoco>'))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("final").id)
    mujoco.mj_forward(model, data)
    at_links(hand, data, one.q[-1])
    assert data.body("thing").xpos == pytest.approx([1, 2, 3])

    prefixed = mujoco.MjModel.from_xml_string(
        plain.replace('joint="', 'joint="left/').replace('joint name="', 'joint name="left/')
    )
    psyonic.to_mujoco(tmp_path / "left.xml", model=prefixed, prefix="left/", qpos=np.arange(prefixed.nq))
    stored = np.load(tmp_path / "left.npz")
    assert np.array_equal(stored["qpos"][:, :7], np.tile(np.arange(7.0), (one.times.size, 1)))
    assert np.array_equal(stored["qpos"][:, 7:], np.load(tmp_path / "grasp.npz")["qpos"][:, 7:])


@pytest.mark.slow
def test_actuators_of_all_kinds_make_the_efforts(psyonic, tmp_path):
    """MuJoCo's own actuator forces at qpos, qvel and ctrl, carried over to the joints that are followed, are those of its
    inverse dynamics and of the contacts: this model has other masses than the plan's hand.
    """
    hand = psyonic.hand
    follower, coupling = next(iter(hand.couplings.items()))
    f = coupling.followed
    a, b, c, d, e = (name for name in hand.joint_names if name != f)
    tendons = f'<fixed name="both"><joint joint="{f}" coef="0.4"/><joint joint="{follower}" coef="0.7"/></fixed>'
    actuators = (
        f'<motor name="motor" joint="{a}" gear="3"/>'
        f'<position name="servo" joint="{b}" kp="20" kv="0.5" gear="2"/>'
        f'<velocity name="speed" joint="{c}" kv="0.7"/>'
        f'<general name="odd" joint="{d}" gaintype="affine" gainprm="4 0.5 0.1" biastype="affine" '
        'biasprm="0.3 -5 -0.2"/>'
        f'<position name="tendon" tendon="both" kp="30"/>'
        f'<motor name="one" joint="{e}" gear="2"/><motor name="two" joint="{e}" ctrllimited="true" '
        'ctrlrange="-1e-6 1e-6"/>'
        '<adhesion name="glue" body="link 1" ctrlrange="0 1"/>'
    )
    model = mujoco.MjModel.from_xml_string(mjcf_of(hand, actuators=actuators, tendons=tendons, mirrored=True))
    one = psyonic.to_mujoco(tmp_path / "grasp.xml", model=model, rate=200.0)
    assert any("controls are 0" in note and note.endswith("glue") for note in one.notes)
    assert not any("leave their range" in note for note in one.notes)  # the other motor of this joint does it
    stored, data = np.load(tmp_path / "grasp.npz"), mujoco.MjData(model)
    assert list(stored["actuators"]) == [model.actuator(u).name for u in range(model.nu)]
    at = [model.joint(name).dofadr[0] for name in one.with_followers().names]

    def joined(forces):
        """Of all joints, at those that others follow."""
        by_name = dict(zip(one.with_followers().names, forces[at]))
        ties = hand.couplings.items()
        return [by_name[j] + sum(c.factor * by_name[i] for i, c in ties if c.followed == j) for j in hand.joint_names]

    for i in range(0, one.times.size, 17):
        data.qpos[:], data.qvel[:], data.ctrl[:] = stored["qpos"][i], stored["qvel"][i], stored["ctrl"][i]
        mujoco.mj_forward(model, data)
        made = joined(data.qfrc_actuator)
        data.qacc[at] = one.with_followers().ddq[i]
        mujoco.mj_inverse(model, data)
        # The small weight of the forces' own squares, where limits share efforts otherwise.
        assert made == pytest.approx(joined(data.qfrc_inverse) + one.contact_effort[i], abs=1e-8)
    model.actuator_ctrllimited[:], model.actuator_ctrlrange[:] = True, [-1e-6, 1e-6]
    weak = psyonic.to_mujoco(tmp_path / "a.xml", model=model, rate=200.0).notes
    assert any("too much or too little" in note and "one, two" in note for note in weak)
    without = mujoco.MjModel.from_xml_string(mjcf_of(hand, actuators=f'<motor name="only" joint="{a}"/>'))
    others = [name for name in hand.joint_names if name != a]
    assert (
        f"no actuator of the model moves {', '.join(others)}"
        in psyonic.to_mujoco(tmp_path / "a.xml", model=without).notes
    )


@pytest.mark.parametrize("name", slow_except(["paper", "psyonic", "panda"], "panda"))
def test_servos_follow_the_controls(request, tmp_path, name):
    """The simulation's model of the hand, with its servos, the object out of the way."""
    plan, dt = request.getfixturevalue(name), 5e-4
    away = pg.Sphere(radius=0.01, mass=0.1, pose=np.block([[np.eye(3), np.full((3, 1), 5.0)], [np.zeros((1, 3)), 1.0]]))
    gravity = plan.problem.gravity_o
    model, _ = build(plan.hand, away, time_step=dt, gravity_o=gravity, servo=Servo.of(plan.hand))
    path = tmp_path / "grasp.xml"
    for feed_forward, until in ((True, plan.motion.times[plan.motion.impact]), (False, np.inf)):
        one = plan.to_mujoco(path, model=model, rate=1 / dt, feed_forward=feed_forward)
        assert not one.notes or "status" in one.notes[0]
        stored, data = np.load(path.with_suffix(".npz")), mujoco.MjData(model)
        at = [model.joint(joint).qposadr[0] for joint in plan.hand.joint_names]
        data.qpos[:], data.qvel[:] = stored["qpos"][0], stored["qvel"][0]
        off = 0.0
        for i, ctrl in enumerate(stored["ctrl"]):
            if stored["times"][i] >= until:
                break
            off = max(off, np.abs(data.qpos[at] - one.q[i]).max())
            data.ctrl[:] = ctrl
            mujoco.mj_step(model, data)
        moved = np.ptp(one.q, axis=0).max()
        assert off < (0.01 if feed_forward else 0.1) * moved, (feed_forward, off, moved)


# -- bad input ---------------------------------------------------------------------------------------------------------


def test_numbers_that_cannot_be_are_refused(psyonic):
    hand, q = psyonic.hand, np.array(psyonic.motion.q[0])
    outside = q.copy()
    outside[2] = hand.upper[2] + 0.5
    for settings, words in (
        ({"rate": 0}, r"rate: expected a finite number > 0 \[Hz\], got 0"),
        ({"rate": np.nan}, "rate"),
        ({"rate": "fast"}, "rate"),
        ({"rate": 1e9}, "take a lower one"),
        ({"start": q[:-1]}, r"start: expected shape \(6,\), got \(5,\)"),
        ({"start": np.full(6, np.inf)}, "start: expected finite"),
        ({"start": outside}, rf"start: .* for {hand.joint_names[2]}, limits .*with_limits"),
        ({"start": elsewhere(psyonic), "lead": 0.0}, r"lead: expected at least 0\.\d+ s"),
        ({"start": elsewhere(psyonic), "lead": 1e-3}, r"lead: .* for the velocity limit of"),
        ({"lead": -1.0}, "lead"),
        ({"blend": 0.0}, "blend: expected a finite number > 0"),
        ({"blend": 0.04}, r"blend: expected at most 0\.025 s"),
    ):
        with pytest.raises(InvalidInput, match=words):
            joint_trajectory(psyonic, **settings)
    with pytest.raises(InvalidInput, match="plan: expected a PlanRecord"):
        joint_trajectory("plan")
    with pytest.raises(InvalidInput, match="plan: expected a PlanRecord"):
        joint_trajectory(psyonic.motion)


def test_waiting_in_the_first_posture(panda):
    one = joint_trajectory(panda, lead=0.3)
    assert one.begin == 0.3
    waiting = one.times <= 0.3
    assert np.all(one.q[waiting] == panda.motion.q[0]) and not one.dq[waiting].any()


def test_what_the_receiver_should_know_is_told(panda, psyonic):
    coarse = joint_trajectory(psyonic, rate=100.0)
    assert any("fewer than 10 samples" in note for note in coarse.notes)
    assert not any("off the plan" in note for note in coarse.notes)
    assert any("mm off the plan" in note for note in joint_trajectory(psyonic, rate=5.0).notes)
    model = psyonic.hand.model.copy()
    model.velocityLimit[:] = 0.5
    model.effortLimit[:] = 1e-3
    weak = joint_trajectory(replace(psyonic, hand=replace(psyonic.hand, model=model)))
    assert any("velocity limit of 0.5" in note for note in weak.notes)
    assert any("effort limit of 0.001" in note for note in weak.notes)
    text = coarse.describe()
    assert "blended from" in text and "off the plan by" in text and "mm at most" in text and "note:" in text


def test_files_and_models_that_are_none_are_refused(panda, tmp_path):
    with pytest.raises(InvalidInput, match="suffix of a ROS 2 message"):
        panda.to_ros2(tmp_path / "plan.txt")
    with pytest.raises(InvalidInput, match="suffix of MuJoCo"):
        panda.to_mujoco(tmp_path / "plan.json")
    with pytest.raises(InvalidInput, match=r"expected a mujoco\.MjModel"):
        panda.to_mujoco(tmp_path / "plan.xml", model="hand.xml")
    for option in ({"qpos": [0.0]}, {"feed_forward": False}, {"prefix": "left/"}):
        (name,) = option
        with pytest.raises(InvalidInput, match=f"{name}: expected with model="):
            panda.to_mujoco(tmp_path / "plan.xml", **option)
    model = mujoco.MjModel.from_xml_string(
        "<mujoco><worldbody><body><joint name='x'/><geom size='1'/></body></worldbody></mujoco>"
    )
    with pytest.raises(InvalidInput, match="expected the joints panda_finger_joint1, panda_finger_joint2, it has x"):
        panda.to_mujoco(tmp_path / "plan.xml", model=model)
    assert not list(tmp_path.iterdir())
    columns = "time,a/position,a/velocity,a/acceleration,a/effort\n"
    for content in ("time,a/position\n0,1\n", f"{columns}0,1,x,3,4\n", f"{columns}0,1\n", ""):
        (tmp_path / "a.csv").write_text(content)
        with pytest.raises(InvalidInput):
            read_csv(tmp_path / "a.csv")
    with pytest.raises(InvalidInput, match="later than the one before"):
        JointTrajectory(names=("a",), times=[0.0, 0.0], **dict.fromkeys(COLUMNS, np.zeros((2, 1))))
    with pytest.raises(InvalidInput, match="dq: expected shape"):
        JointTrajectory(
            names=("a",),
            times=[0.0, 1.0],
            q=np.zeros((2, 1)),
            dq=np.zeros((1, 1)),
            ddq=np.zeros((2, 1)),
            effort=np.zeros((2, 1)),
        )


# -- names from files of others ----------------------------------------------------------------------------------------

NAMES = (
    "=1+1",
    "+x",
    "-x",
    "@x",
    "\tx",
    "\rx",
    "'x",
    "a,b",
    'a"b',
    "a\nb",
    "-->",
    "<b>&",
    "\U0001f600",
    "\u2028",
    "\ufeffa",
    "\x1b[31m",
    "--",
    "{}: #",
    "\\U",
    "null",
    "1e5",
    "~",
)


@pytest.mark.parametrize("name", NAMES)
def test_names_of_others_come_back_and_are_no_commands(tmp_path, name):
    values = -0.5 * np.ones((2, 2))
    made = JointTrajectory(
        names=(name, "joint"), times=[0.0, 1.0], q=values, dq=values, ddq=values, effort=values, joints=(name, "joint")
    )
    made.to_csv(tmp_path / "a.csv")
    with open(tmp_path / "a.csv", newline="", encoding="utf-8") as file:
        header, *rows = csv.reader(file)
    assert not any(cell.startswith(("=", "+", "-", "@", "\t", "\r")) for cell in header)
    assert float(rows[0][1]) == -0.5  # numbers stay numbers
    made.to_ros2(tmp_path / "a.yaml", frame=name)
    made.to_ros2(tmp_path / "a.json")
    for back in (read_csv(tmp_path / "a.csv"), read_ros2(tmp_path / "a.yaml"), read_ros2(tmp_path / "a.json")):
        assert back.names == (name, "joint")
    made.to_mujoco(tmp_path / "a.xml")
    root = ElementTree.parse(tmp_path / "a.xml").getroot()
    assert [key.get("name") for key in root.iter("key")] == ["start", "final"]
