"""Drives: against MuJoCo's actuator moments and springs, against the files' own words, and against the geometry."""

from __future__ import annotations

import json
import math
import pickle
import xml.etree.ElementTree as ElementTree

import numpy as np
import pytest
from own_hands import joint, link, robot
from shipped_hands import loaded

from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import Drive, HandModel, Spring, load_hand
from pinograsp.hands.catalogue import CATALOGUE, file_of
from pinograsp.hands.efforts import find_stops, solve_efforts
from pinograsp.hands.record import hand_of, hand_record
from pinograsp.hands.summary import record

# -- MuJoCo as the oracle ----------------------------------------------------------------------------------------------

# Every kind of actuator, gains from defaults and shortcuts, tendons with signs, and followers with motors and springs.
ACTUATED = """<mujoco>
  <default>
    <geom size="0.01" pos="0.02 0 0"/><joint range="-50 70"/><position kp="7"/>
    <default class="stiff"><position kp="40" kv="0.3" forcerange="-3 2"/></default>
    <default class="affine"><general biastype="affine" gainprm="9" biasprm="0.1 -9 -0.2"/></default>
    <default class="sprung"><joint stiffness="0.4" springref="-20"/></default>
  </default>
  <worldbody><body name="palm"><geom size="0.03"/>
    <body name="a1" pos="0.05 0 0"><joint name="a1" class="sprung"/><geom/>
      <body name="a2" pos="0.04 0 0"><joint name="a2" stiffness="0.2" springref="30"/><geom/>
        <body name="a3" pos="0.04 0 0"><joint name="a3" ref="10" class="sprung"/><geom/></body></body></body>
    <body name="b1" pos="0 0.05 0"><joint name="b1" axis="0 1 0"/><geom/>
      <body name="b2" pos="0 0.04 0"><joint name="b2" axis="0 1 0" stiffness="0.1"/><geom/></body></body>
    <body name="c1" pos="0 -0.05 0"><joint name="c1" type="slide" range="0 0.03" axis="0 1 0"/><geom/></body>
    <body name="d1" pos="-0.05 0 0"><joint name="d1"/><geom/></body>
    <body name="e1" pos="-0.05 0.05 0"><joint name="e1"/><geom/></body>
    <body name="f1" pos="-0.05 -0.05 0"><joint name="f1"/><geom/></body>
  </body></worldbody>
  <tendon>
    <fixed name="flexor">
      <joint joint="a1" coef="0.011"/><joint joint="a2" coef="0.008"/><joint joint="a3" coef="-0.005"/></fixed>
    <fixed name="pair"><joint joint="b1" coef="1"/><joint joint="b2" coef="0.5"/></fixed>
  </tendon>
  <equality><joint joint1="b2" joint2="b1" polycoef="0.1 -0.8"/></equality>
  <actuator>
    <motor name="flexor" tendon="flexor" gear="2" forcerange="-30 60"/>
    <position name="pair" tendon="pair" class="stiff"/>
    <position name="follower" joint="b2" gear="-3"/>
    <general name="affine" joint="c1" class="affine" gear="4"/>
    <position name="gained" joint="d1" kp="12" kv="0.5" class="stiff"/>
    <velocity name="velocity" joint="e1" kv="0.7" forcerange="-1 1"/>
    <motor joint="d1" ctrlrange="-2 1" gear="0.5"/>
  </actuator>
</mujoco>"""
NAMES = ("flexor", "pair", "follower", "affine", "gained", "velocity", "motor d1")


@pytest.fixture
def actuated(tmp_path):
    """MuJoCo, its model and data, our hand, and E, o of its joint positions E q + o by ours."""
    mujoco = pytest.importorskip("mujoco")
    path = tmp_path / "hand.xml"
    path.write_text(ACTUATED, encoding="utf-8")
    model, hand = mujoco.MjModel.from_xml_path(str(path)), load_hand(path)
    E, o = np.zeros((model.nv, hand.n)), np.zeros(model.nv)
    for column, name in enumerate(hand.joint_names):
        E[model.joint(name).dofadr[0], column] = 1.0
    E[model.joint("b2").dofadr[0]] = -0.8 * E[model.joint("b1").dofadr[0]]
    o[model.joint("b2").dofadr[0]] = 0.1
    return mujoco, model, mujoco.MjData(model), hand, E, o


def states(hand, seed=4, count=4):
    rng = np.random.default_rng(seed)
    return [(rng.uniform(hand.lower, hand.upper), rng.normal(size=hand.n)) for _ in range(count)]


