"""Held or lost: what the samples of a simulation say."""

from __future__ import annotations

import numpy as np

from pinograsp.referee.simulation import GONE, MOVED, RESTING, TURNED, Verdict

_SLIPPED = 1e-4  # [m]
_BEYOND = 1e-3  # [rad or m] past a joint's limit
_AT_LIMIT = 1e-6  # of a torque limit


def verdict_of(task, joints, shown, release, audited: bool, complete: int, gone: bool, samples: dict) -> Verdict:
    """The verdict on a task from the samples of its simulation: ``release`` [s] or None; ``complete``: the sample at
    t_F, before which the object does not move; ``gone``: it was that far away that the simulation ended early.
    """
    times, poses = samples["times"], samples["object_poses"]
    normal, planned = samples["normal_forces"], samples["planned_forces"]
    start, end = poses[complete], poses[-1]
    drift = float(np.linalg.norm(end[:3, 3] - start[:3, 3]))
    turned = end[:3, :3] @ start[:3, :3].T
    turn = float(np.degrees(np.arccos(np.clip((np.trace(turned) - 1) / 2, -1, 1))))
    gravity = np.linalg.norm(task.gravity_o)
    up = -task.gravity_o / gravity if gravity > 0 else np.array([0.0, 0.0, 1.0])
    tilt = float(np.degrees(np.arccos(np.clip(up @ turned @ up, -1, 1))))
    held, reason = _held(times, poses, normal, drift, turn, release, gone)

    # The last tenth of the hold: whatever still swings is averaged.
    last = slice(min(times.size - 1, times.size - max(1, (times.size - complete) // 10)), None)
    should = planned > 0
    # Of contacts that hardly carry, an error counts against a twentieth of the largest force.
    errors = (
        np.abs(normal[last].mean(axis=0) - planned)[should]
        / np.maximum(planned, 0.05 * planned.max(initial=0.0))[should]
    )
    labels = [name for name, wanted in zip(samples["parts"], should) if wanted]
    depth_planned = np.zeros(len(shown))
    for i, part in enumerate(shown):
        depth_planned[i] = max((d for d, joint in zip(task.depths, joints) if joint == part), default=0.0)
    missed = np.abs(samples["depths"][complete] - depth_planned)[should]
    slipped = samples["slips"][-1] - samples["slips"][complete] > _SLIPPED
    hand, q = task.hand, samples["q"]
    beyond = ((q < hand.lower - _BEYOND) | (q > hand.upper + _BEYOND)).any(axis=0)
    at_limit = np.abs(samples["torques"][last]).max(axis=0) >= task.torque_limit * (1 - _AT_LIMIT)
    return Verdict(
        held=held,
        reason=reason,
        drift=drift,
        tilt=tilt,
        turn=turn,
        force_error=float(errors.max(initial=0.0)),
        force_errors=dict(zip(labels, errors.tolist())),
        penetration_error=float(missed.max(initial=0.0)),
        slipped=tuple(name for name, yes in zip(samples["parts"], slipped) if yes),
        unplanned=tuple(
            name
            for name, wanted, found in zip(samples["parts"], should, (normal > 0).any(axis=0))
            if found and not wanted
        ),
        limit_hits=tuple(name for name, yes in zip(hand.joint_names, beyond) if yes),
        saturated=tuple(name for name, yes in zip(hand.joint_names, at_limit) if yes),
        energy_error=_energy_error(samples["energies"]) if audited else None,
    )


def _held(times, poses, normal, drift: float, turn: float, release, gone: bool) -> tuple[bool, str]:
    if release is None:
        return True, "the object was never let go"
    since = times[-1] - release
    if gone or not drift <= GONE:
        return False, f"the object was {1e3 * drift:.0f} mm away {since:.2f} s after it was let go"
    if not (drift <= MOVED and turn <= TURNED):
        return False, f"the object moved {1e3 * drift:.2f} mm and turned {turn:.1f} deg within {since:.2f} s"
    resting = poses[times >= times[-1] - 0.2 * max(since, 0.0)]
    still = float(np.linalg.norm(resting[:, :3, 3] - resting[-1, :3, 3], axis=1).max())
    if not still <= RESTING:
        return False, f"the object still creeps: {1e3 * still:.2f} mm in the last {0.2 * since:.2f} s"
    if not normal[-1].any():
        return False, f"nothing touched the object {since:.2f} s after it was let go"
    return True, f"{1e3 * drift:.3f} mm and {turn:.2f} deg after {since:.2f} s"


def _energy_error(energies: dict[str, np.ndarray]) -> float:
    """Largest gap between energy put in and energy held or lost, relative to all that was put in and given out."""
    put_in = energies["joint_work"] + energies["load_work"]
    kept = sum(energies[name] for name in ("mechanical", "elastic", "damped", "slipped"))
    turned_over = np.abs(np.array(list(energies.values()))).max()
    return float(np.abs(put_in - kept).max() / max(turned_over, 1e-12))
