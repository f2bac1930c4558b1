"""Hands that close on an object which is not where it was planned: what comes of it, many places at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinograsp import core
from pinograsp.checks import brief
from pinograsp.contacts.bulk import BulkScene
from pinograsp.core.threads import share_out
from pinograsp.hands.servos import SETTLING
from pinograsp.plan.simulation import MOVED, TURNED
from pinograsp.spatial import Array, BoolArray

_OVERLAP = 5e-4  # [m] of the open hand and the object: more is lost, since the hand could not come there
_CREPT = 2.5e-3  # [m] in the last half of the hold: more is not at rest
_AT_ONCE = 4  # places of a thread
_ROTORS = 1e-2, 1e-5  # [kg], [kg m^2] inertia at joints that slide, and that turn: implicit steps need no more


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosingCommands:
    """What the joints (n) of a closing hand are told, a row per step, of which the last stays.

    Attributes:
        q, dq, effort: positions, rates and feed-forward efforts (m, n) [rad, rad/s, N m; m, m/s, N where joints slide].
        step: [s].
        soft, stiff: gains of the servos while the hand closes, and afterwards (n,) [N m/rad or N/m].
        limit: of the efforts (n,) [N m or N]; infinity: none.
        complete: the step at which the grasp is complete: what stands is lifted.
        free: the step at which what was fixed is let go.
        settled: the step from which on the joints are held where they are.
        steps: in all.
    """

    q: Array
    dq: Array
    effort: Array
    step: float
    soft: Array
    stiff: Array
    limit: Array
    complete: int
    free: int
    settled: int
    steps: int

    __repr__ = brief("step", "steps")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pressing:
    """How hand, object and table press.

    Attributes:
        root: oMh of the hand (4, 4).
        stiffness: of each part of the hand against the object (p,) [N/m].
        mu: friction coefficient, of the table as well [-].
        torsion: largest moment about a normal per newton [m].
        gravity_o: (3,) [m/s^2].
        on_table: whether the object stands on a table until the grasp is complete; else it is fixed until it is let go.
    """

    root: Array
    stiffness: Array
    mu: float
    torsion: float
    gravity_o: Array
    on_table: bool

    __repr__ = brief("mu", "torsion", "on_table")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MisplacedOutcomes:
    """What came of N places.

    Attributes:
        overlap: of the open hand with the object (N,) [m].
        moved: of the object's centre of mass after the grasp had settled (N,) [m].
        turned: likewise (N,) [rad].
        crept: in the last half of the hold (N,) [m].
        pushed: before the grasp had settled (N,) [m].
    """

    overlap: Array
    moved: Array
    turned: Array
    crept: Array
    pushed: Array

    __repr__ = brief()

    @property
    def kept(self) -> BoolArray:
        """Whether the hand holds it (N,); a hand that is in the object's way does not."""
        kept: BoolArray = (self.overlap < _OVERLAP) & (self.moved < MOVED) & (self.turned < np.radians(TURNED))
        return kept & (self.crept < _CREPT)


def close_misplaced(
    scene: BulkScene, commands: ClosingCommands, pressing: Pressing, places: Array, threads: int | None = 1
) -> MisplacedOutcomes:
    """Close the hand of a scene, and hold, with the object moved by ``places`` (N, 4, 4) of the world.

    A quasi-static computation in steps: servos against contacts that are springs with friction, which push the object,
    its weight and its inertia. ``threads`` as for :meth:`BulkScene.contacts`.

    Raises:
        ExtraMissing: the compiled core is not installed.
    """
    body, slides = scene.body, scene.hand.slides
    turn = body.shape_pose[:3, :3]
    damping = SETTLING * commands.stiff
    soft_damping = damping * np.sqrt(commands.soft / np.maximum(commands.stiff, 1e-12))
    gains = [commands.soft, soft_damping, commands.stiff, damping, np.where(slides, *_ROTORS), commands.limit]
    given = core.load().ClosingGiven(
        commands=np.array([commands.q, commands.dq, commands.effort]),
        gains=np.array(gains),
        object=np.concatenate([(turn @ body.inertia_s @ turn.T).ravel(), body.com_o, pressing.gravity_o]),
        stiffness=np.ascontiguousarray(pressing.stiffness),
        root=np.array(pressing.root),
        steps=np.array(
            [commands.steps, 0 if pressing.on_table else commands.free, commands.complete, commands.settled]
        ),
        step=commands.step,
        mass=body.mass,
        mu=pressing.mu,
        torsion=pressing.torsion,
        on_table=pressing.on_table,
    )
    starts = range(0, len(places), _AT_ONCE)
    found = np.zeros((len(places), 5))

    def close(start: int) -> None:
        some = slice(start, start + _AT_ONCE)
        scene.compiled.close(given, np.ascontiguousarray(places[some]), found[some])

    share_out(close, starts, threads)
    overlap, moved, turned, crept, pushed = found.T
    return MisplacedOutcomes(overlap=overlap, moved=moved, turned=turned, crept=crept, pushed=pushed)