def moments(mujoco, model, state):
    dense = np.zeros((model.nu, model.nv))
    mujoco.mju_sparse2dense(dense, state.actuator_moment, state.moment_rownnz, state.moment_rowadr, state.moment_colind)
    return dense


def test_transmission_is_mujocos(actuated):
    mujoco, model, state, hand, E, o = actuated
    assert tuple(drive.name for drive in hand.drives) == NAMES
    q, _ = states(hand)[0]
    lengths = []
    for q, v in states(hand):
        state.qpos[:], state.qvel[:] = E @ q + o, E @ v
        mujoco.mj_forward(model, state)
        assert np.abs(hand.transmission - moments(mujoco, model, state) @ E).max() < 1e-14
        lengths.append(state.actuator_length - hand.transmission @ q)
    assert np.ptp(lengths, axis=0).max() < 1e-14  # the coordinate of a drive is MuJoCo's length, but for its zero
    assert np.abs(hand.transmission).max(axis=1).min() > 1e-3


def test_forces_of_the_servos_are_mujocos(actuated):
    """Effort = -kp a - kd da/dt + command, from MuJoCo's actuator_force, and the joint torques that it makes."""
    mujoco, model, state, hand, E, o = actuated
    rng = np.random.default_rng(8)
    S = hand.transmission
    kp = np.array([drive.stiffness or 0.0 for drive in hand.drives])
    kd = np.array([drive.damping or 0.0 for drive in hand.drives])
    model.actuator_forcelimited[:] = model.actuator_ctrllimited[:] = 0
    state.ctrl[:] = rng.normal(size=model.nu)
    constant = []
    for q, v in states(hand):
        state.qpos[:], state.qvel[:] = E @ q + o, E @ v
        mujoco.mj_forward(model, state)
        constant.append(state.actuator_force + kp * (S @ q) + kd * (S @ v))
        torques = E.T @ state.qfrc_actuator
        assert np.abs(torques - S.T @ state.actuator_force).max() < 1e-12
    assert np.ptp(constant, axis=0).max() < 1e-11 and np.ptp(kp) > 1
    controls = [drive.control for drive in hand.drives]
    assert controls == ["torque", "position", "position", "position", "position", "torque", "torque"]
    assert [drive.stiffness is None for drive in hand.drives] == [control == "torque" for control in controls]
    assert any(note.endswith("taken as torque motors: velocity") for note in hand.notes)


def test_limits_are_mujocos_force_ranges(actuated):
    _, model, _, hand, _, _ = actuated
    for i, drive in enumerate(hand.drives):
        if model.actuator_forcelimited[i]:
            assert drive.limit == np.abs(model.actuator_forcerange[i]).max()
        else:
            assert drive.limit == (2.0 if drive.name == "motor d1" else math.inf)  # its commands are limited


def test_springs_are_mujocos(actuated):
    """Joint torques of the springs, those of the joint that follows another included."""
    mujoco, model, state, hand, E, o = actuated
    springs = {spring.joint: spring for spring in hand.springs}
    assert set(springs) == {"a1", "a2", "a3", "b1"}
    for name in ("a1", "a2", "a3"):
        i = model.joint(name).id
        assert springs[name].stiffness == model.jnt_stiffness[i].flat[0]
        assert springs[name].rest == pytest.approx(model.qpos_spring[model.joint(name).qposadr[0]], rel=1e-12)
    for q, _ in states(hand):
        state.qpos[:], state.qvel[:] = E @ q + o, 0.0
        mujoco.mj_forward(model, state)
        ours = [
            -springs[name].stiffness * (value - springs[name].rest) if name in springs else 0.0
            for name, value in zip(hand.joint_names, q)
        ]
        assert np.abs(E.T @ state.qfrc_passive - ours).max() < 1e-13
    assert "springs: torques are without those at a1, a2, a3, b1" in hand.notes


def test_joints_without_motors_are_passive(actuated):
    hand = actuated[3]
    assert hand.passive_joints == ("f1",) and not hand.direct_drive
    assert "drives: no motor moves the joints f1" in hand.notes
    assert not hand.transmission[:, hand.joint_names.index("f1")].any()


