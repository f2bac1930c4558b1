"""How a grasp comes to rest as the object is let go: friction that built up while the hand pressed lets it shift.

The object is held until t_F. While the links press, they also slide along its surface, and friction builds up as far as
the cone allows. As the support fades, the object moves until contacts and load are in balance; that changes the depths,
and with them the normal forces. Friction is a spring that slips (Cundall and Strack, Geotechnique 29(1), 1979), about
the normals of soft fingers, too; normal forces are those at rest (Eq. 4).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.forces import ForceProblem
from pinograsp.spatial import Array

# [N/m] stiffness of a contact along the surface: above that along the normal, at the depths of a few newtons.
TANGENTIAL = 2e4
_PARTS = 4  # steps of the sliding between two known depths
_STAGES = 4  # of the support as it fades
_ROUNDS, _STEPS, _HALVINGS = 20, 30, 25  # in each: cones of other sizes, Newton steps to the least energy, and halvings
_FULL_STEPS, _LEFT = 6, 0.5  # Newton steps with all that changes, and the share of the imbalance that one may leave
_BALANCED = 1e-6  # share of the forces
_NEARLY = 1e-2  # share of them that a rest may leave
_LEAST_ARM = 1e-3  # [m]
_KEPT = 1e-3  # share of its stiffness that a slipping contact keeps in the Newton steps


class LetGo(NamedTuple):
    """k contacts at rest, after the object was let go.

    Attributes:
        shift: of the object (6,): twist about its centre of mass, linear first [m, rad].
        normal: normal forces (k,) [N].
        friction: forces across the normals, world axes, and moments about the normals (k, 4) [N, N m].
        stiffness: of all contacts against twists of the object (6, 6).
        gripping: the part of it that is friction's (6, 6).
        balanced: whether it is a rest: where none is found, the object was still on its way.
    """

    shift: Array
    normal: Array
    friction: Array
    stiffness: Array
    gripping: Array
    balanced: bool


def friction_built_up(problem: ForceProblem, depths: Array, slid: Array) -> Array:
    """Friction (k, 4) [N, N m] on the object, held still, once links have gone in to ``depths`` and slid along it.

    Args:
        problem: k contacts.
        depths: on the way (c, k) [m].
        slid: how far links have slid by then, world axes, and turned about the normals (c, k, 4) [m, rad].
    """
    stretched = np.zeros(slid.shape[1:])
    for i in range(1, len(depths)):
        for part in np.arange(1, _PARTS + 1) / _PARTS:
            deep = depths[i - 1] + part * (depths[i] - depths[i - 1])
            grips = _grips(problem, stretched + (slid[i] - slid[i - 1]) / _PARTS, _normal(problem, deep))
            stretched = grips.stretched
    return stretched * _springs(problem)


def let_go(problem: ForceProblem, depths: Array, friction: Array) -> LetGo:
    """The contacts' rest under the problem's load, from ``depths`` (k,) [m] and ``friction`` (k, 4) at t_F."""
    contacts, load, springs = OnObject(problem, depths), np.asarray(problem.load), _springs(problem)
    shift, since, stretched = np.zeros(6), np.zeros(6), friction / np.where(springs > 0, springs, 1.0)
    now = contacts.at(shift, since, stretched)
    support, enough = -(now.wrench + load), _BALANCED * max(float(now.normal.sum()), _BALANCED)
    for stage in range(1, _STAGES + 1):
        held = load + support * (1 - stage / _STAGES)
        for _ in range(_ROUNDS):
            # As if normal forces gave the cones their size, but no more: a convex energy, whose least is always found.
            shift = _least_energy(contacts, held, shift, since, stretched, now.normal, enough)
            shift, now = _balanced(contacts, held, shift, since, stretched, enough)
            if contacts.size(now.wrench + held) < enough:
                break
        stretched, since = now.stretched, shift
    balanced = contacts.size(now.wrench + load) < _NEARLY * float(now.normal.sum())
    return LetGo(shift, now.normal, now.friction, now.stiffness, now.gripping, balanced)


def _least_energy(
    contacts: OnObject, held: Array, shift: Array, since: Array, stretched: Array, normal: Array, enough: float
) -> Array:
    """The object's shift (6,) under the wrench ``held`` (6,), with the cones of the forces ``normal`` (k,) [N]."""
    now = contacts.capped(shift, since, stretched, normal)
    for _ in range(_STEPS):
        left = now.wrench + held
        if contacts.size(left) < enough:
            break
        step, share = contacts.twist(now.stiffness, left), 1.0
        for _ in range(_HALVINGS):
            tried = contacts.capped(shift + share * step, since, stretched, normal)
            if tried.energy - now.energy - share * (held @ step) <= -1e-4 * share * (left @ step):
                break
            share /= 2
        else:
            break
        shift, now = shift + share * step, tried
    return shift


