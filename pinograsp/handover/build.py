"""From a plan to the trajectory that its controller gets."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from typing import TypedDict

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from pinograsp.checks import array_of, instance_of, number, read_only
from pinograsp.errors import InvalidInput, Status
from pinograsp.handover.quintic import between, interpolate
from pinograsp.handover.trajectory import JointTrajectory
from pinograsp.hands import HandModel
from pinograsp.motion.torques import inverse_dynamics
from pinograsp.plan import Motion, PlanRecord

_BLEND = 0.01  # [s] a few periods of any controller; a jump of 60 rad/s^2 then costs 0.1 mrad
# An acceleration that changes by more than this share of the joint's largest from one sample to the next, and this,
# jumps.
_JUMP, _LEAST_JUMP = 0.1, 1e-3
_PEAK = 1.875  # peak speed of a polynomial from rest to rest, over its mean
# A lead-in takes at least so long [s], at half the velocity limits and no faster than this [rad/s], [m/s].
_LEAST_LEAD, _TURNING, _SLIDING = 0.5, 1.0, 0.05
_SLACK = 1e-6  # [rad or m] beyond a limit, as elsewhere
_NOTHING = 1e-12  # [rad or m] of a deviation: rounding
_FAR = 1e-4  # [m] of a contact point from the plan: forces of stiff contacts change by several per cent
_MOST, _FEW = 1_000_000, 10  # samples: more is a mistyped rate, fewer in the grasp phase are noted


class Sampling(TypedDict, total=False):
    """How a plan is sampled for a controller: the keyword arguments of :func:`joint_trajectory`."""

    rate: float
    start: ArrayLike | None
    lead: float | None
    blend: float | None


def joint_trajectory(
    plan: PlanRecord,
    *,
    rate: float = 1000.0,
    start: ArrayLike | None = None,
    lead: float | None = None,
    blend: float | None = None,
) -> JointTrajectory:
    """Sample a plan's motion at a controller's rate, from ``start``, with continuous acceleration and rest at both
    ends.

    Args:
        plan: new or read back.
        rate: samples per second [Hz].
        start: initial posture (n,) [rad or m]; default: the plan's first. The path from it is straight in joint space
            and not checked for collisions.
        lead: duration of that path [s]; default: at half the velocity limits, 1 rad/s or 0.05 m/s at most, 0.5 s at
            least. Without ``start``: time that the hand waits in the first posture.
        blend: time in which a jump of the acceleration is bridged [s]; default 10 ms, or half of the shorter phase.

    Raises:
        InvalidInput: a plan without its hand, numbers out of range, a start outside the joint limits, or a lead too
            short for the velocity limits.
    """
    hand, motion = instance_of("plan", plan, PlanRecord).require_hand(), plan.motion
    rate = number("rate", rate, above=0, unit="Hz")
    half = _half_blend(motion, blend)
    first = motion.q[0]
    origin = first if start is None else _start(hand, start)
    path = _path(motion, origin, _lead(hand, np.abs(first - origin), lead, rate), half)

    if path.end * rate >= _MOST:
        raise InvalidInput(
            f"rate: expected fewer than {_MOST} samples in {path.end:.4g} s, got {rate:g} Hz: take a lower one"
        )
    # To the end or just past it, where the hand is at rest.
    clock = np.arange(math.ceil(path.end * rate - 1e-9) + 1) / rate
    q, dq, ddq = between(path.nodes, path.states, np.minimum(clock, path.end))
    q[-1], dq[-1], ddq[-1] = motion.q[-1], 0.0, 0.0
    own = inverse_dynamics(hand, motion.q, motion.dq, motion.ddq, gravity_o=plan.gravity_o)
    pressing = interpolate(clock - path.begin, motion.times, motion.torques - own)
    effort = inverse_dynamics(hand, q, dq, ddq, gravity_o=plan.gravity_o) + pressing

    wanted, played = _compare(motion, path, clock, (q, dq, ddq), half)
    off = _contact_deviation(hand, plan, wanted, played)
    t_I, t_F = float(motion.times[motion.impact]), float(motion.times[-1])
    return JointTrajectory(
        names=hand.joint_names,
        times=clock,
        q=q,
        dq=dq,
        ddq=ddq,
        effort=effort,
        contact_effort=pressing,
        joints=tuple(hand.model.names)[1:],
        couplings=hand.couplings,
        begin=path.begin,
        impact_time=path.begin + t_I,
        final_time=path.begin + t_F,
        blends=tuple((path.begin + a, path.begin + b) for a, b in path.blends),
        deviation=read_only(np.abs(played - wanted).max(axis=0)),
        contact_deviation=off,
        notes=(*_plan_notes(plan, rate), *_limit_notes(hand, q, dq, effort), *_deviation_notes(off)),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Path:
    """Nodes of the path, with position, velocity and acceleration.

    Attributes:
        nodes: (b,) [s].
        states: q, dq, ddq at the nodes (b, n).
        knots: q, dq, ddq of the plan's samples (m, n).
        begin: t = 0 of the plan [s].
        blends: intervals in which the path is not the plan's, on the plan's clock [s].
        starts_softly: whether the plan's start is blended into rest.
    """

    nodes: np.ndarray
    states: tuple[np.ndarray, ...]
    knots: tuple[np.ndarray, ...]
    begin: float
    blends: tuple[tuple[float, float], ...]
    starts_softly: bool

    @property
    def end(self) -> float:
        """When the hand is at rest again [s]."""
        return float(self.nodes[-1])


def _half_blend(motion: Motion, blend: float | None) -> float:
    """Half of the time that leads across a jump of the acceleration [s]."""
    longest = 0.5 * min(motion.times[motion.impact], motion.times[-1] - motion.times[motion.impact])
    half = 0.5 * number("blend", min(_BLEND, longest) if blend is None else blend, above=0, unit="s")
    if 2 * half > longest * (1 + 1e-9):
        raise InvalidInput(f"blend: expected at most {longest:.4g} s, half of the shorter phase, got {2 * half:g} s")
    return half


def _path(motion: Motion, origin: np.ndarray, lead: float, half: float) -> _Path:
    """The plan's samples without those near a jump, from ``origin``, with rest at both ends."""
    times, knots = motion.times, _knots(motion)
    t_F, first, last = times[-1], knots[0][0], knots[0][-1]
    # The plan's ends are blended into rest, from half a blend before t = 0 and until half a blend after t_F.
    soft_start, soft_end = (bool(np.any(knots[1][i]) or np.any(knots[2][i])) for i in (0, -1))
    begin = lead + (half if soft_start else 0.0)
    jumps = [*_jumps(motion), *([0.0] if soft_start else []), *([t_F] if soft_end else [])]
    near = np.zeros(times.size, dtype=bool)
    for jump in jumps:
        near |= np.abs(times - jump) < half - 1e-9
    near[0], near[-1] = soft_start, soft_end
    kept = np.flatnonzero(~near)
    parts = [_rest(0.0, origin)] if lead > 0 else []
    parts += [_rest(lead, first)] if soft_start else []
    parts += [(begin + times[kept], *(values[kept] for values in knots))]
    parts += [_rest(begin + t_F + half, last)] if soft_end else []
    nodes, *states = (np.concatenate(columns) for columns in zip(*parts))
    blends = [(-half, float(times[kept[0]]))] if soft_start else []
    blends += [(float(times[i]), float(times[j])) for i, j in itertools.pairwise(kept) if j > i + 1]
    blends += [(float(times[kept[-1]]), float(t_F + half))] if soft_end else []
    return _Path(
        nodes=nodes,
        states=tuple(states),
        knots=knots,
        begin=begin,
        blends=tuple(blends),
        starts_softly=soft_start,
    )