@pytest.mark.parametrize(
    "default",
    [
        '<velocity kv="3"/>',
        '<position kp="7" kv="0.2"/>',
        '<damper kv="3"/>',
        '<general biastype="affine" gainprm="9" biasprm="0.1 -9 -0.2"/>',
        '<general biastype="affine" gaintype="affine" gainprm="9 1 -1" biasprm="0.1 -9 -0.2"/>',
        '<motor gear="2"/>',
        "",
    ],
)
def test_gains_are_inherited_as_in_mujoco(tmp_path, default):
    """Of every kind of default, every kind of actuator, against MuJoCo's compiled gains."""
    mujoco = pytest.importorskip("mujoco", minversion="4")
    kinds = ["velocity", "motor", "general", "position", 'position kp="3"', 'position kv="4"', 'velocity kv="5"']
    kinds += ["damper", 'damper kv="6"', 'general gainprm="8"']
    actuators = "".join(f'<{kind} name="{i}" joint="j" ctrlrange="0 1"/>' for i, kind in enumerate(kinds))
    text = f"""<mujoco><default>{default}</default><worldbody><body name="palm"><geom size="0.03"/>
        <body name="f" pos="0.05 0 0"><joint name="j" range="-1 1"/><geom size="0.01" pos="0.02 0 0"/></body></body>
        </worldbody><actuator>{actuators}</actuator></mujoco>"""
    (tmp_path / "gains.xml").write_text(text, encoding="utf-8")
    model, hand = mujoco.MjModel.from_xml_string(text), load_hand(tmp_path / "gains.xml")
    affine = model.actuator_biastype == mujoco.mjtBias.mjBIAS_AFFINE
    fixed = model.actuator_gaintype == mujoco.mjtGain.mjGAIN_FIXED
    stiffness, damping = np.where(affine & fixed, -model.actuator_biasprm[:, 1:3].T, 0.0)
    assert [drive.stiffness or 0.0 for drive in hand.drives] == stiffness.tolist()
    assert [drive.damping or 0.0 for drive in hand.drives] == damping.tolist()
    assert [drive.control == "position" for drive in hand.drives] == (stiffness > 0).tolist()


def mjcf(tmp_path, actuators, tendons="", root=""):
    path = tmp_path / "other.xml"
    path.write_text(
        f"""<mujoco><compiler angle="radian"/><worldbody><body name="arm"><geom size="0.05"/>
        <body name="palm"><joint name="wrist" range="-1 1"/><geom size="0.03"/><site name="s"/>
        <body name="f" pos="0.05 0 0"><joint name="j" range="-1 1"/><geom size="0.01" pos="0.02 0 0"/></body></body>
        </body></worldbody><tendon>{tendons}</tendon><actuator>{actuators}</actuator></mujoco>""",
        encoding="utf-8",
    )
    return load_hand(path, **({"root": root} if root else {}))


def test_motors_outside_of_the_hand_are_none_of_its(tmp_path):
    both = '<fixed name="t"><joint joint="wrist" coef="2"/><joint joint="j" coef="3"/></fixed>'
    hand = mjcf(tmp_path, '<velocity joint="wrist"/><motor name="m" tendon="t"/>', both, root="palm")
    assert hand.joint_names == ("j",)
    assert [(one.name, one.joints, one.arms) for one in hand.drives] == [("m", ("j",), (3.0,))]
    assert not any("velocity" in note for note in hand.notes)


def test_other_actuators_are_noted(tmp_path):
    spring = '<fixed name="t" stiffness="2"><joint joint="j" coef="3"/></fixed>'
    hand = mjcf(tmp_path, '<general name="site" site="s"/><motor joint="j"/><motor joint="j"/>', spring)
    notes = "\n".join(hand.notes)
    assert "drives: left out are actuators that pull neither a joint nor a fixed tendon: site" in notes
    assert "springs along tendons are left out: t" in notes
    assert [drive.name for drive in hand.drives] == ["motor j", "motor j 2"] and hand.passive_joints == ("wrist",)


# -- URDF --------------------------------------------------------------------------------------------------------------


def fingers(more="", mimic=""):
    """Two fingers of two joints each."""
    parts = [link("palm", 0.2, "box 0.08 0.02 0.08")]
    for side, x in (("l", 0.03), ("r", -0.03)):
        parts += [
            link(f"{side}1", 0.02, "box 0.01 0.01 0.04", "0 0 0.02"),
            link(f"{side}2", 0.02, "box 0.01 0.01 0.04", "0 0 0.02"),
            joint(f"{side}1", "palm", f"{side}1", f"{x} 0 0.04", "0 1 0", "-1 1 4 1"),
            joint(
                f"{side}2",
                f"{side}1",
                f"{side}2",
                "0 0 0.04",
                "0 1 0",
                "-1 1 3 1",
                mimic=mimic if side == "l" else "",
            ),
        ]
    return robot("fingers", *parts).replace("</robot>", f"{more}</robot>")


