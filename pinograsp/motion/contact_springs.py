"""k contacts as springs between an object and the joints that hold it: forces, what they leave over, and stiffness.

With y (p,) the motions of the object and of the joints, every contact has the displacements z = z_0 - C y (k, r): its
depth, and how far the spring of its friction would be stretched if it did not slip, along the surface (three world
axes) and, of soft fingers, about the normal. Its force F(z) (k, r) follows contact by contact, and

    left = C^T F - own y,    stiffness = -d(left)/dy = C^T (dF/dz) C + own.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.linalg import lapack

from pinograsp.forces import ForceProblem
from pinograsp.spatial import Array, skew

# [N/m] stiffness of a contact along the surface: above that along the normal, at the depths of a few newtons.
TANGENTIAL = 2e4
_LEAST_ARM = 1e-3  # [m]
_KEPT = 1e-3  # share of its stiffness that a slipping contact keeps in the Newton steps
_RANK = 1e-9  # singular values below this share of the largest count as zero
_TINY = 1e-300


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Servos:
    """n joints that give way under k contacts, and what their servos are sent besides.

    Attributes:
        deepening: how joints change the depths (k, n) [m/rad or m/m].
        across: how they move the links across the normals, world axes, and turn them about these (k, 4, n).
        stiffness: of the servos (n,) [N m/rad or N/m].
        torques: of the planned forces (n,) [N m or N].
    """

    deepening: Array
    across: Array
    stiffness: Array
    torques: Array


class ObjectMotion(NamedTuple):
    """What twists of an object about its centre of mass (linear first) do at its k contacts.

    Attributes:
        into: depths lost (k, 6).
        moves: displacements across the normals, world axes, and turns about them (k, 4, 6).
        units: twists (6,) that move contacts by about a metre.
    """

    into: Array
    moves: Array
    units: Array


def describe_object_motion(problem: ForceProblem) -> ObjectMotion:
    """The twists of a problem's object."""
    contacts = problem.contacts
    normals, arms = contacts.rotations_oc[:, :, 2], contacts.points_o - contacts.com_o
    # v + omega x arm.
    moves = np.concatenate([np.broadcast_to(np.eye(3), (len(arms), 3, 3)), -skew(arms)], axis=2)
    about = np.concatenate([np.zeros_like(normals), normals], axis=1)
    into = np.einsum("kij,ki->kj", moves, normals)
    across = moves - normals[:, :, None] * into[:, None, :]
    units = np.repeat([1.0, 1.0 / max(_LEAST_ARM, float(np.sqrt((arms**2).sum(axis=1).mean())))], 3)
    return ObjectMotion(into, np.concatenate([across, about[:, None, :]], axis=1), units)


def measure_friction_springs(problem: ForceProblem) -> Array:
    """Stiffness of a contact's friction (4,) [N/m, N m]: along the surface, and about the normal of a soft finger."""
    return TANGENTIAL * np.array([1.0, 1.0, 1.0, problem.friction.torsion**2])


