"""A carry plan as the viewer's scene: the arm moves, and the hand holds."""

from __future__ import annotations

import numpy as np

from pinograsp.carry.loads import LoadedRobot
from pinograsp.carry.record import CarryRecord
from pinograsp.handover.quintic import interpolate
from pinograsp.plan.answer import Answer, friction_model
from pinograsp.spatial import Array
from pinograsp.viz.scene import THICKNESS, Phase, ViewScene, list_busy_joints, name_object, split_forces
from pinograsp.viz.scene_meshes import friction_cone
from pinograsp.viz.solids import Links, make_solids, to_sevens
from pinograsp.viz.stage import Held, Stage, choose_scale
from pinograsp.viz.style import contact_colours
from pinograsp.words import format_number

_RATE, _FEWEST, _MOST = 60.0, 150, 600  # instants per second of the plan, and how many there are
_DETAIL = 0.25  # size of forces and cones, over that in a scene of the hand alone: the arm is larger


def carry_scene(plan: CarryRecord) -> ViewScene:
    """The scene of a carry plan, at instants that are equally far apart.

    Raises:
        InvalidInput: a grasp without its object.
    """
    robot, grasp = plan.robot, plan.grasp
    contacts, held = grasp.contacts, LoadedRobot.carry(robot, grasp)
    body = held.body
    duration = plan.timing.duration
    times = np.linspace(0.0, duration, 1 + int(np.clip(round(_RATE * duration), _FEWEST, _MOST)))
    q = np.tile(held.posture, (len(times), 1))
    q[:, held.find_joints(plan.path)] = plan.path.at(plan.timing.at(times).s).q
    axes = held.axes(q)
    planned = to_sevens(body.pose)
    colours = contact_colours(contacts.names, grasp.layout.fingers)
    links = Links(robot)
    solids, unseen = make_solids(robot, body, links, dict(zip(contacts.links, colours)))
    link_poses, middle = links.poses(q), len(times) // 2
    turn, shift = axes[middle, :3, :3], axes[middle, :3, 3]
    stage = Stage(
        Held(
            plan.gravity_o,
            contacts.points_o @ turn.T + shift,
            contacts.rotations_oc[:, :, 2] @ turn.T,
            turn @ contacts.com_o + shift,
        ),
        solids,
        link_poses,
        to_sevens(axes @ body.pose),
        middle,
    )
    centre, extent = stage.frame()
    forces, loads = _interpolate(plan, times, plan.forces_o), _interpolate(plan, times, plan.loads)[:, :3]
    torques, size = _interpolate(plan, times, plan.torques), _DETAIL * stage.size
    normal, tangential, used = split_forces(contacts.rotations_oc, grasp.friction.mu, forces)
    interval = np.clip(np.searchsorted(plan.times, times, side="right") - 1, 0, len(plan.binding) - 1)
    binding = [plan.binding[i] for i in interval.tolist()]
    fingers = {"arm": tuple(held.arm.tolist())} | {one.name: tuple(one.dofs.tolist()) for one in robot.fingers}
    largest = np.linalg.norm(np.concatenate([forces, loads[:, None]], axis=1), axis=2).max()
    return ViewScene(
        title=f"{robot.name} carries a {name_object(body)}",
        subtitle=f"{robot.n} joints, {len(plan.path.joints)} of them move; {len(contacts.names)} contacts",
        answer=Answer("caution" if plan.notes else "yes", _write_answer(plan)),
        status=f"within all limits, {100 * plan.reserve:g} % of them kept free",
        remedy="",
        heading="On the way",
        facts=tuple(_list_facts(plan)),
        cautions=plan.notes,
        unseen=tuple(unseen),
        times=times,
        rate=(len(times) - 1) / duration,
        touch=0.0,
        closed=0.0,
        phases=_find_phases(binding),
        told=tuple(_describe_binding(what) for what in binding),
        solids=solids,
        link_poses=link_poses,
        object_pose=planned,
        carried=to_sevens(axes),
        contacts=contacts.names,
        colours=colours,
        points_o=contacts.points_o,
        rotations_oc=contacts.rotations_oc,
        cones=tuple(friction_cone(float(mu), 0.16 * size, grasp.friction.edges) for mu in grasp.friction.mu),
        cone_height=0.16 * size,
        pyramids=grasp.friction.edges is not None,
        forces_o=forces,
        normal=normal,
        tangential=tangential,
        used=used,
        load_o=loads,
        com_o=contacts.com_o,
        joints=robot.joint_names,
        fingers=list_busy_joints(fingers, q, torques),
        sliding=robot.slides,
        q=q,
        torques=torques,
        limits=plan.torque_limits,
        force_scale=choose_scale(size, float(largest)),
        up=stage.up,
        ground=stage.ground,
        centre=centre,
        view=stage.view,
        extent=extent,
        thickness=_DETAIL * THICKNESS * float(extent[1:].max()),
        simulated=None,
    )


def _interpolate(plan: CarryRecord, times: Array, values: Array) -> Array:
    """Values (N, ...) of the middles at times (f, ...); before the first and after the last they stay."""
    found = interpolate(times, plan.instants, values.reshape(len(values), -1))
    return found.reshape(len(times), *values.shape[1:])


def _find_phases(binding: list[str]) -> tuple[Phase, ...]:
    """Stretches where the same binds."""
    starts = [i for i, what in enumerate(binding) if i == 0 or what != binding[i - 1]]
    return tuple(Phase(binding[first], first, last) for first, last in zip(starts, [*starts[1:], len(binding) - 1]))


def _describe_binding(what: str) -> str:
    if what == "nothing":
        return "On the path. No limit binds here."
    return f"On the path. The limit that binds here: {what}."


def _write_answer(plan: CarryRecord) -> str:
    text = f"Yes, in {plan.timing.duration:.4g} s: friction, forces, torques and speeds stay within their limits."
    if plan.lower_bound is not None:
        return f"{text} No timing of this path takes less than {plan.lower_bound:.4g} s."
    return f"{text} {plan.factor:.3g} times as fast would also hold."


def _list_facts(plan: CarryRecord) -> list[tuple[str, str]]:
    """The plan in a few lines."""
    squeeze = plan.squeeze
    facts = [("duration", f"{plan.timing.duration:.4g} s")]
    if plan.fastest is not None and plan.lower_bound is not None:
        facts.append(("fastest (accelerations jump)", f"{plan.fastest:.4g} s"))
        facts.append(("lower bound (proven)", f"{plan.lower_bound:.4g} s"))
    else:
        facts.append(("may be faster by", f"{plan.factor:.3g} times"))
    facts.append(
        ("squeeze (all normal forces)", f"{format_number(squeeze.min(), 3)} to {format_number(squeeze.max(), 3)} N")
    )
    facts.append(("friction", friction_model(plan.grasp.friction)))
    facts.append(
        ("most friction used", f"{100 * plan.friction_use.max():.0f} % of the friction that the plan relies on")
    )
    facts.append(("kept free", f"{100 * plan.reserve:g} % of each limit"))
    facts += [(f"binds {100 * share:.0f} % of the time", what) for what, share in plan.shares()[:4]]
    return facts