def urdf(tmp_path, text, **options):
    path = tmp_path / "fingers.urdf"
    path.write_text(text, encoding="utf-8")
    return load_hand(path, **options)


def transmission(name, joint, interface="hardware_interface/EffortJointInterface", reduction=1):
    return (
        f'<transmission name="t{name}"><type>transmission_interface/SimpleTransmission</type>'
        f'<joint name="{joint}"><hardwareInterface>{interface}</hardwareInterface></joint>'
        f'<actuator name="{name}"><mechanicalReduction>{reduction}</mechanicalReduction></actuator></transmission>'
    )


def told(hand):
    return [(one.name, one.joints, one.arms, one.control, one.limit) for one in hand.drives]


def test_transmissions_name_the_motors(tmp_path):
    more = (
        transmission("m1", "l1", reduction=100)
        + transmission("m2", "r2", "hardware_interface/PositionJointInterface")
        + transmission("m2", "l2", "hardware_interface/JointStateInterface")  # told, not commanded
        + transmission("m3", "elsewhere")
        + '<ros2_control name="c"><joint name="r1"><command_interface name="velocity"/></joint>'
        '<joint name="l2"><state_interface name="position"/></joint></ros2_control>'
    )
    hand = urdf(tmp_path, fingers(more))
    assert told(hand) == [
        ("m1", ("l1",), (1.0,), "torque", 4.0),
        ("m2", ("r2",), (1.0,), "position", 3.0),
        ("r1", ("r1",), (1.0,), "position", 4.0),
    ]
    assert hand.passive_joints == ("l2",)
    assert [note for note in hand.notes if note.startswith("drives")] == [
        "drives: commanded by velocity, taken as position servos: r1",
        "drives: no motor moves the joints l2",
    ]


@pytest.mark.parametrize("driven", [("l1",), ("l2",), ("l2", "l1")])
def test_joints_that_follow_share_one_motor(tmp_path, driven):
    """The motor of a follower acts on the joint that it follows by the factor; q, torques, limits are of that joint."""
    more = "".join(transmission(f"m {name}", name) for name in ("r1", "r2", *driven))
    hand = urdf(tmp_path, fingers(more, "l1 -2 0.1"))
    assert hand.passive_joints == () and hand.direct_drive
    (drive,) = (one for one in hand.drives if one.joints == ("l1",))
    name = driven[-1]
    arm = 1.0 if name == "l1" else -2.0
    assert (drive.name, drive.arms, drive.limit) == (f"m {name}", (arm,), 4.0 / abs(arm))


def test_a_file_without_motors_gets_one_at_each_joint(tmp_path):
    hand = urdf(tmp_path, fingers())
    assert told(hand) == [(name, (name,), (1.0,), "torque", 4.0 if "1" in name else 3.0) for name in hand.joint_names]
    assert hand.direct_drive and np.array_equal(hand.transmission, np.eye(4))
    assert hand.notes == ("drives: no motors are named; one torque motor at each joint is assumed",)


def test_gazebos_springs(tmp_path):
    more = (
        '<gazebo reference="l2"><springStiffness>0.3</springStiffness><springReference>-0.5</springReference></gazebo>'
        '<gazebo reference="r1"><springStiffness>0.2</springStiffness></gazebo><gazebo reference="r2"/><gazebo/>'
    )
    assert urdf(tmp_path, fingers(more)).springs == (
        Spring(joint="l2", stiffness=0.3, rest=-0.5),
        Spring(joint="r1", stiffness=0.2, rest=0.0),
    )
    # The follower is at -2 q + 0.1: with its spring at rest, q = 0.3, and four times as stiff.
    (spring, _) = urdf(tmp_path, fingers(more, "l1 -2 0.1")).springs
    assert spring.joint == "l1" and (spring.stiffness, spring.rest) == pytest.approx((1.2, 0.3))
    for value, message in (("stiff", "expected a number, got 'stiff'"), ("-1", "expected a number >= 0, got -1")):
        with pytest.raises(HandNotLoaded, match=message):
            urdf(tmp_path, fingers(f'<gazebo reference="l1"><springStiffness>{value}</springStiffness></gazebo>'))


