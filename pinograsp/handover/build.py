"""From a plan to the trajectory that its controller gets."""

from __future__ import annotations

import itertools
import math

import numpy as np
from scipy.interpolate import CubicSpline

from pinograsp.checks import array_of, number, read_only, shown
from pinograsp.errors import InvalidInput, Status
from pinograsp.handover.quintic import between, interpolated
from pinograsp.handover.trajectory import JointTrajectory
from pinograsp.hands import HandModel
from pinograsp.motion.torques import inverse_dynamics

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
_MOST, _FEW = 1_000_000, 10  # samples: more is a mistyped rate, fewer in the grasp phase are told


def joint_trajectory(
    plan, *, rate: float = 1000.0, start=None, lead: float | None = None, blend: float | None = None
) -> JointTrajectory:
    """A plan's motion at a controller's rate, from ``start``, with continuous acceleration and rest at both ends.

    Args:
        plan: a :class:`~pinograsp.plan.GraspPlan`, or a :class:`~pinograsp.storage.Run` of one.
        rate: samples per second [Hz].
        start: posture to come from (n,) [rad or m]; default: the plan's first. The way from it is straight in joint
            space and not checked for collisions.
        lead: how long that takes [s]; default: at half the velocity limits, 1 rad/s or 0.05 m/s at most, 0.5 s at
            least. Without ``start``: how long the hand waits in the first posture.
        blend: how long it takes to lead across a jump of the acceleration [s]; default 10 ms, or half of the
            shorter phase.

    Raises:
        InvalidInput: a plan without motion, numbers out of range, a start outside the joint limits, or a lead too short
            for the velocity limits.
    """
    hand, arrays, status = _parts(plan)
    rate = number("rate", rate, above=0, unit="Hz")
    times, impact = arrays["times"], int(arrays["impact"])
    t_F = times[-1]
    longest = 0.5 * min(times[impact], t_F - times[impact])
    half = 0.5 * number("blend", min(_BLEND, longest) if blend is None else blend, above=0, unit="s")
    if 2 * half > longest * (1 + 1e-9):
        raise InvalidInput(f"blend: expected at most {longest:.4g} s, half of the shorter phase, got {2 * half:g} s")
    knots = _knots(arrays, impact)
    first, last = knots[0][0], knots[0][-1]
    origin = first if start is None else _start(hand, start)
    lead = _lead(hand, np.abs(first - origin), lead, rate)

    # The plan's ends are blended into rest, from half a blend before t = 0 and until half a blend after t_F.
    soft_start, soft_end = (np.any(knots[1][i]) or np.any(knots[2][i]) for i in (0, -1))
    begin = lead + (half if soft_start else 0.0)
    jumps = [*_jumps(times, arrays, impact), *([0.0] if soft_start else []), *([t_F] if soft_end else [])]
    near = (
        np.any([np.abs(times - jump) < half - 1e-9 for jump in jumps], axis=0)
        if jumps
        else np.zeros(times.size, dtype=bool)
    )
    near[0], near[-1] = soft_start, soft_end
    kept = np.flatnonzero(~near)
    path = [_rest(0.0, origin)] if lead > 0 else []
    path += [_rest(lead, first)] if soft_start else []
    path += [(begin + times[kept], *(values[kept] for values in knots))]
    path += [_rest(begin + t_F + half, last)] if soft_end else []
    nodes, *states = (np.concatenate(parts) for parts in zip(*path))
    blends = [(times[i], times[j]) for i, j in itertools.pairwise(kept) if j > i + 1]
    blends = [
        *([(-half, times[kept[0]])] if soft_start else []),
        *blends,
        *([(times[kept[-1]], t_F + half)] if soft_end else []),
    ]

    if nodes[-1] * rate >= _MOST:
        raise InvalidInput(
            f"rate: expected fewer than {_MOST} samples in {nodes[-1]:.4g} s, got {rate:g} Hz: take a lower one"
        )
    clock = (
        np.arange(math.ceil(nodes[-1] * rate - 1e-9) + 1) / rate
    )  # to the end or just past it, where the hand is at rest
    q, dq, ddq = between(nodes, states, np.minimum(clock, nodes[-1]))
    q[-1], dq[-1], ddq[-1] = last, 0.0, 0.0
    gravity_o = arrays["gravity"]
    contact = arrays["torques"] - inverse_dynamics(hand, arrays["q"], arrays["dq"], arrays["ddq"], gravity_o=gravity_o)
    effort = inverse_dynamics(hand, q, dq, ddq, gravity_o=gravity_o) + interpolated(clock - begin, times, contact)

    # What a controller makes of the samples, against the plan: at its own samples, half-way between, and in the blends
    # beyond.
    beyond = half * np.linspace(0, 1, 9)
    looked = np.concatenate([times, 0.5 * (times[1:] + times[:-1]), t_F + beyond, *([-beyond] if soft_start else [])])
    wanted = between(times, knots, np.clip(looked, 0.0, t_F))[0]
    played = between(clock, (q, dq, ddq), np.minimum(begin + looked, clock[-1]))[0]
    notes = [] if status is Status.OK else [f"the plan's status is {status}: {status.remedy}"]
    notes += _limit_notes(hand, q, dq, effort)
    if (t_F - times[impact]) * rate < _FEW:
        notes.append(
            f"fewer than {_FEW} samples in the grasp phase at {rate:g} Hz: the controller must interpolate with "
            "their rates"
        )
    off = _contact_deviation(hand, arrays, impact, wanted, played)
    if off and max(off.values()) > _FAR:
        notes.append(
            f"{max(off, key=off.get)} is up to {1e3 * max(off.values()):.2g} mm off the plan: take a shorter "
            "blend, a higher rate, or a "
            "plan with a finer time step"
        )
    return JointTrajectory(
        names=hand.joint_names,
        times=clock,
        q=q,
        dq=dq,
        ddq=ddq,
        effort=effort,
        joints=tuple(hand.model.names)[1:],
        couplings=hand.couplings,
        begin=begin,
        impact_time=begin + float(times[impact]),
        final_time=begin + float(t_F),
        blends=tuple((begin + float(a), begin + float(b)) for a, b in blends),
        deviation=read_only(np.abs(played - wanted).max(axis=0)),
        contact_deviation=off,
        notes=tuple(notes),
    )