class Contacts:
    """k contacts with ``depths`` (k,) [m], to first order in the twist of an object that is ``free``, and in joints.

    Attributes:
        depths: (k,) [m] before any motion.
        columns: C (k, r, p), r = 4, or 5 with soft fingers.
        own: the servos' stiffness (p,).
        units: motions (p,) that move contacts by about a metre; 0 for joints that move none of them: these stay.
    """

    def __init__(
        self,
        problem: ForceProblem,
        depths: Array,
        *,
        servos: Servos | None = None,
        free: bool = True,
        motion: ObjectMotion | None = None,
    ):
        self.problem, self.depths, self.k = problem, depths, problem.k
        self.soft = problem.friction.torsion > 0
        self.law, springs = problem.compliance, measure_friction_springs(problem)
        self.springs = springs if self.soft else springs[:3]
        # Springs slip where they are stretched further than this per newton [m/N, 1/N].
        self.slack = np.asarray(problem.mu) / TANGENTIAL
        self.slack_about = problem.friction.torsion / springs[3] if self.soft else 0.0
        twists, n, rows = 6 * free, 0 if servos is None else len(servos.stiffness), len(self.springs)
        self.columns = np.empty((self.k, 1 + rows, twists + n))
        self.own, self.units = np.zeros(twists + n), np.zeros(twists + n)
        if free:
            into, moves, self.units[:6] = describe_object_motion(problem) if motion is None else motion
            self.columns[:, 0, :6], self.columns[:, 1:, :6] = into, moves[:, :rows]
        if servos is not None:
            # Links that go in deepen what the object lessens.
            self.columns[:, 0, twists:], self.columns[:, 1:, twists:] = -servos.deepening, -servos.across[:, :rows]
            moving = self.columns[:, :4, twists:]
            reach = np.sqrt((moving * moving).sum(axis=(0, 1)))
            np.divide(1.0, reach, out=self.units[twists:], where=reach > _LEAST_ARM)
            self.own[twists:] = servos.stiffness
        self.flat = self.columns.reshape(self.k * (1 + rows), twists + n)
        units, live = self.units, np.flatnonzero(self.units)
        self._live, self._pairs = live, np.ix_(live, live)
        self._scale = units[live, None] * units[live]

    def displace(self, since: Array, stretched: Array, depths: Array | None = None) -> Array:
        """z_0 (k, r), where friction's springs were ``stretched`` (k, 4) [m, rad] at the motions ``since`` (p,).

        ``depths`` (k,) [m] before any motion: other ones than the contacts' own.
        """
        found = (self.flat @ since).reshape(self.k, -1)
        found[:, 1:] += stretched[:, : found.shape[1] - 1]
        found[:, 0] = self.depths if depths is None else depths
        return found

    def at(self, y: Array, since: Array, stretched: Array) -> Now:
        """After the motions ``y`` (p,), where friction's springs were ``stretched`` (k, 4) at ``since`` (p,)."""
        return Now(self, self.displace(since, stretched), y)

    def size(self, left: Array) -> float:
        """Of what is left (p,) [N]."""
        return float(np.abs(self.units * left).max()) if len(left) else 0.0

    def least_motions(self, stiffness: Array) -> Callable[[Array], Array]:
        """The least motion (p,) that takes away what is left (p,), as a function of that."""
        live, units = self._live, self.units
        if not len(live):
            return np.zeros_like
        if len(live) == len(units):
            solve = _least(self._scale * stiffness)
            return lambda left: units * solve(units * left)
        solve, own = _least(self._scale * stiffness[self._pairs]), units[live]

        def motion(left: Array) -> Array:
            found = np.zeros_like(left)
            found[live] = own * solve(own * left[live])
            return found

        return motion

    def least_motion(self, stiffness: Array, left: Array) -> Array:
        """The least motion (p,) that takes away what is left (p,)."""
        return self.least_motions(stiffness)(left)

    def response(self, now: Now) -> Array:
        """How depths at rest follow those that joints give (k, k), to first order."""
        into = self.columns[:, 0]
        steep = self.law.slope(self.law.depth(now.normal))
        scaled = self.units[:, None] * now.stiffness * self.units
        pulled = np.linalg.lstsq(scaled, self.units[:, None] * (into.T * steep), rcond=_RANK)[0]
        return np.asarray(np.eye(len(steep)) - (into * self.units) @ pulled)