def test_joints_that_springs_alone_hold_are_told_with_what_lets_more_bear(tmp_path):
    sprung = '<gazebo reference="l2"><springStiffness>0.3</springStiffness></gazebo>'
    motors = [transmission(f"m{joint}", joint) for joint in ("l1", "r1", "r2")]
    (note,) = [note for note in urdf(tmp_path, fingers(sprung + "".join(motors))).notes if "springs alone" in note]
    assert "hold l2:" in note and "exact=False" in note
    driven = urdf(tmp_path, fingers(sprung + "".join(motors) + transmission("m", "l2")))
    assert not any("springs alone" in note for note in driven.notes)


# -- the catalogue -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", CATALOGUE)
def test_drives_of_the_catalogue(name):
    """Each moves joints of the hand, within their effort limits; only the Hey5 hand has idle joints."""
    hand = loaded(name)
    assert hand.drives and hand.transmission.shape == (len(hand.drives), hand.n)
    assert np.linalg.matrix_rank(hand.transmission) == len(hand.drives)
    limits = np.array([drive.limit for drive in hand.drives])
    most = np.abs(hand.transmission.T) @ np.where(np.isfinite(limits), limits, 0.0)
    assert np.all(most <= hand.effort_or_infinity * (1 + 1e-9))
    assert not any("more than its effort limit" in note for note in hand.notes)
    assert bool(hand.passive_joints) == (name == "hey5")
    assert hand.direct_drive == (len(hand.drives) == hand.n)
    assert f"drives: {len(hand.drives)}" in hand.describe()


def test_how_many_motors_the_hands_have():
    counts = {name.removesuffix("_right"): len(loaded(name).drives) for name in CATALOGUE if "_left" not in name}
    assert counts == {
        "humanoid": 20,
        "allegro": 16,
        "g1": 7,
        "psyonic": 6,
        "hey5": 3,
        "sake": 1,
        "romeo": 1,
        "talos": 1,
        "tiago_pro": 1,
        "pr2": 1,
        "baxter": 1,
        "panda": 1,
        "so101": 1,
    }


def test_tendons_of_the_hey5_hand_close_it_as_its_file_says():
    """Springs of equal stiffness under each tendon: positions of least energy for a turn of the motor by 1 rad are the
    reductions of the file's transmissions.
    """
    hand = loaded("hey5")
    ratios: dict[str, dict[str, float]] = {}
    for one in ElementTree.parse(file_of("hey5")).getroot().iter("transmission"):
        name, motor = one.find("joint").get("name"), one.find("actuator").get("name")
        held = one.findtext("joint/saturationLower") == "0.0" == one.findtext("joint/saturationUpper")
        if one.findtext("type").endswith("Hey5Reducer") and not held:
            ratios.setdefault(motor, {})[name] = float(one.findtext("actuator/mechanicalReduction"))
    assert {drive.name: set(drive.joints) for drive in hand.drives} == {
        motor: set(joints) for motor, joints in ratios.items()
    }
    S = hand.transmission
    closed = np.linalg.pinv(S)  # least sum of squares of q with S q = a
    for column, drive in zip(closed.T, hand.drives):
        expected = [ratios[drive.name].get(name, 0.0) for name in hand.joint_names]
        assert np.abs(column - expected).max() < 1e-12
    idle = {"hand_thumb_joint", "hand_index_joint", "hand_mrl_joint", "hand_middle_abd_joint"}
    assert set(hand.passive_joints) == idle
    on_fingers = {name for finger in hand.fingers for name in finger.joints}
    assert idle - on_fingers == {"hand_thumb_joint", "hand_index_joint", "hand_mrl_joint"}


def test_a_part_of_a_hand_has_its_part_of_the_drives():
    hand, whole = (
        load_hand("hey5", root="hand_ring_abd_link", fingers={"ring": "hand_ring_flex_3_link"}),
        loaded("hey5"),
    )
    (drive,) = hand.drives
    of = [whole.joint_names.index(name) for name in hand.joint_names]
    assert drive.name == "hand_mrl_motor" and np.array_equal(hand.transmission, whole.transmission[[2]][:, of])
    assert [one.name for one in load_hand("humanoid", root="palm").drives] == [
        one.name for one in loaded("humanoid").drives
    ]


@pytest.mark.parametrize("name", ["panda", "baxter_left", "baxter_right"])
def test_the_coordinate_of_parallel_jaws_is_their_width(name):
    """So that by virtual work the effort is the force of each jaw."""
    hand = loaded(name)
    tips = [finger.tip for finger in hand.fingers]

    def width(q):
        one, other = hand.frame_placements(q, tips)[:, :3, 3]
        return np.linalg.norm(one - other)

    q = 0.5 * (hand.lower + hand.upper)
    h = 1e-3 * (hand.upper - hand.lower)
    slope = (width(q + h) - width(q - h)) / (2 * h[0])
    assert slope == pytest.approx(hand.transmission[0, 0], rel=1e-9)