def _balanced(
    contacts: OnObject, held: Array, shift: Array, since: Array, stretched: Array, enough: float
) -> tuple[Array, _Now]:
    """Newton's method for the balance with the wrench ``held`` (6,), as long as it leads there."""
    now = contacts.at(shift, since, stretched)
    for _ in range(_FULL_STEPS):
        left = now.wrench + held
        off = contacts.size(left)
        if off < enough:
            break
        step = contacts.twist(now.stiffness, left)
        tried = contacts.at(shift + step, since, stretched)
        if contacts.size(tried.wrench + held) > _LEFT * off:
            break
        shift, now = shift + step, tried
    return shift, now


def _normal(problem: ForceProblem, depths: Array) -> Array:
    return problem.compliance.normal_force(np.maximum(depths, 0.0))


def _springs(problem: ForceProblem) -> Array:
    """Stiffness of a contact's friction (4,) [N/m, N m]: along the surface, and about the normal of a soft finger."""
    return TANGENTIAL * np.array([1.0, 1.0, 1.0, problem.friction.torsion**2])


class _Grips(NamedTuple):
    """Friction's springs of k contacts: how far ``stretched`` (k, 4), and the share that the cones left (k, 2)."""

    stretched: Array
    left: Array


def _grips(problem: ForceProblem, stretched: Array, normal: Array) -> _Grips:
    """Springs that would be ``stretched`` (k, 4) [m, rad], but slip."""
    pull = np.column_stack([np.linalg.norm(stretched[:, :3], axis=1), np.abs(stretched[:, 3])])
    most = np.column_stack([problem.mu * normal, problem.friction.torsion * normal]) / np.maximum(
        _springs(problem)[[0, 3]], 1e-300
    )
    left = np.where(pull > most, most / np.maximum(pull, 1e-300), 1.0)
    return _Grips(stretched * left[:, [0, 0, 0, 1]], left)


class _Now(NamedTuple):
    """k contacts while the object moves; ``wrench`` (6,) is theirs on the object, all else as in :class:`LetGo`."""

    normal: Array
    friction: Array
    stretched: Array
    wrench: Array
    stiffness: Array
    gripping: Array


class _Capped(NamedTuple):
    """k contacts whose friction has fixed limits: their ``energy`` [J], wrench (6,) on the object, stiffness (6, 6)."""

    energy: float
    wrench: Array
    stiffness: Array


