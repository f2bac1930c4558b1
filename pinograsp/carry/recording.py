"""A carry plan put together from what was found."""

from __future__ import annotations

import numpy as np

from pinograsp.carry.binding import name_binding
from pinograsp.carry.carry_plan import CarryPlan
from pinograsp.carry.cautions import doubt_drives, doubt_grasp, doubt_path, doubt_squeeze
from pinograsp.carry.commands import Commands
from pinograsp.carry.passage import Passage
from pinograsp.carry.passing import find_fastest_anywhere
from pinograsp.carry.squeeze import WaySqueeze
from pinograsp.carry.task import CarryTask
from pinograsp.checks import read_only
from pinograsp.spatial import Array

_BOUND = 1.05  # an interval that may be passed so many times as fast is bound by nothing
_AT_REST = 1e-3  # [rad/s or m/s]


def record_plan(task: CarryTask, squeeze: WaySqueeze, fastest: Passage | None, elapsed: dict[str, float]) -> CarryPlan:
    """The plan of a squeeze; ``fastest``: the timing with accelerations that jump, None: the timing was given."""
    passage, problem, x = squeeze.passage, task.limits.problem, squeeze.x
    commands, middle, knots = Commands(task=task, squeeze=squeeze), passage.constraints.middle, passage.knots
    loads, at_knots = -middle.wrench.at_square(passage.level), passage.timing.at(knots)
    limit, binding = _find_limits(passage, fastest)
    return CarryPlan(
        robot=task.robot,
        grasp=task.grasp,
        path=task.path,
        gravity_o=read_only(task.settings.gravity_o),
        timing=passage.timing,
        closing=commands.first_closing[0],
        contacts=tuple(problem.contacts.names),
        s=read_only(at_knots.s),
        times=read_only(knots),
        speed=read_only(at_knots.speed),
        instants=read_only(passage.instants),
        limit=read_only(limit),
        q=read_only(middle.q),
        dq=read_only(middle.speed * np.sqrt(passage.level)),
        ddq=read_only(middle.acceleration.at_square(passage.level)),
        torques=read_only(commands.torques),
        loads=read_only(loads),
        forces_o=read_only(np.einsum("kij,nkj->nki", problem.contacts.rotations_oc, commands.local)),
        normal_forces=read_only(x[..., -1]),
        commanded=read_only(squeeze.commanded),
        commanded_q=read_only(commands.positions),
        commanded_torques=read_only(commands.feed_forward),
        torsion=read_only(commands.torsion),
        friction_use=read_only(problem.friction.gauge(x[..., :-1]) / np.maximum(x[..., -1], 1e-300)),
        binding=binding,
        reserve=task.settings.reserve,
        fastest=None if fastest is None else fastest.timing.duration,
        lower_bound=None if fastest is None else fastest.solution.lower_bound,
        factor=passage.factor,
        residual=squeeze.residual,
        elapsed=elapsed,
        notes=(*squeeze.notes, *_note_speeds(task, passage)),
        cautions=_find_cautions(task, commands, loads),
        disturbance=task.disturbance,
    )


def _find_cautions(task: CarryTask, commands: Commands, loads: Array) -> tuple[str, ...]:
    """What speaks against the plan; ``loads`` (N, 6) [N, N m]."""
    loaded, (closing, first) = task.loaded[0], commands.first_closing
    own = doubt_grasp(task.grasp, arm_in_hand=bool(np.isin(loaded.arm, loaded.of_hand).any()))
    own += doubt_path(task.robot, task.path)
    own += doubt_drives(task.robot, commands.squeeze.passage.constraints.middle.q, commands.torques)
    if first is not None:
        own += doubt_squeeze(task.grasp, first, closing, commands.squeeze.x[..., -1].max(axis=0), loads)
    elif len(task.grasp.hand.drives) > 1:  # jaws press along their one way
        own.append(
            "no motion was found that closes the hand to the first squeeze of the path: the hand continues from the "
            "grasp's own"
        )
    return tuple(own)


def _note_speeds(task: CarryTask, passage: Passage) -> list[str]:
    """What the caller should know about how the way begins and ends."""
    speed = passage.timing.at(passage.knots[[0, -1]]).speed[:, None] * task.path.at(np.array([0.0, 1.0])).slope
    largest = float(np.abs(speed).max())
    if largest < _AT_REST:
        return []
    return [f"the trajectory does not begin and end at rest: joints move by up to {largest:.3g} rad/s or m/s there"]


def _find_limits(passage: Passage, fastest: Passage | None) -> tuple[Array, tuple[str, ...]]:
    """How fast each place may be passed by itself (N,) [1/s], and what binds there."""
    s, N = passage.s, passage.constraints.count
    _, limit = find_fastest_anywhere((passage if fastest is None else fastest).places)
    if fastest is None:
        return limit, name_binding(passage.constraints, passage.solution, passage.headroom > _BOUND)
    words = name_binding(fastest.places, fastest.solution)
    nearest = np.clip((s * N).astype(int), 0, N - 1)
    return np.interp(s, (np.arange(N) + 0.5) / N, limit), tuple(words[i] for i in nearest.tolist())
