"""Controls of somebody's own MuJoCo model: MuJoCo itself is the judge. With them its joints move as planned, whatever its
actuators and passive forces are; or what they cannot do is told.
"""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
from marks import slow_except

import pinograsp as pg

MOTORS = '<motor name="ml" joint="jl"/><motor name="mr" joint="jr"/>'
OFF = int(mujoco.mjtDisableBit.mjDSBL_CONTACT) | int(mujoco.mjtDisableBit.mjDSBL_LIMIT)


def gripper(actuators=MOTORS, *, joint="", body="", option="", more="", mass=0.05, base="90 0 0"):
    """Two fingers that swing towards each other, as MJCF."""
    fingers = "".join(
        f'<body name="{name}" pos="0.02 {side * 0.03} 0" {body}><joint name="j{name}" axis="0 0 {side}" range="-30 60" '
        f'{joint}/><geom type="box" size="0.025 0.004 0.01" pos="0.03 0 0" mass="{mass}"/>'
        f'<site name="tip {name}" pos="0.05 0 0"/></body>'
        for name, side in (("l", 1), ("r", -1))
    )
    return (
        f'<mujoco><option timestep="0.0005" {option}/><worldbody><site name="above" pos="0.02 0 0.12"/>'
        f'<site name="below" pos="0.02 0 -0.12"/><body name="base" euler="{base}">'
        f'<geom type="box" size="0.015 0.05 0.02" mass="0.4"/>{fingers}</body></worldbody>{more}'
        f"<actuator>{actuators}</actuator></mujoco>"
    )


def both(kind, rest):
    return f'<{kind} name="ml" joint="jl" {rest}/><{kind} name="mr" joint="jr" {rest}/>'


def pairs(kind, gear, lengths, rest):
    """Two actuators that only pull, at each joint."""
    return "".join(
        f'<{kind} name="{sign}{side}" joint="j{side}" gear="{sign}{gear}" {rest} {lengths[sign]}/>'
        for side in "lr"
        for sign in "+-"
    )


LENGTHS = {"+": 'lengthrange="-0.12 0.16"', "-": 'lengthrange="-0.16 0.12"'}
NONE = {"+": "", "-": ""}
TENDONS = (
    '<tendon><spatial name="tl"><site site="above"/><site site="tip l"/></spatial>'
    '<spatial name="tr"><site site="below"/><site site="tip r"/></spatial></tendon>'
)
MODELS = {
    "weight that is compensated": gripper(body='gravcomp="0.7"'),
    "weight that the actuators compensate": gripper(body='gravcomp="1"', joint='actuatorgravcomp="true"'),
    "springs": gripper(joint='stiffness="0.1" springref="15"'),
    "damping and dry friction": gripper(joint='damping="0.02" frictionloss="0.01"'),
    "water": gripper(option='density="1000" viscosity="0.5"'),
    "other masses": gripper(mass=0.12),
    "upside down": gripper(base="-90 0 0"),
    "integrators": gripper(both("intvelocity", 'kp="6" actrange="-3 3"')),
    "filters": gripper(both("position", 'kp="5" kv="0.05" timeconst="0.05"')),
    "cylinders": gripper(both("cylinder", 'timeconst="0.04" area="0.002" gear="30"')),
    "affine gains": gripper(
        both("general", 'gaintype="affine" gainprm="3 0.4 0.1" biastype="affine" biasprm="0.2 -3 -0.1"')
    ),
    "integral gains": gripper(both("pid", 'kp="5" ki="8"')),
    "thrust at sites": gripper(
        '<motor name="ml" site="tip l" gear="0 20 0 0 0 0"/><motor name="mr" site="tip r" gear="0 20 0 0 0 0"/>'
    ),
    "spatial tendons": gripper('<motor name="ml" tendon="tl"/><motor name="mr" tendon="tr"/>', more=TENDONS),
    "pulling pairs": gripper(pairs("motor", "0.5", NONE, 'ctrllimited="true" ctrlrange="0 4"')),
    "muscles": gripper(pairs("muscle", "0.1", LENGTHS, 'force="3"')),
}


@pytest.fixture(scope="module")
def plan(tmp_path_factory):
    path = tmp_path_factory.mktemp("gripper") / "gripper.xml"
    path.write_text(gripper())
    at = np.eye(4)
    at[0, 3] = 0.055
    box = pg.Box(size=(0.03, 0.03, 0.03), mass=0.05).placed(at)
    return pg.plan_grasp_on(pg.load_hand(path), box, pg.GraspConditions(mu=0.8, reserve=None), progress=False)


def sent_to(plan, model, path, **settings):
    sent = plan.to_mujoco(path / "keys.xml", model=model, **settings)
    return sent, [note for note in sent.notes if "status" not in note], np.load(path / "keys.npz")