def test_psyonics_motors_carry_their_followers():
    hand = loaded("psyonic_left")
    assert {drive.control for drive in hand.drives} == {"position"} and hand.couplings
    assert not set(hand.couplings) & {name for drive in hand.drives for name in drive.joints}


# -- given by the caller -----------------------------------------------------------------------------------------------

TENDON = Drive(name="tendon", joints=("l1", "l2"), arms=(0.012, 0.008), control="torque", limit=50.0)
OTHER = Drive(name="other", joints=("r1",), arms=(1.0,), control="position", stiffness=3.0, damping=0.1)
SPRING = Spring(joint="l2", stiffness=0.05, rest=-0.2)


def test_drives_given_by_the_caller_replace_the_files(tmp_path):
    plain = urdf(tmp_path, fingers(transmission("m1", "l1")))
    hand = urdf(tmp_path, fingers(transmission("m1", "l1")), drives=[TENDON, OTHER], springs=[SPRING])
    assert hand.drives == (TENDON, OTHER) and hand.springs == (SPRING,) and hand.passive_joints == ("r2",)
    efforts = np.array([10.0, 2.0])
    columns = [hand.joint_names.index(name) for name in ("l1", "l2", "r1", "r2")]
    assert (hand.transmission.T @ efforts)[columns].tolist() == pytest.approx([0.12, 0.08, 2.0, 0.0])
    assert hand.notes == ("drives: no motor moves the joints r2", "springs: torques are without those at l2")
    again = plain.with_drives([TENDON, OTHER], [SPRING])
    assert (again.drives, again.springs, again.notes) == (hand.drives, hand.springs, hand.notes)
    assert again.with_drives([OTHER]).springs == (SPRING,) and again.with_drives([OTHER], []).springs == ()
    for one in (hand, again):  # what plans use is that of the joints
        assert one.joint_names == plain.joint_names and one.couplings == plain.couplings
        assert np.array_equal(one.effort_or_infinity, plain.effort_or_infinity)
        assert np.array_equal(one.lower, plain.lower) and np.array_equal(one.upper, plain.upper)


def test_drives_stronger_than_their_joints_are_noted(tmp_path):
    strong = Drive(name="strong", joints=("l1", "r2"), arms=(2.0, -1.0), limit=2.5)
    notes = urdf(tmp_path, fingers(), drives=[strong]).notes
    assert "drives: motors can produce 5 N m at l1, more than its effort limit of 4 N m, which plans respect" in notes
    assert not any("at r2" in note for note in notes)


def test_drives_stay_with_the_hand_where_it_goes(tmp_path):
    hand = urdf(tmp_path, fingers(), drives=[TENDON], springs=[SPRING], pose=np.diag([-1.0, -1.0, 1.0, 1.0]))
    for one in (hand, hand.placed(np.eye(4)), hand.with_limits({"r1": (-0.5, 0.5)}), pickle.loads(pickle.dumps(hand))):
        assert one.drives == (TENDON,) and one.springs == (SPRING,)
        assert np.array_equal(one.transmission, hand.transmission)


def test_what_is_no_drive():
    cases = {
        "name": ({"name": ""}, "name of a drive: expected a text, got an empty one"),
        "no name": ({"name": 3}, "name of a drive: expected a text, got 3"),
        "no joint": ({"joints": (), "arms": ()}, "expected one or more joints"),
        "a text": ({"joints": "j", "arms": (1.0,)}, "joints of drive 'd': expected a sequence of str"),
        "twice": ({"joints": ("j", "j"), "arms": (1.0, 1.0)}, "each once"),
        "lengths": ({"arms": (1.0, 2.0)}, "expected one per joint, 1, got 2"),
        "no number": ({"arms": ("1",)}, "arms of drive 'd': expected numbers"),
        "zero": ({"arms": (0.0,)}, "leave out joints that it does not move"),
        "infinite": ({"arms": (math.inf,)}, "expected finite numbers"),
        "control": ({"control": "torqe"}, "did you mean 'torque'"),
        "limit": ({"limit": 0.0}, "limit of drive 'd': expected a finite number > 0, got 0"),
        "no limit": ({"limit": math.nan}, "limit of drive 'd'"),
        "stiffness": ({"stiffness": -1.0, "control": "position"}, "stiffness of drive 'd': expected"),
        "of torque": ({"stiffness": 1.0}, "set control='position'"),
        "damping": ({"damping": -1.0}, "damping of drive 'd': expected"),
    }
    for changed, message in cases.values():
        with pytest.raises(InvalidInput) as caught:
            Drive(**{"name": "d", "joints": ("j",), "arms": (1.0,), **changed})
        assert message in str(caught.value)
    for changed in ({"stiffness": 0.0}, {"rest": math.nan}, {"joint": 1}):
        with pytest.raises(InvalidInput):
            Spring(**{"joint": "j", "stiffness": 1.0, **changed})