def _compare(
    motion: Motion, path: _Path, clock: np.ndarray, samples: tuple[np.ndarray, ...], half: float
) -> tuple[np.ndarray, np.ndarray]:
    """The plan's positions, and what a controller makes of the samples (s, n): at the plan's samples, half-way between,
    and in the blends beyond.
    """
    times, t_F = motion.times, motion.times[-1]
    beyond = half * np.linspace(0, 1, 9)
    before = [-beyond] if path.starts_softly else []
    looked = np.concatenate([times, 0.5 * (times[1:] + times[:-1]), t_F + beyond, *before])
    wanted = between(times, path.knots, np.clip(looked, 0.0, t_F))[0]
    return wanted, between(clock, samples, np.minimum(path.begin + looked, clock[-1]))[0]


def _plan_notes(plan: PlanRecord, rate: float) -> list[str]:
    notes = [] if plan.status is Status.OK else [f"the plan's status is {plan.status}: {plan.status.remedy}"]
    times, impact = plan.motion.times, plan.motion.impact
    if (times[-1] - times[impact]) * rate < _FEW:
        notes.append(
            f"fewer than {_FEW} samples in the grasp phase at {rate:g} Hz: "
            "the controller must interpolate with their rates"
        )
    return notes


def _deviation_notes(off: dict[str, float]) -> list[str]:
    if not off or max(off.values()) <= _FAR:
        return []
    return [
        f"{max(off, key=off.__getitem__)} is up to {1e3 * max(off.values()):.2g} mm off the plan: use a shorter blend, "
        "a higher rate, or a plan with a finer time step"
    ]


