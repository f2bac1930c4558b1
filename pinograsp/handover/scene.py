"""A plan as a MuJoCo scene that loads by itself: hand, drives, object, contacts, keyframes, and its controls."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

import mujoco
import numpy as np
from numpy.typing import ArrayLike
from scipy.linalg import eigh

from pinograsp import defaults
from pinograsp.checks import instance_of, number, one_of, path_of
from pinograsp.errors import InvalidInput
from pinograsp.handover.actuators import Controls, archive, keyframes
from pinograsp.handover.build import Sampling, joint_trajectory
from pinograsp.handover.commands import COMMANDS, Command, gains, in_drives
from pinograsp.handover.jaws import jaw_commands
from pinograsp.handover.trajectory import JointTrajectory
from pinograsp.hands import HandModel
from pinograsp.hands.efforts import SHORTFALL
from pinograsp.hands.mujoco_callbacks import without_callbacks
from pinograsp.hands.servos import SETTLING
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord
from pinograsp.plan.simulation import MOVED, TURNED
from pinograsp.simulation.scene import COUPLED_STEPS, compile_model, outline
from pinograsp.simulation.settings import Servo
from pinograsp.spatial import Array, IntArray, rotation_angle
from pinograsp.words import printable
from pinograsp.writing import write_file

if TYPE_CHECKING:
    from typing_extensions import Unpack


_LONGEST_STEP = 5e-4  # [s] of the simulation
# Steps are so short that servos take this share of what makes them unstable, damping and stiffness together; but no
# shorter than this [s], fifty to a sample of 1 kHz.
_STABLE, _SHORTEST_STEP = 0.5, 2e-5
# MuJoCo's impedance d of the contacts, at which solref is set for the planned stiffness. Nearer to 1, light links were
# pressed off the planned forces and crept.
_IMPEDANCE = 0.5
_SUPPORT = 800.0  # [rad/s] natural frequency of the object on its support
_FADING = 0.1  # [s] in which the support lets go
_RATIO, _NO_SLIP = 10.0, 10  # friction is stiffer than the normal, and does not creep
_PRESS = 2.0  # times its force: how far ahead the servo of a jaw is, so that its limit is met
# Least inertia at a joint [kg m^2, kg]: links of hardly any mass chatter in contacts, and real joints have motors.
_ROTOR, _SLIDING_ROTOR = 1e-4, 1e-4 / 0.03**2
_LONGEST_HOLD = 60.0  # [s]
_NOTHING = 1e-9  # [N, N m]: rounding
_SOLVER = (
    "Keep the solver's settings of this file: its contacts hold by them (of 12 scenes 12, turned by 90 deg 24 of 24).",
    "With MuJoCo's default contacts and impratio 10, 10 of 12 held; with its defaults throughout 1: the others crept.",
)
_LOOKED_AT = 0.5  # [s] of the hold that are played before a scene is handed over
_WARNINGS = mujoco.mjtWarning
_UNSTABLE = (_WARNINGS.mjWARN_BADQPOS, _WARNINGS.mjWARN_BADQVEL, _WARNINGS.mjWARN_BADQACC)
_AXES = ("x", "y", "z", "rx", "ry", "rz")


@without_callbacks()
def write_scene(
    plan: PlanRecord,
    path: str | Path,
    command: Command = "impedance",
    *,
    hold: float = defaults.HOLD,
    stiffness: ArrayLike | None = None,
    damping: ArrayLike | None = None,
    shortfall: float | None = SHORTFALL,
    **sampling: Unpack[Sampling],
) -> JointTrajectory:
    """Write a complete scene (.xml), and the controls that play the plan in it (.npz beside it).

    The hand has an actuator per drive: a motor (``torque``), a servo (``position``, ``impedance``: the feed-forward is
    part of its control), or a servo with the plan's force as its limit (``jaw``). Six more actuators, ``support x`` to
    ``support rz``, hold the object while their control is 1, which fades to 0 within 0.1 s after t_F: from then on the
    hand alone holds it. Contacts are MuJoCo's own: per link, the stiffness that the contact law has at the planned
    force, and the planned friction. Keyframes: ``start``, ``touch`` and ``grasp`` (t_F, with the controls of the hold).

    Args:
        plan: a plan with its hand and its object.
        path: ``.xml``; existing files are replaced. The archive is that of :meth:`JointTrajectory.to_mujoco`; each row
            of ``ctrl`` is for round((times[1] - times[0]) / timestep) steps. The time step is 0.5 ms at most, and
            shorter if the servos' gains need it.
        command: ``torque``, ``position``, ``impedance`` or ``jaw``.
        stiffness, damping: of the servos, as for :func:`drive_commands`; default: those of the drives, else 50 N m/rad
            (55.6 kN/m for sliding joints), and 10 ms times that, or critical if joints are coupled.
        shortfall: as for :func:`drive_commands`.
        hold: how long the controls continue after the motion [s].
        sampling: rate, start, lead, blend, as for :func:`joint_trajectory`.

    Returns:
        The trajectory of the drives. Notes say what the scene leaves out, whether the time step is shorter, and
        whether the object does not stay in the hand: the function simulates the scene first, with 0.5 s of the hold.

    Raises:
        InvalidInput: as :func:`drive_commands`; another suffix, a plan without an object, or one that MuJoCo rejects;
            gains that would need steps of less than 0.02 ms.
        ResultsNotWritten: the files cannot be written.
    """
    path = path_of("path", path)
    one_of("suffix of a MuJoCo scene", path.suffix, (".xml",))
    one_of("command", command, COMMANDS)
    hold = number("hold", hold, at_least=0, at_most=_LONGEST_HOLD, unit="s")
    hand, body = _require_both(plan)
    if command == "jaw":
        jaw_commands(plan, shortfall=shortfall)  # a hand with jaws that press
    joints = joint_trajectory(plan, **sampling)
    drives = in_drives(hand, joints, "torque", shortfall=shortfall)
    if joints.times.size < 2:
        raise InvalidInput("rate: expected two samples at least, got one: take a higher rate")
    step = float(joints.times[1] - joints.times[0])
    spec, notes = _outline(plan, hand, body, step / math.ceil(step / _LONGEST_STEP - 1e-9))
    kp = _add_drives(spec, hand, command, stiffness, np.abs(drives.effort[-1]), damping)
    _add_support(spec, body, plan.gravity_o)
    servos = _finish(spec, hand, plan, kp)
    if command != "torque":
        notes += _set_step(spec, hand, joints, servos)
    model = compile_model(spec)

    extra = joints.times[-1] + np.arange(1, round(hold / step) + 1) * step
    times = np.concatenate([joints.times, extra])
    held = np.minimum(np.arange(times.size), joints.times.size - 1)
    final = float(joints.times[-1] if joints.final_time is None else joints.final_time)
    effort, pressed = drives.effort[held], _PRESS if command == "jaw" else 1.0
    ctrl = effort
    if command != "torque":
        ctrl = drives.q[held] + (pressed * effort + servos.damping * drives.dq[held]) / servos.stiffness
    supported = np.clip(1.0 - (times - final) / _FADING, 0.0, 1.0)
    ctrl = np.hstack([ctrl, np.tile(supported[:, None], len(_AXES))])
    found = _make_controls(model, joints.with_followers(), times, held, ctrl)
    shown = int(np.searchsorted(times, final + _FADING + _LOOKED_AT, side="right"))
    notes += _play(model, found, round(step / model.opt.timestep), shown)

    touch = 0 if joints.impact_time is None else int(np.searchsorted(times, joints.impact_time - 1e-9))
    grasp = min(int(np.searchsorted(times, final - 1e-9)), times.size - 1)
    _write(path, spec, times, found, {"start": 0, "touch": touch, "grasp": grasp}, notes)
    if command == "torque":
        notes.append("torques alone do not correct the posture: a hand that drifts may miss the object or lose it")
    return replace(drives, notes=(*drives.notes, *notes))


def _require_both(plan: PlanRecord) -> tuple[HandModel, Body]:
    """Hand and object of a plan; :class:`InvalidInput` where one is not there, or contacts have no link."""
    hand, body = instance_of("plan", plan, PlanRecord).require_hand(), plan.body
    if body is None:
        raise InvalidInput(
            "scene=True: expected a plan with an object, got one without: plan on a shape (pinograsp.Sphere, ...), or "
            "leave scene out"
        )
    if not all(plan.contacts.links):
        raise InvalidInput("scene=True: expected contacts of a hand, got some without a link: plan with a hand")
    return hand, body


def _write(
    path: Path, spec: mujoco.MjSpec, times: Array, found: Controls, keys: dict[str, int], notes: list[str]
) -> None:
    """Write a scene with keyframes at the samples ``keys``, and its controls; at ``grasp`` those of the hold, at rest
    and without the support.
    """
    frozen = replace(found, qvel=found.qvel.copy(), ctrl=found.ctrl.copy())
    grasp = keys["grasp"]
    frozen.qvel[grasp], frozen.ctrl[grasp] = 0.0, found.ctrl[-1]
    frozen.ctrl[grasp, -len(_AXES) :] = 0.0
    # The writer leaves out that inertias of real files may break the triangle inequality.
    comments = "\n  ".join(f"<!-- {printable(line).replace('--', '- -')} -->" for line in (*_SOLVER, *notes))
    text = spec.to_xml().replace("<compiler ", f'{comments}\n\n  <compiler balanceinertia="true" ', 1)
    inner = "\n".join(f"    {line}" for line in keyframes(times, frozen, keys))
    write_file(path.with_suffix(".npz"), archive(times, found))
    write_file(path, text.replace("</mujoco>", f"  <keyframe>\n{inner}\n  </keyframe>\n</mujoco>").encode())


class _Servos(NamedTuple):
    """Gains of the drives (m,), effort per unit of their coordinate and its rate."""

    stiffness: Array
    damping: Array


def _outline(plan: PlanRecord, hand: HandModel, body: Body, time_step: float) -> tuple[mujoco.MjSpec, list[str]]:
    """Hand, its springs and the object, and notes on what the scene leaves out."""
    links = plan.contacts.links
    slides = hand.slides
    spec, notes = outline(
        hand,
        body,
        time_step=time_step,
        gravity_o=plan.gravity_o,
        rotor=np.maximum(Servo.of(hand).rotor, np.where(slides, _SLIDING_ROTOR, _ROTOR)),
        flat=len(set(links)) < len(links),
        presses=True,
    )
    spec.modelname = hand.name
    spec.option.cone, spec.option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, _RATIO
    spec.option.noslip_iterations = _NO_SLIP
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    for spring in hand.springs:
        joint = spec.joint(spring.joint)
        joint.stiffness, joint.springref = [spring.stiffness, 0.0, 0.0], spring.rest
    load = np.array(plan.load)
    load[:3] -= plan.body_mass * plan.gravity_o
    if np.abs(load).max() > _NOTHING:
        notes.append("the scene has the object's weight alone, not the plan's other loads")
    return spec, notes


def _play(model: mujoco.MjModel, found: Controls, steps: int, samples: int) -> list[str]:
    """Play samples, ``steps`` of the model each; returns a note where the object does not stay in the hand."""
    data, body = mujoco.MjData(model), model.body("object").id
    data.qpos[:], data.qvel[:] = found.qpos[0], found.qvel[0]
    mujoco.mj_forward(model, data)
    place, turn = data.xpos[body].copy(), data.xmat[body].reshape(3, 3).copy()
    for ctrl in found.ctrl[:samples]:
        data.ctrl[:] = ctrl
        mujoco.mj_step(model, data, nstep=steps)
    moved = float(np.linalg.norm(data.xpos[body] - place))
    turned = math.degrees(rotation_angle(data.xmat[body].reshape(3, 3) @ turn.T))
    if any(data.warning[kind].number for kind in _UNSTABLE):
        return ["in MuJoCo this scene is unstable: take other gains, or a higher rate"]
    if moved <= MOVED and turned <= TURNED:
        return []
    return [f"in MuJoCo this scene does not hold: the object moves by {1e3 * moved:.3g} mm and {turned:.3g} deg"]


def _set_step(spec: mujoco.MjSpec, hand: HandModel, joints: JointTrajectory, servos: _Servos) -> list[str]:
    """Shorten the time step where the servos ask for it; returns a note then.

    A step h of semi-implicit Euler is stable while h d + h^2 k / 2 < 2, d and k being damping and stiffness per
    inertia; where damping is implicit, it adds to the inertia instead.
    """
    model, every = compile_model(spec), joints.with_followers()
    data, arms = mujoco.MjData(model), hand.transmission
    for name, value in zip(every.names, every.q[-1]):
        data.qpos[model.joint(name).qposadr[0]] = value
    full, leads = np.zeros((model.nv, model.nv)), np.zeros((model.nv, hand.n))
    mujoco.mj_fwdPosition(model, data)
    mujoco.mj_fullM(model, data, full)
    for k, name in enumerate(hand.joint_names):
        leads[model.joint(name).dofadr[0], k] = 1.0
    for name, c in hand.couplings.items():
        leads[model.joint(name).dofadr[0], hand.joint_names.index(c.followed)] = c.factor
    inertia = leads.T @ full @ leads
    stiffness, damping = (arms.T @ np.diag(gain) @ arms for gain in servos)

    def share(step: float) -> float:
        """Of what is unstable."""
        if hand.couplings:
            return float(eigh(step * damping + 0.5 * step**2 * stiffness, inertia, eigvals_only=True)[-1]) / 2
        return float(eigh(0.5 * step**2 * stiffness, inertia + step * damping, eigvals_only=True)[-1]) / 2

    longest = spec.option.timestep
    times = 1
    while share(longest / times) > _STABLE:
        times += 1
        if longest / times < _SHORTEST_STEP:
            raise InvalidInput(
                f"stiffness, damping: expected gains for which steps of {1e3 * _SHORTEST_STEP:g} ms are short enough, "
                f"got up to {servos.stiffness.max():.4g} and {servos.damping.max():.4g}, at "
                f"{100 * share(_SHORTEST_STEP):.3g} % of what is unstable then ({100 * _STABLE:g} % are allowed): take "
                "smaller ones, or command='torque'"
            )
    if times == 1:
        return []
    spec.option.timestep = longest / times
    for tie in spec.equalities:
        tie.solref = COUPLED_STEPS * spec.option.timestep, 1.0
    return [
        f"steps of {1e3 * spec.option.timestep:.3g} ms: with {1e3 * longest:.3g} ms servos of stiffness "
        f"{servos.stiffness.max():.4g} and damping {servos.damping.max():.4g} would be at {100 * share(longest):.3g} % "
        "of what is unstable"
    ]


def _finish(spec: mujoco.MjSpec, hand: HandModel, plan: PlanRecord, kp: Array) -> _Servos:
    """Set what follows from the compiled model: stiffness of the contacts, damping of the servos (m,)."""
    model = compile_model(spec)
    _set_contacts(spec, hand, plan, model)
    damping = -model.actuator_biasprm[: kp.size, 2]
    for actuator, kd in zip(list(spec.actuators), damping):
        actuator.biasprm[2] = -kd
    return _Servos(kp, damping)


def _add_drives(
    spec: mujoco.MjSpec,
    hand: HandModel,
    command: Command,
    stiffness: ArrayLike | None,
    pressing: Array,
    damping: ArrayLike | None,
) -> Array:
    """An actuator per drive, at its joint or by a fixed tendon; returns the stiffness of their servos (m,)."""
    servo, arms = Servo.of(hand), hand.transmission
    if stiffness is None:
        soft = np.array([1.0 / ((row**2 / servo.stiffness).sum()) for row in arms])
        kp = np.array([one if drive.stiffness is None else drive.stiffness for drive, one in zip(hand.drives, soft)])
    else:
        kp = gains(hand, "stiffness", stiffness)
    kd = None if damping is None else gains(hand, "damping", damping)
    for i, drive in enumerate(hand.drives):
        if len(drive.joints) == 1:
            motor = spec.add_actuator(name=drive.name, target=drive.joints[0], trntype=mujoco.mjtTrn.mjTRN_JOINT)
            motor.gear[0] = drive.arms[0]
        else:
            tendon = spec.add_tendon(name=drive.name)
            for joint, arm in zip(drive.joints, drive.arms):
                tendon.wrap_joint(joint, arm)
            motor = spec.add_actuator(name=drive.name, target=drive.name, trntype=mujoco.mjtTrn.mjTRN_TENDON)
        motor.gaintype = mujoco.mjtGain.mjGAIN_FIXED
        if command == "torque":
            motor.gainprm[0] = 1.0
        else:
            motor.biastype = mujoco.mjtBias.mjBIAS_AFFINE
            own = drive.damping if kd is None else float(kd[i])
            motor.gainprm[0], motor.biasprm[1] = kp[i], -kp[i]
            if own is not None:
                motor.biasprm[2] = -own
            else:  # above zero: a damping ratio
                motor.biasprm[2] = 1.0 if hand.couplings else -SETTLING * kp[i]
        limit = float(pressing[i]) if command == "jaw" else drive.limit
        if math.isfinite(limit) and limit > 0:
            motor.forcelimited, motor.forcerange = True, [-limit, limit]
    return kp


def _add_support(spec: mujoco.MjSpec, body: Body, gravity_o: Array) -> None:
    """Springs and dampers between the object and its place, which carry its weight; their control scales them."""
    here = spec.body("object")
    here.add_site(name="object", pos=body.com_b, group=4)
    spec.worldbody.add_site(name="place", pos=body.com_o, quat=here.quat, group=4)
    inertia = float(np.linalg.eigvalsh(body.inertia_b)[0])
    weight = np.concatenate([-body.mass * body.pose[:3, :3].T @ gravity_o, np.zeros(3)])
    for i, (axis, mass) in enumerate(zip(_AXES, np.repeat([body.mass, inertia], 3))):
        spring = spec.add_actuator(
            name=f"support {axis}", target="object", refsite="place", trntype=mujoco.mjtTrn.mjTRN_SITE
        )
        spring.gear[:] = np.eye(6)[i]
        spring.gaintype, spring.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_NONE
        spring.gainprm[:3] = weight[i], -mass * _SUPPORT**2, -2 * mass * _SUPPORT
        spring.ctrllimited, spring.ctrlrange = True, [0.0, 1.0]


def _set_contacts(spec: mujoco.MjSpec, hand: HandModel, plan: PlanRecord, model: mujoco.MjModel) -> None:
    """Friction and stiffness of the hand's geometry, which count for its contacts with the object.

    At rest a contact of impedance d and solref (-s, -b) has the stiffness s / ((1 - d) A), A being the sum of the
    bodies' ``body_invweight0``.
    """
    contacts, forces, friction = plan.contacts, plan.forces, plan.friction
    parts = np.array([int(hand.model.frames[hand.frame_id(link)].parentJoint) for link in contacts.links])
    depths = np.maximum(forces.final_depths, 1e-7)
    slopes = np.maximum(forces.normal_forces, 1e-3) / depths
    of_object = float(model.body_invweight0[model.body("object").id, 0])
    for geom in spec.geoms:
        name = geom.parent.name
        if name == "object":
            continue
        part = int(name.split()[1]) if name.startswith("link ") else 0
        own = np.flatnonzero(parts == part)
        rows = own if own.size else np.arange(parts.size)
        inverse = float(model.body_invweight0[model.body(name).id, 0]) + of_object
        s = float(slopes[rows].mean()) * (1 - _IMPEDANCE) * inverse
        geom.priority, geom.condim = 1, 4 if friction.torsion > 0 else 3
        geom.friction = [float(friction.mu[rows].mean()), friction.torsion, 0.0]
        geom.solimp = [_IMPEDANCE, _IMPEDANCE, 0.001, 0.5, 2.0]
        geom.solref = [-s, -2 * math.sqrt(s * (1 - _IMPEDANCE))]


def _make_controls(model: mujoco.MjModel, every: JointTrajectory, times: Array, at: IntArray, ctrl: Array) -> Controls:
    qpos, qvel = np.tile(model.qpos0, (times.size, 1)), np.zeros((times.size, model.nv))
    for column, name in enumerate(every.names):
        qpos[:, model.joint(name).qposadr[0]] = every.q[at, column]
        qvel[:, model.joint(name).dofadr[0]] = every.dq[at, column]
    return Controls(
        qpos=qpos,
        qvel=qvel,
        ctrl=ctrl,
        joints=tuple(model.joint(j).name for j in range(model.njnt)),
        actuators=tuple(model.actuator(u).name for u in range(model.nu)),
    )