class Now:
    """k contacts after motions y (p,).

    Attributes:
        normal: normal forces (k,) [N].
        left: what the contacts and the servos pull with, along y (p,).
    """

    __slots__ = ("_asked", "_contacts", "_deep", "_forces", "_gripped", "_pull", "left", "normal", "y")

    def __init__(self, contacts: Contacts, known: Array, y: Array, capped: Array | None = None):
        law = contacts.law
        found = known - (contacts.flat @ y).reshape(known.shape)
        self._contacts, self.y = contacts, y
        self._deep = np.maximum(found[:, 0], 0.0)
        self.normal = law.force(self._deep)
        limit = self.normal if capped is None else capped
        self._asked = asked = found[:, 1:]
        self._pull = [np.sqrt(np.einsum("ki,ki->k", asked[:, :3], asked[:, :3]))]
        self._gripped = [_share_kept(self._pull[0], contacts.slack * limit)]
        self._forces = forces = np.empty_like(found)
        forces[:, 0] = self.normal
        forces[:, 1:4] = asked[:, :3] * (TANGENTIAL * self._gripped[0])[:, None]
        if contacts.soft:
            self._pull.append(np.abs(asked[:, 3]))
            self._gripped.append(_share_kept(self._pull[1], contacts.slack_about * limit))
            forces[:, 4] = asked[:, 3] * (contacts.springs[3] * self._gripped[1])
        self.left = forces.ravel() @ contacts.flat - contacts.own * y

    @property
    def friction(self) -> Array:
        """Forces across the normals, world axes, and moments about the normals (k, 4) [N, N m]."""
        return self._of_four(self._forces[:, 1:])

    @property
    def stretched(self) -> Array:
        """The springs of friction (k, 4) [m, rad]."""
        return self._of_four(self._forces[:, 1:] / self._contacts.springs)

    def _of_four(self, values: Array) -> Array:
        if self._contacts.soft:
            return values
        found = np.zeros((len(values), 4))
        found[:, :3] = values
        return found

    @property
    def stiffness(self) -> Array:
        """Of what is left against y (p, p)."""
        slopes, contacts = self._slopes(), self._contacts
        # Friction of a contact that slips falls with the normal force.
        falls = contacts.problem.mu * (self._gripped[0] < 1.0) / np.maximum(self._pull[0], _TINY)
        slopes[:, 1:4, 0] = (slopes[:, 0, 0] * falls)[:, None] * self._asked[:, :3]
        return self._against(slopes)

    @property
    def gripping(self) -> Array:
        """The part of the stiffness that is friction's (p, p)."""
        slopes = self._slopes()
        slopes[:, 0, 0] = 0.0
        found = self._against(slopes)
        found.flat[:: len(found) + 1] -= self._contacts.own
        return found

    def _against(self, slopes: Array) -> Array:
        contacts = self._contacts
        turned = np.matmul(slopes, contacts.columns).reshape(contacts.flat.shape)
        found: Array = contacts.flat.T @ turned
        found.flat[:: len(found) + 1] += contacts.own
        return found

    def _slopes(self) -> Array:
        """dF/dz (k, r, r), each contact's friction with the size that it has.

        A spring that slips keeps its own in proportion to what is left, but for the way that it slips.
        """
        law, asked = self._contacts.law, self._asked
        slopes = np.zeros((len(asked), asked.shape[1] + 1, asked.shape[1] + 1))
        slopes[:, 0, 0] = law.slope(self._deep)
        left = np.maximum(self._gripped[0], _KEPT)
        slips = self._gripped[0] < 1.0
        if slips.any():
            along = asked[:, :3] / np.maximum(self._pull[0], _TINY)[:, None]
            lost = np.where(slips, TANGENTIAL * (left - _KEPT), 0.0)
            slopes[:, 1:4, 1:4] = (-lost[:, None] * along)[:, :, None] * along[:, None]
        for i in (1, 2, 3):
            slopes[:, i, i] += TANGENTIAL * left
        if self._contacts.soft:
            left = np.maximum(self._gripped[1], _KEPT)
            slopes[:, 4, 4] = self._contacts.springs[3] * np.where(self._gripped[1] < 1.0, _KEPT, left)
        return slopes


class Capped(Now):
    """As :class:`Now`, of contacts whose friction has fixed limits, so that there is an ``energy`` [J]."""

    __slots__ = ()

    @property
    def energy(self) -> float:
        """What contacts and servos have stored [J]."""
        contacts = self._contacts
        stored = contacts.law.energy(self._deep).sum() + 0.5 * contacts.own @ self.y**2
        # As springs up to the limit, then in proportion.
        for spring, gripped, pull in zip(contacts.springs[[0, -1]], self._gripped, self._pull):
            stored += spring * (gripped * (1 - 0.5 * gripped)) @ pull**2
        return float(stored)

    @property
    def stiffness(self) -> Array:
        """Of what is left against y (p, p)."""
        return self._against(self._slopes())


def _share_kept(pull: Array, most: Array) -> Array:
    """The share (k,) of what springs are asked to stretch that is left where they slip beyond ``most``."""
    return np.minimum(1.0, (most + _TINY) / (pull + _TINY))


def _least(matrix: Array) -> Callable[[Array], Array]:
    """The least solution (p,) of matrix x = right; by elimination where it is the only one, far from singular."""
    factors, pivots, singular = lapack.dgetrf(matrix)
    if not singular:
        reciprocal, _ = lapack.dgecon(factors, lapack.dlange("1", matrix))
        if reciprocal > len(matrix) * _RANK:
            return lambda right: lapack.dgetrs(factors, pivots, right)[0]
    return lambda right: np.asarray(np.linalg.lstsq(matrix, right, rcond=_RANK)[0], dtype=float)
