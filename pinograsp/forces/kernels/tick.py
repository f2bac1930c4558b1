"""One tick of a control loop: the forces that hold a load, and the joint torques that give them."""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.algebra import not_finite
from pinograsp.forces.kernels.dual import ascend
from pinograsp.forces.kernels.flags import FLAGS, PIECE
from pinograsp.forces.kernels.layouts import (
    CONVERGED,
    INFEASIBLE,
    STALLED,
    Hand,
    TickInputs,
    TickOutputs,
    TickRoom,
    TickSettings,
)
from pinograsp.forces.kernels.memory import compiled_tick_in, hand_in, has_torque_rows
from pinograsp.forces.kernels.newton import BALANCED, closest
from pinograsp.forces.kernels.rows import columns, judge
from pinograsp.forces.kernels.torques import within_torques
from pinograsp.spatial import Array, IntArray


@jit(**PIECE)
def _unusable(inputs: TickInputs, gravity: Array) -> bool:
    """Whether an input is not finite, or a friction coefficient negative."""
    for mu in inputs.mu:
        if mu < 0.0:
            return True
    return (
        not_finite(inputs.wrench)
        or not_finite(inputs.points)
        or not_finite(inputs.rotations)
        or not_finite(inputs.mu)
        or not_finite(gravity)
    )


@jit(**PIECE)
def _set_up(settings: TickSettings, inputs: TickInputs, forces: Array, room: TickRoom) -> float:
    """The tick's problem in ``room``; returns what forces [N] are divided by."""
    d, m, k = settings.components, settings.rows, settings.contacts
    (A, b, _), (w, q), (lo, hi, radii, n_round), slip = room.balance, room.quadratic, room.cones, room.slip
    wrench, share, target = inputs.wrench, inputs.share, inputs.target
    lowest, highest, mu = inputs.least, inputs.largest, inputs.mu
    e, scale, rate, ramp, arm = d - 1, 1e-9, inputs.rate[0], settings.ramp, settings.arm
    for r in range(m):
        b[r] = -wrench[r] if r < 3 else -wrench[r] / arm
        scale = max(scale, abs(b[r]))
    for i in range(k):
        # Contacts are gained and lost gradually, and no force changes by more than its limit per tick.
        share[i] += min(max(target[i] - share[i], -ramp), ramp)
        least, largest, F = lowest[i] * share[i], highest[i] * share[i], forces[i, 2]
        lo[i] = min(max(least, F - rate), largest)
        hi[i] = max(min(largest, F + rate), lo[i])
        slip[i] = mu[i] / settings.safety
        scale = max(scale, lo[i])
    columns(inputs.points, inputs.rotations, slip, settings.torsion / settings.safety, arm, A, room.widths)
    for j in range(e):
        radii[j] = np.sqrt(0.5) if n_round == 0 and j < 2 else 1.0
    for i in range(k):
        lo[i], hi[i] = lo[i] / scale, hi[i] / scale
        for j in range(d):
            # Without friction the tangential components are zero: any weight will do.
            w[j, i], q[j, i] = 1.0 if j == e else max(slip[i] * slip[i], 1e-6), 0.0
    for r in range(m):
        b[r] /= scale
    return scale


@jit(**PIECE)
def _solve(room: TickRoom, scale: float, most: int) -> tuple[int, int]:
    """Forces x in ``room``, from the last tick's multipliers, and where these do not lead there from zero; the closest
    forces where none balance the load.
    """
    balance, quadratic, cones, x, y, work = room.balance, room.quadratic, room.cones, room.x, room.y, room.work
    multipliers = room.multipliers
    for r in range(y.shape[0]):
        y[r] = multipliers[r] / scale
    code, steps = ascend(balance, quadratic, cones, x, y, BALANCED, most, work)
    if code == STALLED:
        y[:] = 0.0
        code, used = ascend(balance, quadratic, cones, x, y, BALANCED, most, work)
        steps += used
    for r in range(y.shape[0]):
        multipliers[r] = y[r] * scale if code == CONVERGED else 0.0
    if code != CONVERGED:
        code, used = closest(balance, quadratic, cones, x, y, most, work)
        steps += used
    return code, steps