def test_what_does_not_fit_the_hand(tmp_path):
    hand = urdf(tmp_path, fingers("", "l1 -2 0.1"))
    cases = [
        (
            [Drive(name="d", joints=("r3",), arms=(1.0,))],
            None,
            "joint of drive 'd': expected one of l1, r1, r2, got 'r3'",
        ),
        ([TENDON], None, "'l2', which follows l1: -2 times its position + 0.1: give 'l1', with -2 times the arm"),
        ([OTHER, OTHER], None, "expected each once, got more than once 'other'"),
        (OTHER, None, "expected a sequence of Drive"),
        ([SPRING], None, "expected a sequence of Drive"),
        ([OTHER], [SPRING], "which follows l1"),
        ([OTHER], [Spring(joint="x", stiffness=1.0)], "joint of a spring: expected one of"),
        ([OTHER], [Spring(joint="r1", stiffness=1.0)] * 2, "expected each once"),
        ([OTHER], [OTHER], "expected a sequence of Spring"),
    ]
    for drives, springs, message in cases:
        with pytest.raises(InvalidInput) as caught:
            hand.with_drives(drives, springs)
        assert message in str(caught.value)
    assert hand.with_drives([]).passive_joints == hand.joint_names


# -- saved and told ----------------------------------------------------------------------------------------------------


def test_records_keep_drives_and_springs(tmp_path):
    hand = urdf(tmp_path, fingers(), drives=[TENDON, OTHER], springs=[SPRING])
    text = json.dumps(hand_record(hand), allow_nan=False)
    assert OTHER.limit == math.inf
    again = hand_of(json.loads(text))
    assert isinstance(again, HandModel) and (again.drives, again.springs) == (hand.drives, hand.springs)
    assert again.notes == hand.notes


def test_older_records_have_a_motor_at_each_joint(tmp_path):
    old = hand_record(urdf(tmp_path, fingers(), drives=[TENDON], springs=[SPRING]))
    del old["drives"], old["springs"]
    hand = hand_of(old)
    assert hand.direct_drive and hand.springs == ()
    assert [drive.limit for drive in hand.drives] == hand.effort.tolist()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"drives": {}}, "hand record: drives: expected a list"),
        ({"drives": [3]}, "hand record: drives[0]: drive: expected a mapping"),
        (
            {"drives": [{"name": "d", "joints": ["l1"], "arms": [1], "control": "x"}]},
            "control of drive 'd': expected one",
        ),
        ({"drives": [{"name": "d", "joints": ["x"], "arms": [1], "control": "jaw"}]}, "joint of drive 'd'"),
        ({"drives": [{"name": "d", "joints": ["l1"], "arms": ["a"], "control": "jaw"}]}, "arms of drive 'd'"),
        ({"drives": [{"name": "d", "joints": ["l1"], "arms": [1], "control": "jaw", "limit": "x"}]}, "limit of drive"),
        ({"springs": [{"joint": "l1"}]}, "stiffness of spring at joint 'l1'"),
        ({"springs": [None]}, "springs[0]: joint: expected a text"),
    ],
)
def test_broken_records(tmp_path, change, message):
    whole = hand_record(urdf(tmp_path, fingers()))
    with pytest.raises(InvalidInput) as caught:
        hand_of({**whole, **change})
    assert message in str(caught.value)


