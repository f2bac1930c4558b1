"""The second stage: the forces of postures that touch, what they withstand, and the torques that make them."""

from __future__ import annotations

import time
from dataclasses import dataclass, fields, replace

import numpy as np
from numpy.typing import NDArray

from pinograsp.certification.setup import CertifySetup
from pinograsp.certification.touches import PostureTouches
from pinograsp.contacts import Friction
from pinograsp.contacts.contact_set import bare_contacts
from pinograsp.contacts.friction import CONE, SOFT
from pinograsp.errors import Status
from pinograsp.forces.bulk.elastic import Grips, Reactions, find_efforts, find_multiples
from pinograsp.forces.bulk.squeeze import (
    Forces,
    Holding,
    find_hopeless,
    find_least_mu,
    hold_weight,
    press,
    squeeze,
    squeeze_partly,
)
from pinograsp.forces.robust.reserve_search import least_squeeze
from pinograsp.spatial import Array, BoolArray, IntArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Squeezes:
    """Forces of N grasps, up to k contacts each; other arrays as in :class:`~pinograsp.certification.Certificates`.

    Attributes:
        local: in contact axes: x, y, torsion, normal (N, k, 4) [N, N m].
        status: of the forces under the weight (N,), a :class:`~pinograsp.errors.Status`.
        weight_held: which hold the weight (N,).
        reserve_held: which hold all that the reserve adds, too (N,).
    """

    local: Array
    status: NDArray[np.object_]
    weight_held: BoolArray
    reserve_held: BoolArray
    residual: Array
    reserve: Array
    weakest: Array
    torques: Array
    effort: Array
    largest_load: Array
    least_mu: Array


def find_squeezes(setup: CertifySetup, touches: PostureTouches) -> tuple[Squeezes, dict[str, float]]:
    """The squeeze of each grasp that touches with two links or more, and computing times [s]."""
    given, count = setup.conditions.friction, len(touches.q)
    full = Squeezes(
        local=np.zeros((*touches.used.shape, 4)),
        status=np.full(count, Status.INFEASIBLE, dtype=object),
        weight_held=np.zeros(count, dtype=bool),
        reserve_held=np.zeros(count, dtype=bool),
        residual=np.zeros(count),
        reserve=np.zeros(count),
        weakest=np.zeros((count, 6)),
        torques=np.zeros((count, setup.hand.n)),
        effort=np.zeros(count),
        largest_load=np.zeros(count),
        least_mu=np.full(count, np.inf),
    )
    elapsed = {"forces": 0.0, "friction": 0.0}
    touching, few = touches.touched >= 2, touches.touched <= 2
    groups = [(given, touching)] if given is not None else [(CONE, touching & ~few), (SOFT, touching & few)]
    for friction, which in groups:
        rows = np.flatnonzero(which)
        if len(rows):
            some, times = _find(setup, touches, rows, replace(setup.holding, friction=friction))
            for field in fields(Squeezes):
                getattr(full, field.name)[rows] = getattr(some, field.name)
            elapsed = {stage: spent + times[stage] for stage, spent in elapsed.items()}
    return full, elapsed


def _find(
    setup: CertifySetup, touches: PostureTouches, rows: IntArray, holding: Holding
) -> tuple[Squeezes, dict[str, float]]:
    """Squeezes of some of the grasps, all with one model of friction."""
    started, options = time.perf_counter(), setup.options
    used = touches.used[rows]
    grips = Grips(
        points=(touches.points_o[rows] - setup.body.com_o) * used[..., None],
        rotations=touches.rotations[rows],
        counts=touches.counts[rows],
        least=np.minimum(touches.closing[rows], holding.cap),
    )
    plain = hold_weight(grips, holding, options.threads)
    first, ways = squeeze(grips, holding, setup.reserve, setup.wrenches, options.threads)
    found = first.found
    forces = np.where(found[:, None, None], first.local, plain.local)
    weak = np.flatnonzero(plain.found & ~found & ways[0].borne.all(axis=1))
    proven = np.zeros(len(rows), dtype=bool)
    if options.exact and len(weak):
        changes = ways[0].of(weak).normal
        hopeless = find_hopeless(grips.of(weak), holding, setup.reserve, setup.wrenches, changes, options.threads)
        if len(asked := weak[~hopeless]):
            better = _squeeze_exactly(setup, touches, rows[asked], grips.of(asked), holding)
            forces[asked] = np.where(better.found[:, None, None], better.local, forces[asked])
            proven[asked] = better.found
            weak = weak[~proven[weak]]
    if len(weak):
        some = squeeze_partly(grips.of(weak), holding, setup.reserve, setup.wrenches, options.threads)
        forces[weak] = np.where(some.found[:, None, None], some.local, forces[weak])
    pressed = found | plain.found
    multiples = np.maximum(
        *(find_multiples(forces, way, holding.friction, holding.mu, threads=options.threads) for way in ways)
    )
    reserve, weakest = _margins(setup, multiples, pressed, proven)
    torques, effort, largest_load = _torques(setup, touches, rows, grips, forces, plain, ways[0])
    columns = _components(holding.friction)
    local = np.zeros((*used.shape, 4))
    local[..., columns] = forces
    between = time.perf_counter()
    least_mu = find_least_mu(grips, holding, options.threads)
    squeezes = Squeezes(
        local=local,
        status=np.where(pressed, Status.OK, plain.status),
        weight_held=pressed,
        reserve_held=found | proven,
        residual=np.where(found, first.residual, plain.residual),
        reserve=reserve,
        weakest=weakest,
        torques=torques,
        effort=effort,
        largest_load=largest_load,
        least_mu=least_mu,
    )
    return squeezes, {"forces": between - started, "friction": time.perf_counter() - between}