@jit(**FLAGS)
def _write_out(inputs: TickInputs, outputs: TickOutputs, x: Array, widths: Array, scale: float, hand: Hand) -> None:
    """Fills ``outputs`` from x (d, k)."""
    com, wrench, points, rotations = inputs.com, inputs.wrench, inputs.points, inputs.rotations
    forces, moments, unbalanced, torques = outputs
    jacobian, gravity, links = hand
    d, k = x.shape
    e = d - 1
    for r in range(6):
        unbalanced[r] = wrench[r]
    for j in range(len(torques)):
        torques[j] = gravity[j]
    p = 0
    for i in range(k):
        forces[i, 0], forces[i, 1], forces[i, 2] = (
            x[0, i] * scale * widths[0, i],
            x[1, i] * scale * widths[1, i],
            x[e, i] * scale,
        )
        moments[i] = x[2, i] * scale * widths[2, i] if d == 4 else 0.0
        R = rotations[i]
        f = (
            R[0, 0] * forces[i, 0] + R[0, 1] * forces[i, 1] + R[0, 2] * forces[i, 2],
            R[1, 0] * forces[i, 0] + R[1, 1] * forces[i, 1] + R[1, 2] * forces[i, 2],
            R[2, 0] * forces[i, 0] + R[2, 1] * forces[i, 1] + R[2, 2] * forces[i, 2],
        )
        turn = (R[0, 2] * moments[i], R[1, 2] * moments[i], R[2, 2] * moments[i])
        for r in range(3):
            s, t = (r + 1) % 3, (r + 2) % 3
            unbalanced[r] += f[r]
            unbalanced[3 + r] += turn[r] + points[i, s] * f[t] - points[i, t] * f[s]
        P = (points[i, 0] + com[0], points[i, 1] + com[1], points[i, 2] + com[2])
        a = (
            turn[0] + P[1] * f[2] - P[2] * f[1],
            turn[1] + P[2] * f[0] - P[0] * f[2],
            turn[2] + P[0] * f[1] - P[1] * f[0],
        )
        while p < links.shape[0] and links[p, 0] == i:
            J = jacobian[6 * links[p, 1] :][:6]
            t = J[0] * f[0] + J[1] * f[1] + J[2] * f[2]
            torques[links[p, 2]] += t + J[3] * a[0] + J[4] * a[1] + J[5] * a[2]
            p += 1


@jit(**FLAGS)
def online(memory: Array, jacobian: Array, gravity: Array, chains: IntArray) -> tuple[int, int, float]:
    """One tick of :class:`pinograsp.motion.OnlineForces`: (code, Newton steps, norm of the unbalanced load [N]).

    memory and chains: see :mod:`pinograsp.forces.kernels.memory`; jacobian and gravity: of
    :class:`~pinograsp.forces.kernels.layouts.Hand`.

    The objective is the sum of squares of F_n and of tangential forces; a torsional moment counts as the tangential
    force that uses as much friction. CONVERGED: balanced; INFEASIBLE: the closest forces; STALLED: the closest forces
    found within the steps; -1: an input is not finite or a friction coefficient is negative, and nothing has changed.
    """
    tick = compiled_tick_in(memory)
    settings, inputs, outputs, room = tick
    if _unusable(inputs, gravity):
        return -1, 0, 0.0
    hand = hand_in(chains, jacobian, gravity)
    scale = _set_up(settings, inputs, outputs.forces, room)
    code, steps = _solve(room, scale, settings.steps)
    _write_out(inputs, outputs, room.x, room.widths, scale, hand)
    limit, torques = inputs.torque_limit, outputs.torques
    beyond = settings.couplings > 0
    for j in range(len(limit) if has_torque_rows(chains) else 0):
        beyond = beyond or abs(torques[j]) > limit[j]
    if beyond:
        # The dual has no closed form for torque rows: the interior-point method takes them.
        code, used = within_torques(tick, scale, hand, chains)
        steps += used
        _write_out(inputs, outputs, room.x, room.widths, scale, hand)
        for j in range(len(limit)):
            if code == CONVERGED and abs(torques[j]) > limit[j] * (1.0 + 1e-7):
                code = INFEASIBLE
    off, _ = judge(room.balance, room.cones, room.x)
    return code, steps, off * scale
