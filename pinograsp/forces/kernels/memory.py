"""The memory of :func:`pinograsp.forces.kernels.tick.online`: few arrays, since passing one from Python costs a tenth
of a microsecond.

The layout is known here alone.
"""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import COUNTED, FLAGS
from pinograsp.forces.kernels.layouts import (
    Balance,
    Cones,
    Hand,
    Quadratic,
    Tick,
    TickInputs,
    TickOutputs,
    TickRoom,
    TickSettings,
    TorqueRows,
)
from pinograsp.forces.kernels.newton import newton_scratch
from pinograsp.forces.kernels.packing import part
from pinograsp.spatial import Array, IntArray


def tick_in(memory: Array) -> Tick:
    """The parts of an array of :func:`tick_memory`, which begins with its settings.

    Long, since the whole layout stands here.
    """
    s = TickSettings(
        int(memory[0]),
        int(memory[1]),
        int(memory[2]),
        int(memory[3]),
        int(memory[4]),
        memory[5],
        memory[6],
        memory[7],
        int(memory[8]),
        memory[9],
        int(memory[10]),
    )
    k, d, n, m, p = s.contacts, s.components, s.joints, s.rows, s.couplings
    i = 11
    com, rate, wrench = memory[i : i + 3], memory[i + 3 : i + 4], memory[i + 4 : i + 10]
    i += 10
    points, rotations, mu = memory[i : i + 3 * k], memory[i + 3 * k : i + 12 * k], memory[i + 12 * k : i + 13 * k]
    i += 13 * k
    least, largest = memory[i : i + k], memory[i + k : i + 2 * k]
    share, target = memory[i + 2 * k : i + 3 * k], memory[i + 3 * k : i + 4 * k]
    i += 4 * k
    torque_limit, torques = memory[i : i + n], memory[i + n : i + 2 * n]
    i += 2 * n
    couplings, coupled, borne = memory[i : i + p * n], memory[i + p * n :][:p], memory[i + p * n + p :][:1]
    i += p * n + p + 1
    forces, moments, unbalanced = memory[i : i + 3 * k], memory[i + 3 * k : i + 4 * k], memory[i + 4 * k :][:6]
    i += 4 * k + 6
    multipliers, b, y, radii = memory[i : i + m], memory[i + 6 :][:m], memory[i + 12 :][:m], memory[i + 18 :][: d - 1]
    i += 21
    lo, hi, slip = memory[i : i + k], memory[i + k : i + 2 * k], memory[i + 2 * k : i + 3 * k]
    i += 3 * k
    widths, w, q, x = (
        memory[i:][: d * k],
        memory[i + d * k :][: d * k],
        memory[i + 2 * d * k :][: d * k],
        memory[i + 3 * d * k :][: d * k],
    )
    i += 4 * d * k
    A, work = memory[i : i + m * d * k], memory[i + m * d * k :]
    return Tick(
        s,
        TickInputs(
            com,
            rate,
            wrench,
            points.reshape((k, 3)),
            rotations.reshape((k, 3, 3)),
            mu,
            least,
            largest,
            share,
            target,
            torque_limit,
            couplings.reshape((p, n)),
            coupled,
            borne,
        ),
        TickOutputs(forces.reshape((k, 3)), moments, unbalanced, torques),
        TickRoom(
            multipliers,
            Balance(A.reshape((m, d * k)), b, 0.0),
            Quadratic(w.reshape((d, k)), q.reshape((d, k))),
            Cones(lo, hi, radii, s.n_round),
            x.reshape((d, k)),
            y,
            widths.reshape((d, k)),
            slip,
            work,
        ),
    )


compiled_tick_in = jit(**FLAGS)(tick_in)


def tick_memory(settings: TickSettings) -> tuple[Array, Tick]:
    """Memory for a loop, and its parts, which are views of it."""
    k, d, n, m, p = settings.contacts, settings.components, settings.joints, settings.rows, settings.couplings
    before = 11 + 10 + 17 * k + 2 * n + p * n + p + 1 + 4 * k + 6 + 21 + 3 * k
    memory = np.zeros(before + (4 + m) * d * k + newton_scratch(d, k))
    memory[:11] = settings
    return memory, tick_in(memory)


# Chains: numbers of links, torque rows (-1: torques have no limits), rows that several contacts enter, and the largest
# number that one contact has alone; the links; the arrays of the torque rows.


def pack_chains(links: IntArray, rows: TorqueRows | None) -> IntArray:
    """Links (p, 3), see :class:`~pinograsp.forces.kernels.layouts.Hand`, and the torque rows."""
    if rows is None:
        return np.array([len(links), -1, 0, 0, *links.ravel()], dtype=np.int64)
    sizes = len(links), rows.touched.shape[1], rows.shared, len(rows.own)
    parts = sizes, links, rows.row_of, rows.own, rows.touched, rows.counts, rows.used, rows.pair_of
    return np.concatenate([np.asarray(one, dtype=np.int64).ravel() for one in parts])


@jit(**FLAGS)
def hand_in(chains: IntArray, jacobian: Array, gravity: Array) -> Hand:
    """The hand with its links."""
    return Hand(jacobian, gravity, chains[4 : 4 + 3 * chains[0]].reshape((chains[0], 3)))


@jit(**FLAGS)
def has_torque_rows(chains: IntArray) -> bool:
    """Whether torques have limits."""
    limited: bool = chains[1] >= 0
    return limited


@jit(**COUNTED)
def torque_rows_in(chains: IntArray, settings: TickSettings) -> TorqueRows:
    """The torque rows, where there are some."""
    k, d, limits = settings.contacts, settings.components, 2 * (settings.components - 1 - settings.n_round) + 1
    all_rows, alone = chains[1], chains[3]
    row_of, i = part(chains, 4 + 3 * chains[0], (settings.joints,))
    own, i = part(chains, i, (alone, k))
    touched, i = part(chains, i, (k, all_rows))
    counts, i = part(chains, i, (k, 2))
    used, i = part(chains, i, (limits + alone, d))
    pair_of, i = part(chains, i, (settings.couplings, 2))
    return TorqueRows(chains[2], row_of, own, touched, counts, used, pair_of)