class OnObject:
    """k contacts with ``depths`` (k,) [m] as the object sees them, to first order of its motion."""

    def __init__(self, problem: ForceProblem, depths: Array):
        self.problem, self.depths, self.springs = problem, depths, _springs(problem)
        normals = np.array([contact.normal_o for contact in problem.contacts])
        arms = problem.contacts.points_o - problem.contacts.com_o
        # By a twist: displacements of the contact points, v + omega x arm, and turns about the normals (k, 4, 6).
        turning = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=2)
        moves = np.concatenate([np.tile(np.eye(3), (len(arms), 1, 1)), turning], axis=2)
        about = np.concatenate([np.zeros_like(normals), normals], axis=1)
        self.into = np.einsum("kij,ki->kj", moves, normals)
        across = moves - normals[:, :, None] * self.into[:, None, :]
        self.moves = np.concatenate([across, about[:, None, :]], axis=1)
        # Twists and wrenches in metres and newtons at the contacts.
        self.units = np.repeat([1.0, 1.0 / max(_LEAST_ARM, float(np.sqrt((arms**2).sum(axis=1).mean())))], 3)

    def size(self, wrench: Array) -> float:
        """Of a wrench (6,) [N]."""
        return float(np.abs(self.units * wrench).max())

    def twist(self, stiffness: Array, wrench: Array) -> Array:
        """The least twist (6,) that a wrench asks for."""
        scaled = self.units[:, None] * stiffness * self.units
        return np.asarray(self.units * np.linalg.lstsq(scaled, self.units * wrench, rcond=1e-9)[0])

    def capped(self, shift: Array, since: Array, stretched: Array, normal: Array) -> _Capped:
        """As :meth:`at`, where friction is limited as by the normal forces ``normal`` (k,) [N], not by those there."""
        law, springs = self.problem.compliance, self.springs
        deep = np.maximum(self.depths - self.into @ shift, 0.0)
        pressing, steep = law.normal_force(deep), law.exponent * law.stiffness * deep ** (law.exponent - 1)
        asked = stretched - self.moves @ (shift - since)
        grips = _grips(self.problem, asked, normal)
        friction = grips.stretched * springs
        pull = np.column_stack([np.linalg.norm(asked[:, :3], axis=1), np.abs(asked[:, 3])])
        # As springs up to the limit, then in proportion.
        stored = springs[[0, 3]] * grips.left * (1 - 0.5 * grips.left) * pull**2
        energy = float((pressing * deep).sum() / (law.exponent + 1) + stored.sum())
        wrench = self.into.T @ pressing + np.einsum("kij,ki->j", self.moves, friction)
        grip = self._grip(grips, friction)
        stiffness = (steep[:, None] * self.into).T @ self.into + np.einsum(
            "kia,kij,kjb->ab", self.moves, grip, self.moves
        )
        return _Capped(energy, wrench, stiffness)

    def _grip(self, grips: _Grips, friction: Array) -> Array:
        """Stiffness of friction's springs (k, 4, 4).

        One that slips keeps its own in proportion to what is left, but for the way that it slips.
        """
        left, slips = np.maximum(grips.left, _KEPT), grips.left < 1.0
        lost = np.where(slips, np.maximum(grips.left - _KEPT, 0.0), 0.0)
        direction = friction[:, :3] / np.maximum(np.linalg.norm(friction[:, :3], axis=1, keepdims=True), 1e-300)
        along = np.zeros((len(friction), 4, 4))
        along[:, :3, :3] = lost[:, :1, None] * np.einsum("ki,kj->kij", direction, direction)
        along[:, 3, 3] = lost[:, 1]
        return np.asarray(self.springs[:, None] * (left[:, [0, 0, 0, 1], None] * np.eye(4) - along))

    def at(self, shift: Array, since: Array, stretched: Array) -> _Now:
        """After the object's ``shift`` (6,), where friction's springs were ``stretched`` (k, 4) at ``since``."""
        law, mu = self.problem.compliance, self.problem.mu
        deep = np.maximum(self.depths - self.into @ shift, 0.0)
        normal, steep = law.normal_force(deep), law.exponent * law.stiffness * deep ** (law.exponent - 1)
        grips = _grips(self.problem, stretched - self.moves @ (shift - since), normal)
        friction = grips.stretched * self.springs
        wrench = self.into.T @ normal + np.einsum("kij,ki->j", self.moves, friction)
        gripping = np.einsum("kia,kij,kjb->ab", self.moves, self._grip(grips, friction), self.moves)
        # Friction falls with the normal force.
        slips = grips.left < 1.0
        direction = friction[:, :3] / np.maximum(np.linalg.norm(friction[:, :3], axis=1, keepdims=True), 1e-300)
        pressed = self.into + (slips[:, 0] * mu)[:, None] * np.einsum("kij,ki->kj", self.moves[:, :3], direction)
        return _Now(
            normal, friction, grips.stretched, wrench, gripping + (steep[:, None] * pressed).T @ self.into, gripping
        )
