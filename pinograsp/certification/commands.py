"""Grasps as they are commanded: what comes of the postures that a hand's motors are told."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.certification.pressing import Squeezes
from pinograsp.certification.setup import CertifySetup
from pinograsp.certification.touches import PostureTouches
from pinograsp.checks import array_of, brief, placements_of, read_only
from pinograsp.contacts.commanded import follow_commands
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array, BoolArray

_TURNS = 0.1  # of the largest share of motions in depths: smaller ones are no way to press


@dataclass(frozen=True, slots=True, eq=False)
class Commands:
    """The commands of a hand's motors, one posture after the other: usually before the grasp, the grasp, and the one
    that squeezes.

    Attributes:
        q: s postures for each of N grasps (N, s, n) [rad or m]; the joints start in the first.
        roots: oMh of the hand's root for each posture (N, s, 4, 4).

    Raises:
        InvalidInput: shapes that do not match, or fewer than two postures.
    """

    q: Array
    roots: Array

    __repr__ = brief()

    def __init__(self, q: ArrayLike, roots: ArrayLike):
        found = array_of("commands", q, (None, None, None))
        count, stages = found.shape[:2]
        if stages < 2:
            raise InvalidInput(f"commands: expected two postures or more, one after the other, got {stages}")
        given = array_of("roots of commands", roots, (count, stages, 4, 4)).reshape(-1, 4, 4)
        placed = placements_of("roots of commands", given, count * stages)
        object.__setattr__(self, "q", read_only(found))
        object.__setattr__(self, "roots", read_only(placed.reshape(count, stages, 4, 4)))

    def __len__(self) -> int:
        return len(self.q)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Commanded:
    """What comes of the commands of N grasps, as in :class:`~pinograsp.certification.Certificates`."""

    commanded: BoolArray
    held_as_commanded: BoolArray
    moved: Array
    turned: Array
    pressed: Array

    @classmethod
    def none(cls, setup: CertifySetup, count: int) -> Commanded:
        """Of grasps without commands."""
        return cls(
            commanded=np.zeros(count, dtype=bool),
            held_as_commanded=np.zeros(count, dtype=bool),
            moved=np.full(count, np.nan),
            turned=np.full(count, np.nan),
            pressed=np.zeros((count, len(setup.scene.links))),
        )


def try_commands(setup: CertifySetup, q: Array, roots: Array) -> Commanded:
    """What comes of commands, as of :class:`Commands`, object and loads as in the set-up."""
    scene = setup.scene
    found = follow_commands(scene, setup.motors, q, roots, setup.loading, threads=setup.options.threads)
    pressed = np.zeros((len(q), len(scene.links)))
    np.add.at(pressed.T, scene.link_of, found.pressed.T)
    return Commanded(
        commanded=np.ones(len(q), dtype=bool),
        held_as_commanded=np.asarray(found.kept, dtype=bool),
        moved=found.moved,
        turned=found.turned,
        pressed=pressed,
    )


def try_torques(setup: CertifySetup, touches: PostureTouches, squeezes: Squeezes, which: BoolArray) -> Commanded:
    """What comes of position references q + tau / kp for the torques of certified forces, of ``which`` grasps (N,).

    Here q is where the links have pressed in. The motors' efforts are those that come nearest to the torques: joints
    along a tendon give way until these fit.
    """
    q, roots, torques = touches.q, touches.roots, squeezes.torques
    motors, all_of_them, rows = setup.motors, Commanded.none(setup, len(q)), np.flatnonzero(which)
    if not len(rows):
        return all_of_them
    moves = touches.motions(setup)[0][rows]
    # Corners of an area share the stiffness of their link's contact.
    links = touches.links[rows]
    alike = (links[:, :, None] == links[:, None]) & touches.used[rows][:, None]
    depths = np.einsum("nkc,nc->nk", alike, squeezes.local[rows, :, 3]) / setup.loading.stiffness
    pressed = np.einsum("njk,nk->nj", np.linalg.pinv(moves, rcond=_TURNS), depths)
    back = np.linalg.pinv(motors.arms)
    ahead = (torques[rows] @ back / motors.stiffness) @ back.T
    stages = np.stack([q[rows], q[rows] + pressed + ahead], axis=1)
    some = try_commands(setup, stages, np.repeat(roots[rows, None], 2, axis=1))
    for field in fields(Commanded):
        getattr(all_of_them, field.name)[rows] = getattr(some, field.name)
    return all_of_them