@pytest.mark.parametrize("name", slow_except(MODELS, "muscles", "integrators", "spatial tendons"))
def test_the_model_accelerates_as_planned(plan, tmp_path, name):
    """At rest, while closing, and as it holds, where the contacts' efforts act as external ones. MuJoCo's soft friction
    and the least squares of pulling pairs leave 1e-6 of what an effort of 0.06 N m accelerates, 300 rad/s^2.
    """
    model = mujoco.MjModel.from_xml_string(MODELS[name])
    sent, notes, file = sent_to(plan, model, tmp_path)
    assert not [note for note in notes if "activations" not in note]
    model.opt.disableflags |= OFF
    data = mujoco.MjData(model)
    at = [model.joint(joint).dofadr[0] for joint in plan.hand.joint_names]
    for i in (0, sent.times.size // 3, sent.times.size // 2, sent.times.size - 1):
        data.qpos[:], data.qvel[:], data.ctrl[:] = file["qpos"][i], file["qvel"][i], file["ctrl"][i]
        data.act[:] = file["act"][i]
        data.qfrc_applied[at] = -sent.contact_effort[i]
        mujoco.mj_forward(model, data)
        assert data.qacc[at] == pytest.approx(sent.ddq[i], abs=1e-3)


@pytest.mark.parametrize(
    "name", slow_except(["integrators", "filters", "integral gains", "muscles", "damping and dry friction"], "filters")
)
def test_the_model_closes_as_planned(plan, tmp_path, name):
    """Played from the keyframe: within a hundredth of the way, where a setpoint that lags is off by a tenth and more."""
    text = MODELS[name]
    sent, _, file = sent_to(plan, mujoco.MjModel.from_xml_string(text), tmp_path, rate=2000.0)
    (tmp_path / "hand.xml").write_text(text.replace("</mujoco>", '<include file="keys.xml"/></mujoco>'))
    model = mujoco.MjModel.from_xml_path(str(tmp_path / "hand.xml"))
    model.opt.disableflags |= OFF
    data = mujoco.MjData(model)
    mujoco.mj_resetDataKeyframe(model, data, model.key("start").id)
    until = int(2000 * sent.impact_time) - 12  # before the contact forces
    for ctrl in file["ctrl"][:until]:
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data)
    way = np.ptp(file["qpos"][:until], axis=0).max()
    assert np.abs(data.qpos - file["qpos"][until]).max() < (0.03 if "friction" in name else 0.01) * way


@pytest.mark.parametrize(
    "text, words",
    [
        (gripper(both("motor", 'forcelimited="true" forcerange="-0.01 0.01"')), "at their limits: ml, mr"),
        (gripper(joint='actuatorfrcrange="-0.01 0.01" actuatorfrclimited="true"'), "too much or too little at j"),
        (gripper('<motor name="ml" joint="jl"/>'), "no actuator of the model moves jr"),
        (gripper(both("damper", 'kv="0.5" ctrlrange="0 1"')), "too much or too little"),
        (gripper(both("muscle", 'lengthrange="-1.2 1.6"')), "too much or too little"),
        (gripper(both("position", 'kp="5" delay="0.02" nsample="60"')), "with a delay: ml, mr"),
        (
            gripper(more='<equality><joint joint1="jl" joint2="jr" polycoef="0 0.5 0 0 0"/></equality>'),
            "equality constraints are violated",
        ),
    ],
)
def test_what_a_model_cannot_do_is_told(plan, tmp_path, text, words):
    assert any(words in note for note in sent_to(plan, mujoco.MjModel.from_xml_string(text), tmp_path)[1])


@pytest.mark.slow
def test_a_model_stays_as_it_is_and_callbacks_do_not_matter(plan, tmp_path):
    """Another control by a callback would be what MuJoCo's forward dynamics play."""
    model = mujoco.MjModel.from_xml_string(MODELS["muscles"])
    flags, early = model.opt.disableflags, model.actuator_actearly.copy()
    plain = sent_to(plan, model, tmp_path)[2]["ctrl"]
    mujoco.set_mjcb_control(lambda model, data: data.ctrl.fill(1.0))
    try:
        again = sent_to(plan, model, tmp_path)[2]["ctrl"]
    finally:
        mujoco.set_mjcb_control(None)
    assert np.array_equal(plain, again)
    assert model.opt.disableflags == flags and np.array_equal(model.actuator_actearly, early)


def test_a_coupling_that_the_model_lacks_is_told(tmp_path):
    def jaws(tie):
        sides = "".join(
            f'<body pos="0 0 0.03"><joint name="j{name}" type="slide" axis="0 {side} 0" range="0 0.04" damping="3" '
            f'armature="0.05"/><geom type="box" size="0.008 0.004 0.02" pos="0 {side * 0.004} 0.03" mass="0.04"/></body>'
            for name, side in (("l", 1), ("r", -1))
        )
        return (
            f'<mujoco><worldbody><body name="base"><geom type="box" size="0.03 0.05 0.02"/>{sides}</body></worldbody>'
            f'<equality>{tie}</equality><actuator><motor name="grip" joint="jl"/></actuator></mujoco>'
        )

    (tmp_path / "jaws.xml").write_text(jaws('<joint joint1="jr" joint2="jl"/>'))
    at = np.eye(4)
    at[2, 3] = 0.06
    box, conditions = pg.Box(size=(0.02, 0.03, 0.03), mass=0.1).placed(at), pg.GraspConditions(mu=0.6, reserve=None)
    plan = pg.plan_grasp_on(pg.load_hand(tmp_path / "jaws.xml"), box, conditions, progress=False)
    for tie, told in (('<joint joint1="jr" joint2="jl"/>', False), ("", True)):
        notes = sent_to(plan, mujoco.MjModel.from_xml_string(jaws(tie)), tmp_path)[1]
        assert any("couples jr" in note for note in notes) == told
