"""Objects in hands whose motors are told where to go: what comes of many such grasps, under loads."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from pinograsp import core
from pinograsp.checks import brief
from pinograsp.contacts.bulk import BulkScene
from pinograsp.core.threads import share_out
from pinograsp.hands import HandModel, servo_gains
from pinograsp.hands.servos import SETTLING
from pinograsp.spatial import Array

STAGE = 0.4  # [s] from one posture to the next
_STEP, _LOADED = 0.05, 0.1  # [s] of the closing, and under a load
_SETTLING, _HOLD = 0.1, 2.0  # [s] after the last posture; at most under each load
_ROTORS = 1e-2, 2e-4  # [kg], [kg m^2] inertia at joints that slide, and that turn
_AT_ONCE = 8  # grasps of a thread


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motors:
    """Position servos of a hand's m motors.

    Attributes:
        arms: torque at each joint per unit of effort (m, n).
        stiffness: effort per unit of a motor's coordinate, arms @ q (m,).
        damping: effort per unit of its rate (m,).
        limit: of the effort (m,); infinity: none.
    """

    arms: Array
    stiffness: Array
    damping: Array
    limit: Array

    __repr__ = brief()

    @classmethod
    def of(cls, hand: HandModel) -> Motors:
        """The drives of a hand with their gains, where these are known, else the assumed ones; a motor at each joint of
        a hand without drives.
        """
        gains = servo_gains(hand)
        if not hand.drives:
            return cls(arms=np.eye(hand.n), stiffness=gains, damping=SETTLING * gains, limit=hand.effort_or_infinity)
        arms = np.array(hand.transmission)
        # The gain that is assumed at the joint that moves most.
        assumed = gains[np.abs(arms).argmax(axis=1)] / (arms**2).max(axis=1)
        stiffness = np.array([one.stiffness or guess for one, guess in zip(hand.drives, assumed)])
        damping = np.array(
            [SETTLING * own if one.damping is None else one.damping for one, own in zip(hand.drives, stiffness)]
        )
        return cls(arms=arms, stiffness=stiffness, damping=damping, limit=np.array([d.limit for d in hand.drives]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Loading:
    """What pulls at an object once the hand has squeezed it, and what it is held by.

    Attributes:
        loads: wrenches about its centre of mass, world (l, 6) [N, N m], one after the other, each from the squeeze on.
        distance: how far it may go [m].
        angle: how far it may turn [rad].
        stiffness: of a link's contact [N/m].
        mu: friction coefficient [-].
        torsion: largest moment about a normal per newton [m].
    """

    loads: Array
    distance: float
    angle: float
    stiffness: float
    mu: float
    torsion: float

    __repr__ = brief("distance", "angle", "mu")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CommandedOutcomes:
    """What came of N grasps.

    Attributes:
        moved: how far the object went under any load, from where it was before the hand closed (N,) [m].
        turned: likewise (N,) [rad].
        kept: which stayed within the bounds under all loads (N,).
        pressed: normal force of each part of the hand after the squeeze, before any load (N, p) [N].
    """

    moved: Array
    turned: Array
    kept: Array
    pressed: Array

    __repr__ = brief()


def follow_commands(
    scene: BulkScene, motors: Motors, q: Array, roots: Array, loading: Loading, threads: int | None = 1
) -> CommandedOutcomes:
    """Tell the motors of a hand one posture after the other, and pull at the object that is then between its links.

    A quasi-static computation in implicit steps: servos with their limits against contacts that are springs with
    friction, joints that give way along tendons of several joints, and stop at their limits. The object is free, and
    has no weight until it is loaded; the hand's own weight is taken as made up for.

    Args:
        scene: the hand and the object.
        motors: of the hand.
        q: s postures (N, s, n) [rad or m], of which the first is where the joints start.
        roots: oMh of the hand's root with each (N, s, 4, 4).
        loading: of the object.
        threads: as for :meth:`BulkScene.contacts`.

    Raises:
        ExtraMissing: the compiled core is not installed.
    """
    hand, body = scene.hand, scene.body
    turn = body.shape_pose[:3, :3]
    steps = round(STAGE / _STEP)
    share = np.arange(1, steps + 1)[:, None] / steps
    stages = q.shape[1] - 1
    complete = stages * steps + round(_SETTLING / _STEP)
    given = core.load().CommandGiven(
        arms=np.ascontiguousarray(motors.arms),
        gains=np.array([motors.stiffness, motors.damping, motors.limit]),
        joints=np.array([np.where(hand.slides, *_ROTORS), hand.model.damping, hand.lower, hand.upper]),
        object=np.concatenate([(turn @ body.inertia_s @ turn.T).ravel(), body.com_o, np.zeros(3)]),
        stiffness=np.full(len(scene.parts), loading.stiffness),
        loads=np.ascontiguousarray(loading.loads),
        bounds=np.array([loading.distance, loading.angle]),
        steps=np.array([complete, complete + round(_HOLD / _LOADED)]),
        step=_STEP,
        loaded=_LOADED,
        mass=body.mass,
        mu=loading.mu,
        torsion=loading.torsion,
    )
    farthest = np.zeros((len(q), len(loading.loads), 2))
    pressed = np.zeros((len(q), len(scene.parts)))

    def follow(start: int) -> None:
        some = slice(start, start + _AT_ONCE)
        told = np.einsum("mj,nsj->nsm", motors.arms, q[some])
        targets = np.concatenate([told[:, :1], *(_between(told, i, share) for i in range(stages))], axis=1)
        way = np.concatenate([roots[some, :1], *(_move(roots[some], i, share) for i in range(stages))], axis=1)
        scene.compiled.command(given, targets, np.ascontiguousarray(q[some, 0]), way, farthest[some], pressed[some])

    share_out(follow, range(0, len(q), _AT_ONCE), threads)
    # Loads after one that lost the object were not tried.
    moved, turned = np.nanmax(farthest, axis=1, initial=0.0).T
    kept = ~np.isnan(farthest).any(axis=(1, 2)) & (moved < loading.distance) & (turned < loading.angle)
    return CommandedOutcomes(moved=moved, turned=turned, kept=kept, pressed=pressed)


def _between(values: Array, stage: int, share: Array) -> Array:
    """Steps from a stage's values (N, s, m) to those of the next (N, steps, m)."""
    one, other = values[:, stage, None], values[:, stage + 1, None]
    return np.asarray(one + share * (other - one), dtype=float)


def _move(roots: Array, stage: int, share: Array) -> Array:
    """Steps from a stage's frames (N, s, 4, 4) to those of the next (N, steps, 4, 4)."""
    one, other = roots[:, stage], roots[:, stage + 1]
    way = np.tile(one[:, None], (1, len(share), 1, 1))
    turn = Rotation.from_matrix(np.swapaxes(one[:, :3, :3], 1, 2) @ other[:, :3, :3]).as_rotvec()
    turns = Rotation.from_rotvec((turn[:, None] * share).reshape(-1, 3)).as_matrix().reshape(*way.shape[:2], 3, 3)
    way[..., :3, :3] = one[:, None, :3, :3] @ turns
    way[..., :3, 3] = _between(roots[..., :3, 3], stage, share)
    return way
