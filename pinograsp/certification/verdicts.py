"""The last stage: which grasps hold, and why the others do not."""

from __future__ import annotations

import time

import numpy as np

from pinograsp.certification.commands import Commanded, try_commands, try_torques
from pinograsp.certification.pressing import Squeezes, find_squeezes
from pinograsp.certification.record import Certificates
from pinograsp.certification.setup import CertifySetup
from pinograsp.certification.touches import PostureTouches, find_touches, leave
from pinograsp.checks import read_only
from pinograsp.errors import Status
from pinograsp.hands.efforts import exceed_ways, spring_torques
from pinograsp.motion.producible import HARDLY, JOINTS, SHIFTS
from pinograsp.motion.torques import DRY_FRICTION
from pinograsp.spatial import Array, BoolArray, IntArray

_NEAR = 1e-9  # of shares: rounding
_UNMADE = 0.2  # share of the depths that the hand's joints cannot choose: more is not what it makes


def certify_block(setup: CertifySetup, q: Array, roots: Array, commands: tuple[Array, Array] | None) -> Certificates:
    """The certificates of postures (N, n) with the hand's root at ``roots`` (N, 4, 4); ``commands``: q and roots, as of
    :class:`~pinograsp.certification.Commands`.
    """
    started = time.perf_counter()
    touches = find_touches(setup, q, roots)
    elapsed = {"contacts": time.perf_counter() - started}
    squeezes, times = find_squeezes(setup, touches)
    unproducible = _unproducible(setup, touches, squeezes)
    producible = (unproducible <= _UNMADE) & ~_beyond_drives(setup, touches, squeezes) & squeezes.weight_held
    between = time.perf_counter()
    if commands is not None:
        commanded = try_commands(setup, *commands)
    elif setup.options.commanded:
        commanded = try_torques(setup, touches, squeezes, squeezes.weight_held)
    else:
        commanded = Commanded.none(setup, len(q))
    codes = _judge(setup, touches, squeezes, producible)
    settled = _settle(setup, touches, squeezes, commanded, codes)
    codes[settled], producible[settled] = Status.HELD.code, True
    times["commands"] = time.perf_counter() - between
    forces = np.einsum("nkxc,nkc->nkx", touches.rotations, squeezes.local[..., [0, 1, 3]])
    return Certificates(
        hand=setup.hand,
        object=setup.body,
        conditions=setup.conditions,
        q=read_only(touches.q),
        roots=read_only(roots),
        reason=read_only(codes),
        counts=read_only(touches.counts),
        links=read_only(touches.links),
        link_names=tuple(setup.scene.links),
        points_o=read_only(touches.points_o),
        normals_o=read_only(touches.rotations[..., 2] * touches.used[..., None]),
        gaps=read_only(touches.gaps),
        forces_o=read_only(forces),
        torsion=read_only(squeezes.local[..., 2]),
        torques=read_only(squeezes.torques),
        reserve=read_only(squeezes.reserve),
        weakest=read_only(squeezes.weakest),
        least_mu=read_only(squeezes.least_mu),
        antipodal_mu=read_only(touches.antipodal_mu),
        largest_load=read_only(squeezes.largest_load),
        effort=read_only(squeezes.effort),
        producible=read_only(producible & (squeezes.effort <= 1 + _NEAR)),
        unproducible=read_only(unproducible),
        residual=read_only(squeezes.residual),
        depth=read_only(touches.depth),
        excess=read_only(touches.excess),
        commanded=read_only(commanded.commanded),
        held_as_commanded=read_only(commanded.held_as_commanded),
        moved=read_only(commanded.moved),
        turned=read_only(commanded.turned),
        pressed=read_only(commanded.pressed),
        elapsed={**elapsed, **times},
    )


def _judge(setup: CertifySetup, touches: PostureTouches, squeezes: Squeezes, producible: BoolArray) -> IntArray:
    """The code of each grasp's status (N,), of those that apply the last one here."""
    dropped = ~squeezes.weight_held
    codes = np.full(len(touches.q), Status.HELD.code)
    for status, where in (
        (Status.DRIVES, ~producible & setup.options.drives),
        (Status.TORQUE, squeezes.effort > 1 + _NEAR),
        (Status.RESERVE, ~squeezes.reserve_held),
        (Status.FRICTION, dropped & np.isfinite(squeezes.least_mu)),
        (Status.NO_FORCES, dropped & ~np.isfinite(squeezes.least_mu)),
        (Status.UNDECIDED, dropped & (squeezes.status != Status.INFEASIBLE)),
        (Status.NO_CONTACT, touches.touched < 2),
        (Status.SELF_COLLISION, touches.collision >= 0),
        (Status.PENETRATES, touches.depth > 0),
        (Status.GEOMETRY_FAILED, touches.failed),
        (Status.JOINT_LIMIT, touches.beyond),
    ):
        codes[where] = status.code
    return codes


def _settle(
    setup: CertifySetup, touches: PostureTouches, squeezes: Squeezes, commanded: Commanded, codes: IntArray
) -> BoolArray:
    """Which grasps (N,) of those that drives of several joints do not hold at their posture these hold where the links
    give way along them, until the torques are in the drives' ratio: as commanded, or with their forces' own torques.
    """
    adaptive: BoolArray = (codes == Status.DRIVES.code) & bool(len(setup.ratios))
    held = adaptive & commanded.held_as_commanded
    left = adaptive & ~held
    if setup.options.commanded:  # these were tried
        left &= ~commanded.commanded
    tried = try_torques(setup, touches, squeezes, left)
    settled: BoolArray = held | tried.held_as_commanded
    return settled


def _unproducible(setup: CertifySetup, touches: PostureTouches, squeezes: Squeezes) -> Array:
    """Share of the depths (N,) that neither the joints nor a shift of the object can choose.

    Of the depths d it is |(1 + B B^T)^-1 d| / |d|, where B has the motions of :func:`pressing_together
    <pinograsp.motion.pressing_together>` as columns, scaled likewise: what takes large motions does not count.
    """
    law = setup.conditions.compliance
    depths = law.depth(np.maximum(squeezes.local[..., 3], 0.0))
    moves, shifts = touches.motions(setup)
    sizes = np.linalg.norm(moves, axis=1, keepdims=True)
    moves = moves / (JOINTS * np.where(sizes > HARDLY, sizes, np.inf))
    left = leave(np.concatenate([moves, shifts / SHIFTS], axis=2), depths)
    size = np.linalg.norm(depths, axis=1)
    share: Array = np.where(size > 0, np.linalg.norm(left, axis=1) / np.where(size > 0, size, 1.0), 0.0)
    return share


def _beyond_drives(setup: CertifySetup, touches: PostureTouches, squeezes: Squeezes) -> BoolArray:
    """Which grasps (N,) need torques that drives of several joints or of one direction, or springs, do not make."""
    hand, q = setup.hand, touches.q
    wrong_way = np.asarray(exceed_ways(hand, q, squeezes.torques).any(axis=1), dtype=bool)
    if not len(setup.ratios):
        return wrong_way
    off = np.abs((squeezes.torques - spring_torques(hand, q)) @ setup.ratios.T)
    arms = np.linalg.norm(np.einsum("pj,nkxj->npkx", setup.ratios, touches.jacobians[:, :, :3]), axis=3)
    borne = DRY_FRICTION * np.einsum("npk,nk->np", arms, squeezes.local[..., 3])
    return np.asarray(wrong_way | (off > borne + 1e-9).any(axis=1), dtype=bool)