def test_descriptions_list_the_drives(tmp_path):
    hand = urdf(tmp_path, fingers(), drives=[TENDON, OTHER], springs=[SPRING])
    text = hand.describe()
    assert "  drives: 2\n    tendon: torque, moves l1 (arm 0.012), l2 (arm 0.008), limit 50\n" in text
    assert "    other: position, moves r1, limit not given, stiffness 3" in text
    assert "  spring at l2: 0.05 N m/rad, at rest at -0.2 rad\n" in text
    assert "  drives: 4, one at each joint (torque)" in urdf(tmp_path, fingers()).describe()
    many = str(loaded("hey5").drives[2])
    assert many.startswith("hand_mrl_motor: position, moves hand_middle_virtual_1_joint (arm ") and "more" in many
    data = json.loads(json.dumps(record(hand), allow_nan=False))
    assert data["passive_joints"] == ["r2"] and data["springs"] == [{"joint": "l2", "stiffness": 0.05, "rest": -0.2}]
    assert data["drives"][0] == {
        "name": "tendon",
        "control": "torque",
        "joints": ["l1", "l2"],
        "arms": [0.012, 0.008],
        "limit": 50.0,
        "stiffness": None,
        "damping": None,
        "exact": True,
        "efforts": None,
        "step": None,
        "floor": 0.0,
        "continuous": None,
        "effort_step": None,
        "backlash": None,
        "friction": None,
        "latency": None,
        "closing": None,
        "contact_stiffness": None,
        "sources": [],
    }
    assert data["drives"][1]["limit"] is None


# -- joints at the end of their range ----------------------------------------------------------------------------------


def tendon_finger(tmp_path, joints=2):
    """A finger whose joints, of 0 to 1 rad, one tendon pulls, and a finger of one joint with its own motor."""
    ball, parent = "sphere 0.01", "palm"
    parts = [link("palm", 0.1, ball), link("other", 0.05, ball, at="0 0 0.02")]
    parts.append(joint("own", "palm", "other", "0.05 0 0", "0 1 0", "0 1 5 5"))
    for i in range(joints):
        parts.append(link(f"part{i}", 0.05, ball, at="0 0 0.02"))
        parts.append(joint(f"bend{i}", parent, f"part{i}", "0 0 0.04", "0 1 0", "0 1 5 5"))
        parent = f"part{i}"
    path = tmp_path / "tendon.urdf"
    path.write_text(robot("tendon", *parts), encoding="utf-8")
    bends = tuple(f"bend{i}" for i in range(joints))
    drives = [Drive(name="tendon", joints=bends, arms=(0.02,) * joints), Drive(name="m", joints=("own",), arms=(1.0,))]
    return load_hand(path, drives=drives), [*bends, "own"]


def in_order(hand, names, values):
    return np.array([dict(zip(names, values))[name] for name in hand.joint_names], dtype=float)


def test_ends_of_ranges_bear_what_presses_joints_against_them(tmp_path):
    hand, names = tendon_finger(tmp_path)
    free = in_order(hand, names, [0.5, 0.5, 0.0])
    low, high = in_order(hand, names, [0.0, 0.5, 0.0]), in_order(hand, names, [0.5, 1.0, 0.0])
    assert not find_stops(hand, free).any()  # the joint with a motor of its own never rests
    assert find_stops(hand, low).tolist() == in_order(hand, names, [1, 0, 0]).tolist()
    assert find_stops(hand, high).tolist() == in_order(hand, names, [0, -1, 0]).tolist()
    # What is asked of the two joints and the motor, and the tendon's pull and what is left of it, at these postures.
    for q, asked, pull, left in (
        (free, (3.0, 1.0), 2.0 / 0.02, 1.0),
        (low, (3.0, 1.0), 1.0 / 0.02, 0.0),  # the end takes 2 N m
        (low, (1.0, 3.0), 2.0 / 0.02, 1.0),  # it cannot pull
        (high, (3.0, 1.0), 3.0 / 0.02, 0.0),
        (high, (1.0, 3.0), 2.0 / 0.02, 1.0),
    ):
        found = solve_efforts(hand, q[None], in_order(hand, names, [*asked, 0.7])[None])
        assert found.drives[0] == pytest.approx([pull, 0.7]) and found.undone.max() == pytest.approx(left, abs=1e-9)


def test_a_tendon_over_three_joints_rests_on_two(tmp_path):
    hand, names = tendon_finger(tmp_path, 3)
    q = in_order(hand, names, [0.0, 0.0, 0.5, 0.2])
    found = solve_efforts(hand, q[None], in_order(hand, names, [5.0, 2.0, 1.0, 0.1])[None])
    assert found.drives[0] == pytest.approx([50.0, 0.1]) and found.undone.max() < 1e-9
    short = solve_efforts(hand, q[None], in_order(hand, names, [5.0, 0.5, 1.0, 0.1])[None])
    assert short.drives[0] == pytest.approx([37.5, 0.1]) and short.undone.max() == pytest.approx(0.25)