def _parts(plan):
    """Hand, arrays and status of a plan or a run."""
    if hasattr(plan, "motion") and hasattr(plan, "problem"):
        motion, contacts = plan.motion, plan.problem.contacts
        arrays = {name: getattr(motion, name) for name in ("times", "impact", "q", "dq", "ddq", "torques")}
        arrays |= {"gravity": plan.problem.gravity_o, "points_o": contacts.points_o, "contact_names": contacts.names}
        return plan.hand, arrays | {"contact_links": [contact.link for contact in contacts]}, plan.status
    if not (hasattr(plan, "arrays") and hasattr(plan, "layout")):
        raise InvalidInput(f"plan: expected a GraspPlan or the run of one, got {shown(plan)}")
    needed = ("times", "impact", "q", "dq", "ddq", "torques", "gravity", "points_o", "contact_names", "contact_links")
    if missing := [name for name in needed if name not in plan.arrays]:
        raise InvalidInput(f"plan: expected one with its motion, got a run without {', '.join(missing)}: plan it again")
    return plan.hand(), plan.arrays, Status(plan.summary["status"])


def _knots(arrays, impact: int) -> list[np.ndarray]:
    """q, dq, ddq (m, n) of the plan's samples, as smooth as its positions.

    The approach is a polynomial. In the grasp phase rates are those that were asked for step by step, corrections
    included, of which they are not quite the derivative: there both come from a spline through the positions.
    """
    q, dq, ddq = (np.array(arrays[name]) for name in ("q", "dq", "ddq"))
    spline = CubicSpline(arrays["times"][impact:], q[impact:])
    grasp = arrays["times"][impact + 1 :]
    dq[impact + 1 :], ddq[impact + 1 :] = spline(grasp, 1), spline(grasp, 2)
    return [q, dq, ddq]