def _components(friction: Friction) -> list[int]:
    """Of x, y, torsion, normal those that a model of friction has."""
    return [0, 1, 2, 3] if friction.d == 4 else [0, 1, 3]


def _squeeze_exactly(
    setup: CertifySetup, touches: PostureTouches, rows: IntArray, grips: Grips, holding: Holding
) -> Forces:
    """The least squeezes that withstand the reserve, where the quick way finds none: a program each."""
    conditions = replace(setup.conditions, friction=holding.friction)
    normal = np.zeros(grips.used.shape)
    for row, (i, count) in enumerate(zip(rows.tolist(), grips.counts.tolist())):
        contacts = bare_contacts(touches.points_o[i, :count], touches.rotations[i, :count], setup.body.com_o)
        problem = conditions.problem(setup.body, contacts)
        problem = replace(problem, min_normal_force=touches.closing[i, :count])
        least = least_squeeze(problem, setup.reserve)
        normal[row, :count] = 0.0 if least is None else least
    forces = press(grips, holding.kept_back(setup.reserve), normal, setup.options.threads)
    status = np.where((normal > 0).any(axis=1), forces.status, Status.INFEASIBLE)
    return Forces(status=status, local=forces.local, residual=forces.residual)


def _margins(setup: CertifySetup, multiples: Array, pressed: BoolArray, proven: BoolArray) -> tuple[Array, Array]:
    """Multiples of the reserve that are borne (N,), and the wrench that is borne least (N, 6)."""
    if not multiples.shape[1]:
        return np.where(pressed, np.inf, 0.0), np.zeros((len(pressed), 6))
    # At least what a program has proven.
    borne = np.where(pressed, np.maximum(1.0 * proven, multiples.min(axis=1)), 1.0 * proven)
    return borne, np.where(pressed[:, None], setup.wrenches[multiples.argmin(axis=1)], 0.0)


def _torques(
    setup: CertifySetup,
    touches: PostureTouches,
    rows: IntArray,
    grips: Grips,
    forces: Array,
    plain: Forces,
    reacted: Reactions,
) -> tuple[Array, Array, Array]:
    """Holding torques (N, n), their largest share of a limit under all loads (N,), and the load that the limits allow
    (N,) [N].
    """
    bias, limit = touches.gravity_torques[rows], setup.limit

    def torques(local: Array, bias: Array) -> tuple[Array, Array]:
        return find_efforts(
            touches.jacobians, grips.rotations, bias, local, reacted, places=rows, threads=setup.options.threads
        )

    tau, most = torques(forces, bias)
    usable = limit * (1.0 - setup.reserve.torque)
    effort = (most / usable)[:, np.isfinite(usable)].max(axis=1, initial=0.0)
    alone, _ = torques(plain.local, np.zeros_like(bias))
    room = np.where(alone > 0, limit - bias, limit + bias)
    with np.errstate(divide="ignore", invalid="ignore"):
        multiples = np.where(np.abs(alone) > 1e-12, np.maximum(room, 0.0) / np.abs(alone), np.inf).min(axis=1)
        pressed = plain.local[..., -1].max(axis=1)
        multiples = np.minimum(multiples, np.where(pressed > 0, setup.holding.cap / pressed, np.inf))
    largest = np.full(len(rows), np.inf)  # of what weighs nothing, too
    np.multiply(multiples, setup.holding.size, out=largest, where=np.isfinite(multiples))
    return tau, effort, np.where(plain.found, largest, 0.0)