def _knots(motion: Motion) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """q, dq, ddq (m, n) of the plan's samples, as smooth as its positions.

    The approach is a polynomial. In the grasp phase rates are those that were asked for step by step, corrections
    included, of which they are not quite the derivative: there both come from a spline through the positions.
    """
    q, dq, ddq = np.array(motion.q), np.array(motion.dq), np.array(motion.ddq)
    impact, grasp = motion.impact, motion.times[motion.impact + 1 :]
    spline = CubicSpline(motion.times[impact:], q[impact:])
    dq[impact + 1 :], ddq[impact + 1 :] = spline(grasp, 1), spline(grasp, 2)
    return q, dq, ddq


def _jumps(motion: Motion) -> np.ndarray:
    """Times from t_I on at which the acceleration of a joint changes abruptly (second differences of it) [s]."""
    steps = np.diff(motion.times)[:, None]
    acceleration = 2 * np.diff(np.diff(motion.q, axis=0) / steps, axis=0) / (steps[1:] + steps[:-1])
    rough = np.abs(np.diff(acceleration, 2, axis=0))  # at times[2:-2]
    found = (rough > np.maximum(_JUMP * np.abs(motion.ddq).max(axis=0), _LEAST_JUMP)).any(axis=1)
    at = np.flatnonzero(found) + 2
    return motion.times[at[at >= motion.impact - 1]]


def _rest(time: float, q: np.ndarray) -> tuple[np.ndarray, ...]:
    still = np.zeros((1, q.size))
    return np.array([time]), q[None], still, still


def _start(hand: HandModel, start: ArrayLike) -> np.ndarray:
    q = array_of("start", start, (hand.n,))
    beyond = _beyond(hand, q)
    if beyond.max() > _SLACK:
        j = int(np.argmax(beyond))
        raise InvalidInput(
            f"start: expected postures within the joint limits, got {q[j]:g} for {hand.joint_names[j]}, limits "
            f"{hand.lower[j]:g} to {hand.upper[j]:g}: give where the joints are [rad or m], or widen them (with_limits)"
        )
    return q


def _beyond(hand: HandModel, q: np.ndarray) -> np.ndarray:
    """How far positions (..., n) are beyond the ends of the joints' ways [rad or m]; below 0 where they are not."""
    low, high = hand.travel
    return np.asarray(np.maximum(low - q, q - high))


def _lead(hand: HandModel, way: np.ndarray, lead: float | None, rate: float) -> float:
    """How long the joints take to go their ``way`` (n,) from rest to rest [s]."""
    limit = hand.speed_limits
    least = _PEAK * way / limit
    if lead is None:
        gentle = _PEAK * way / np.minimum(0.5 * limit, np.where(hand.slides, _SLIDING, _TURNING))
        return math.ceil(min(max(_LEAST_LEAD, gentle.max()) * rate, _MOST)) / rate if way.any() else 0.0
    lead, worst = number("lead", lead, at_least=0, unit="s"), int(np.argmax(least))
    if way.any() and (lead == 0 or lead < least[worst] * (1 - 1e-9)):
        name, bound = hand.joint_names[worst], "more than 0 s"
        if least[worst] > 0:
            bound = f"at least {least[worst]:.4g} s, for the velocity limit of {name}"
        raise InvalidInput(f"lead: expected {bound}, got {lead:g} s: give it more time, or leave it out")
    return lead


def _limit_notes(hand: HandModel, q: np.ndarray, dq: np.ndarray, effort: np.ndarray) -> list[str]:
    beyond = _beyond(hand, q).max(axis=0)
    notes = [
        f"{name} leaves its limits by {by:.2g} rad or m" for name, by in zip(hand.joint_names, beyond) if by > _SLACK
    ]
    for what, values, limits in (("moves at", dq, hand.velocity), ("needs", effort, hand.effort)):
        kind = "velocity" if values is dq else "effort"
        notes += [
            f"{name} {what} up to {peak:.3g}, more than its {kind} limit of {limit:g}"
            for name, peak, limit in zip(hand.joint_names, np.abs(values).max(axis=0), limits)
            if 0 < limit < peak
        ]
    return notes


def _contact_deviation(hand: HandModel, plan: PlanRecord, wanted: np.ndarray, played: np.ndarray) -> dict[str, float]:
    """Largest distance of each contact point, as a point of its link, between two motions (s, n) [m]."""
    contacts = plan.contacts
    rows = [row for row in zip(contacts.names, contacts.links, contacts.points_o) if row[1]]
    if not rows:
        return {}
    names, links, points = zip(*rows)
    touching = hand.frame_placements(plan.motion.q[plan.motion.impact], links)
    local = np.array([np.linalg.solve(placement, [*point, 1.0]) for placement, point in zip(touching, points)])
    worst = np.zeros(len(links))
    for one, other in zip(wanted, played):
        if np.abs(one - other).max() > _NOTHING:
            apart = hand.frame_placements(one, links) - hand.frame_placements(other, links)
            worst = np.maximum(worst, np.linalg.norm(np.einsum("kij,kj->ki", apart, local), axis=1))
    return dict(zip(names, worst.tolist()))