def _jumps(times, arrays, impact: int) -> np.ndarray:
    """Times from t_I on at which the acceleration of a joint changes abruptly (second differences of it) [s]."""
    steps = np.diff(times)[:, None]
    acceleration = 2 * np.diff(np.diff(arrays["q"], axis=0) / steps, axis=0) / (steps[1:] + steps[:-1])
    rough = np.abs(np.diff(acceleration, 2, axis=0))  # at times[2:-2]
    found = (rough > np.maximum(_JUMP * np.abs(arrays["ddq"]).max(axis=0), _LEAST_JUMP)).any(axis=1)
    at = np.flatnonzero(found) + 2
    return times[at[at >= impact - 1]]


def _rest(time: float, q: np.ndarray):
    still = np.zeros((1, q.size))
    return np.array([time]), q[None], still, still


def _start(hand: HandModel, start) -> np.ndarray:
    q = array_of("start", start, (hand.n,))
    beyond = np.maximum(hand.lower - q, q - hand.upper)
    if beyond.max() > _SLACK:
        j = int(np.argmax(beyond))
        raise InvalidInput(
            f"start: expected postures within the joint limits, got {q[j]:g} for {hand.joint_names[j]}, limits "
            f"{hand.lower[j]:g} to {hand.upper[j]:g}: give where the joints are [rad or m], or widen them (with_limits)"
        )
    return q


def _lead(hand: HandModel, way, lead: float | None, rate: float) -> float:
    """How long the joints take to go their ``way`` (n,) from rest to rest [s]."""
    limit = np.where(hand.velocity > 0, hand.velocity, np.inf)
    least = _PEAK * way / limit
    if lead is None:
        slides = [hand.is_prismatic(hand.model.getJointId(name)) for name in hand.joint_names]
        gentle = _PEAK * way / np.minimum(0.5 * limit, np.where(slides, _SLIDING, _TURNING))
        return math.ceil(min(max(_LEAST_LEAD, gentle.max()) * rate, _MOST)) / rate if way.any() else 0.0
    lead, worst = number("lead", lead, at_least=0, unit="s"), int(np.argmax(least))
    if way.any() and (lead == 0 or lead < least[worst] * (1 - 1e-9)):
        name, bound = hand.joint_names[worst], "more than 0 s"
        if least[worst] > 0:
            bound = f"at least {least[worst]:.4g} s, for the velocity limit of {name}"
        raise InvalidInput(f"lead: expected {bound}, got {lead:g} s: give it more time, or none for one that is chosen")
    return lead


def _limit_notes(hand: HandModel, q, dq, effort) -> list[str]:
    beyond = np.maximum(hand.lower - q, q - hand.upper).max(axis=0)
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


def _contact_deviation(hand: HandModel, arrays, impact: int, wanted, played) -> dict[str, float]:
    """Largest distance of each contact point, as a point of its link, between two motions (s, n) [m]."""
    rows = [
        (str(name), str(link), point)
        for name, link, point in zip(arrays["contact_names"], arrays["contact_links"], arrays["points_o"])
        if str(link)
    ]
    if not rows:
        return {}
    names, links, points = zip(*rows)
    touching = hand.frame_placements(arrays["q"][impact], links)
    local = np.array([np.linalg.solve(placement, [*point, 1.0]) for placement, point in zip(touching, points)])
    worst = np.zeros(len(links))
    for one, other in zip(wanted, played):
        if np.abs(one - other).max() > _NOTHING:
            apart = hand.frame_placements(one, links) - hand.frame_placements(other, links)
            worst = np.maximum(worst, np.linalg.norm(np.einsum("kij,kj->ki", apart, local), axis=1))
    return dict(zip(names, worst.tolist()))
