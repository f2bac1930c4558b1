"""A pick as the viewer's scene: all phases, with what stands around."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinograsp.carry.loads import LoadedRobot
from pinograsp.carry.scene import carry_scene
from pinograsp.handover.quintic import interpolate
from pinograsp.pick.record import PickRecord
from pinograsp.plan.answer import Answer
from pinograsp.simulation.geometry import convex_shapes
from pinograsp.spatial import Array
from pinograsp.viz.scene import Phase, ViewScene, list_busy_joints, split_forces
from pinograsp.viz.scene_meshes import triangulate
from pinograsp.viz.solids import Links, Solid, to_sevens
from pinograsp.viz.stage import Held, Stage

_RATE, _FEWEST, _MOST = 60.0, 150, 600  # instants per second of the plan, and how many there are
_OBSTACLE = "#b8b2a7"
_TOLD = {
    "reach": "The open hand comes to the object.",
    "close": "The hand closes.",
    "carry": "The arm lifts the object, carries it and puts it down.",
    "open": "The hand opens.",
    "leave": "The hand leaves.",
}


def pick_scene(plan: PickRecord) -> ViewScene:
    """The scene of a pick, at instants that are equally far apart."""
    carried, robot, base = plan.carry, plan.robot, carry_scene(plan.carry)
    count = 1 + int(np.clip(round(_RATE * plan.duration), _FEWEST, _MOST))
    way = plan.trajectory(rate=(count - 1) / plan.duration)
    times, q = way.times, way.q
    bounds = np.cumsum([0.0, *(phase.duration for phase in plan.phases)])
    names = [phase.name for phase in plan.phases]
    begin, end = (float(bounds[names.index("carry") + i]) for i in (0, 1))
    held = LoadedRobot.carry(robot, plan.grasp)
    ends = held.axes(plan.phases[names.index("carry")].q[[0, -1]])
    axes = np.where((times < begin)[:, None, None], ends[0], ends[1])
    during = (times >= begin) & (times <= end)
    axes[during] = held.axes(q[during])
    forces = _forces_at(plan, times, begin, end)
    normal, tangential, used = split_forces(base.rotations_oc, plan.grasp.friction.mu, forces)
    weight = carried.grasp.body_mass * plan.grasp.gravity_o
    loads = np.where(during[:, None], axes[:, :3, :3].transpose(0, 2, 1) @ weight, 0.0)
    links = Links(robot)
    link_poses = links.poses(q)
    solids, link_poses = _add_obstacles(plan, base, links, link_poses)
    middle = int(np.searchsorted(times, (begin + end) / 2.0))
    turn, shift = axes[middle, :3, :3], axes[middle, :3, 3]
    seen = Held(
        plan.grasp.gravity_o,
        base.points_o @ turn.T + shift,
        base.rotations_oc[:, :, 2] @ turn.T,
        turn @ base.com_o + shift,
    )
    body = plan.grasp.body
    assert body is not None
    stage = Stage(seen, solids, link_poses, to_sevens(axes @ body.pose), middle)
    centre, extent = stage.frame()
    index = np.clip(np.searchsorted(bounds, times, side="right") - 1, 0, len(names) - 1)
    first = [int(np.searchsorted(times, one - 1e-9)) for one in bounds[:-1]]
    last = [*(one for one in first[1:]), len(times) - 1]
    fingers = {"arm": tuple(held.arm.tolist())} | {one.name: tuple(one.dofs.tolist()) for one in robot.fingers}
    phases = tuple(Phase(name, one, other) for name, one, other in zip(names, first, last))
    return replace(
        base,
        title=f"{robot.name} picks",
        answer=Answer("caution" if carried.notes else "yes", f"Yes, in {plan.duration:.4g} s."),
        status=plan.status.value,
        heading="The pick",
        facts=(*((phase.name, f"{phase.duration:.3g} s") for phase in plan.phases), *base.facts[4:]),
        times=times,
        rate=(len(times) - 1) / plan.duration,
        touch=begin - plan.grasp.forces.final_time + plan.grasp.forces.impact_time,
        closed=begin,
        phases=phases,
        told=tuple(_TOLD[names[i]] for i in index),
        solids=solids,
        link_poses=link_poses,
        carried=to_sevens(axes),
        forces_o=forces,
        normal=normal,
        tangential=tangential,
        used=used,
        load_o=loads,
        fingers=list_busy_joints(fingers, q, way.effort),
        q=q,
        torques=way.effort,
        up=stage.up,
        ground=stage.ground,
        centre=centre,
        view=stage.view,
        extent=extent,
    )


def _forces_at(plan: PickRecord, times: Array, begin: float, end: float) -> Array:
    """On the object (f, k, 3) [N], in axes that turn with the palm."""
    carried, motion = plan.carry, plan.carry.closing
    forces = carried.forces_o.reshape(len(carried.instants), -1)
    found = interpolate(times - begin, carried.instants, forces)
    names = [phase.name for phase in plan.phases]
    started = begin - plan.phases[names.index("close")].duration
    closing = times < begin
    found[closing] = interpolate(times[closing] - started, motion.times, motion.forces_o.reshape(len(motion.times), -1))
    found[times < started] = 0.0
    found[times > end] = 0.0
    return found.reshape(len(times), -1, 3)


def _add_obstacles(
    plan: PickRecord, base: ViewScene, links: Links, link_poses: Array
) -> tuple[tuple[Solid, ...], Array]:
    """The solids with what stands around, and the poses with those of the world, if they had none."""
    world = links.index.get(0)
    if world is None:
        world = link_poses.shape[1]
        still = np.broadcast_to(to_sevens(np.eye(4)[None]), (len(link_poses), 1, 7))
        link_poses = np.concatenate([link_poses, still], axis=1)
    solids = list(base.solids)
    for name, body in plan.scene.obstacles.items():
        for shape in convex_shapes(body, []):
            vertices, faces = triangulate(shape)
            pose = body.shape_pose
            vertices = vertices @ pose[:3, :3].T + pose[:3, 3]
            solids.append(Solid(name=name, link=world, vertices=vertices, faces=faces, colour=_OBSTACLE))
    return tuple(solids), link_poses
