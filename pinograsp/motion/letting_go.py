"""How a grasp comes to rest as the object is let go: friction that built up while the hand pressed lets it shift.

The object is held until t_F. While the links press, they also slide along its surface, and friction builds up as far as
the cone allows. As the support fades, the object moves until contacts and load are in balance; that changes the depths,
and with them the normal forces. Friction is a spring that slips (Cundall and Strack, Geotechnique 29(1), 1979), about
the normals of soft fingers, too; normal forces are those at rest (Eq. 4). Joints give way as their servos do, which are
sent the torques of the planned forces besides.

With y the motions of the object and of the joints from where they are known, a rest is where nothing is left of

    into^T N + moves^T friction - own y + pull,

``pull`` the load and the torques that are sent, ``own`` the servos' stiffness.
"""

from __future__ import annotations

from dataclasses import dataclass
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


class Pressed(NamedTuple):
    """k contacts at t_F, the object still held.

    Attributes:
        friction: on the object across the normals, world axes, and moments about the normals (k, 4) [N, N m].
        given: how far the joints have given way (n,) [rad or m].
    """

    friction: Array
    given: Array


class LetGo(NamedTuple):
    """k contacts at rest, after the object was let go.

    Attributes:
        shift: of the object (6,): twist about its centre of mass, linear first [m, rad].
        normal: normal forces (k,) [N].
        friction: forces across the normals, world axes, and moments about the normals (k, 4) [N, N m].
        stiffness: of all contacts against twists of the object (6, 6).
        gripping: the part of it that is friction's (6, 6).
        response: how depths at rest change with those that joints give, to first order (k, k) [-].
        balanced: whether it is a rest: where none is found, the object was still on its way.
    """

    shift: Array
    normal: Array
    friction: Array
    stiffness: Array
    gripping: Array
    response: Array
    balanced: bool


def friction_built_up(
    problem: ForceProblem, depths: Array, slid: Array, servos: tuple[Servos, ...] | None = None
) -> Pressed:
    """Friction on the object, held still, once links have gone in to ``depths`` and slid along it.

    Args:
        problem: k contacts.
        depths: on the way (c, k) [m], as if joints did not give way.
        slid: how far links have slid by then, world axes, and turned about the normals (c, k, 4) [m, rad].
        servos: of the joints at each depth (c,); None: joints do not give way.
    """
    stretched, given = np.zeros(slid.shape[1:]), np.zeros(0 if servos is None else len(servos[0].stiffness))
    friction = stretched
    for i in range(1, len(depths)):
        for part in np.arange(1, _PARTS + 1) / _PARTS:
            deep = depths[i - 1] + part * (depths[i] - depths[i - 1])
            asked = stretched + (slid[i] - slid[i - 1]) / _PARTS
            if servos is None:
                stretched = _grips(problem, asked, _normal(problem, deep)).stretched
            else:
                contacts = Contacts(problem, deep, servos=servos[i], free=False)
                sent = servos[i - 1].torques + part * (servos[i].torques - servos[i - 1].torques)
                given, now = _rest(contacts, sent, given, asked)
                stretched = now.stretched
            friction = stretched * _springs(problem)
    return Pressed(friction, given)


def let_go(problem: ForceProblem, depths: Array, pressed: Pressed, servos: Servos | None = None) -> LetGo:
    """The contacts' rest under the problem's load, from ``depths`` (k,) [m] as if joints did not give way, at t_F."""
    contacts, springs = Contacts(problem, depths, servos=servos), _springs(problem)
    pull = np.concatenate([problem.load, np.zeros(0) if servos is None else servos.torques])
    y = np.concatenate([np.zeros(6), pressed.given])
    stretched = pressed.friction / np.where(springs > 0, springs, 1.0)
    now = contacts.at(y, y, stretched)
    support = np.concatenate([-(now.left + pull)[:6], np.zeros(len(pressed.given))])
    for stage in range(1, _STAGES + 1):
        y, now = _rest(contacts, pull + support * (1 - stage / _STAGES), y, stretched)
        stretched = now.stretched
    balanced = contacts.size(now.left + pull) < _NEARLY * float(now.normal.sum())
    stiffness, gripping = now.stiffness[:6, :6], now.gripping[:6, :6]
    return LetGo(y[:6], now.normal, now.friction, stiffness, gripping, contacts.response(now), balanced)


def _rest(contacts: Contacts, pull: Array, since: Array, stretched: Array) -> tuple[Array, Now]:
    """Motions (p,) in balance with ``pull`` (p,), or nearly, and the contacts there; springs as at ``since`` (p,)."""
    y, now = since, contacts.at(since, since, stretched)
    enough = _BALANCED * max(float(now.normal.sum()), _BALANCED)
    for _ in range(_ROUNDS):
        # As if normal forces gave the cones their size, but no more: a convex energy, whose least is always found.
        y = _least_energy(contacts, pull, y, since, stretched, now.normal, enough)
        y, now = _balanced(contacts, pull, y, since, stretched, enough)
        if contacts.size(now.left + pull) < enough:
            break
    return y, now


# Seven arguments: from where, and what the energy is of.
def _least_energy(
    contacts: Contacts, pull: Array, y: Array, since: Array, stretched: Array, normal: Array, enough: float
) -> Array:
    """The motions (p,) of least energy, with the cones of the forces ``normal`` (k,) [N]."""
    now = contacts.capped(y, since, stretched, normal)
    for _ in range(_STEPS):
        left = now.left + pull
        if contacts.size(left) < enough:
            break
        step, share = contacts.least_motion(now.stiffness, left), 1.0
        for _ in range(_HALVINGS):
            tried = contacts.capped(y + share * step, since, stretched, normal)
            if tried.energy - now.energy - share * (pull @ step) <= -1e-4 * share * (left @ step):
                break
            share /= 2
        else:
            break
        y, now = y + share * step, tried
    return y


def _balanced(
    contacts: Contacts, pull: Array, y: Array, since: Array, stretched: Array, enough: float
) -> tuple[Array, Now]:
    """Newton's method for the balance, as long as it leads there."""
    now = contacts.at(y, since, stretched)
    for _ in range(_FULL_STEPS):
        left = now.left + pull
        off = contacts.size(left)
        if off < enough:
            break
        step = contacts.least_motion(now.stiffness, left)
        tried = contacts.at(y + step, since, stretched)
        if contacts.size(tried.left + pull) > _LEFT * off:
            break
        y, now = y + step, tried
    return y, now


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


class Now(NamedTuple):
    """k contacts after motions y (p,).

    Attributes:
        normal: normal forces (k,) [N].
        friction: forces across the normals, world axes, and moments about the normals (k, 4) [N, N m].
        stretched: its springs (k, 4) [m, rad].
        left: what the contacts and the servos pull with, along y (p,).
        stiffness: of that against y (p, p).
        gripping: the part of it that is friction's (p, p).
    """

    normal: Array
    friction: Array
    stretched: Array
    left: Array
    stiffness: Array
    gripping: Array


class Capped(NamedTuple):
    """As :class:`Now`, of contacts whose friction has fixed limits: the ``energy`` [J], ``left``, ``stiffness``."""

    energy: float
    left: Array
    stiffness: Array


class Contacts:
    """k contacts with ``depths`` (k,) [m], to first order in the twist of an object that is ``free``, and in joints."""

    def __init__(self, problem: ForceProblem, depths: Array, *, servos: Servos | None = None, free: bool = True):
        self.problem, self.depths, self.springs = problem, depths, _springs(problem)
        into, moves, units = self._of_object()
        own = np.zeros(6)
        if not free:
            into, moves, units, own = into[:, :0], moves[:, :, :0], units[:0], own[:0]
        if servos is not None:
            # Links that go in deepen what the object lessens.
            into, moves = np.hstack([into, -servos.deepening]), np.concatenate([moves, -servos.across], axis=2)
            reach = np.sqrt((servos.deepening**2).sum(axis=0) + (servos.across[:, :3] ** 2).sum(axis=(0, 1)))
            units = np.concatenate([units, np.divide(1.0, reach, out=np.zeros(len(reach)), where=reach > _LEAST_ARM)])
            own = np.concatenate([own, servos.stiffness])
        self.into, self.moves, self.own = into, moves, own
        # Motions and forces in metres and newtons at the contacts; joints that move none of them stay.
        self.units = units

    def _of_object(self) -> tuple[Array, Array, Array]:
        """By a twist of the object: depths lost (k, 6), displacements across and turns about the normals (k, 4, 6)."""
        contacts = self.problem.contacts
        normals = np.array([contact.normal_o for contact in contacts])
        arms = contacts.points_o - contacts.com_o
        # v + omega x arm.
        turning = np.stack([np.cross(axis, arms) for axis in np.eye(3)], axis=2)
        moves = np.concatenate([np.tile(np.eye(3), (len(arms), 1, 1)), turning], axis=2)
        about = np.concatenate([np.zeros_like(normals), normals], axis=1)
        into = np.einsum("kij,ki->kj", moves, normals)
        across = moves - normals[:, :, None] * into[:, None, :]
        units = np.repeat([1.0, 1.0 / max(_LEAST_ARM, float(np.sqrt((arms**2).sum(axis=1).mean())))], 3)
        return into, np.concatenate([across, about[:, None, :]], axis=1), units

    def size(self, left: Array) -> float:
        """Of what is left (p,) [N]."""
        return float(np.abs(self.units * left).max(initial=0.0))

    def least_motion(self, stiffness: Array, left: Array) -> Array:
        """The least motion (p,) that takes away what is left (p,)."""
        scaled = self.units[:, None] * stiffness * self.units
        return np.asarray(self.units * np.linalg.lstsq(scaled, self.units * left, rcond=1e-9)[0])

    def capped(self, y: Array, since: Array, stretched: Array, normal: Array) -> Capped:
        """As :meth:`at`, where friction is limited as by the normal forces ``normal`` (k,) [N], not by those there."""
        law, springs = self.problem.compliance, self.springs
        deep = np.maximum(self.depths - self.into @ y, 0.0)
        pressing, steep = law.normal_force(deep), law.exponent * law.stiffness * deep ** (law.exponent - 1)
        asked = stretched - self.moves @ (y - since)
        grips = _grips(self.problem, asked, normal)
        friction = grips.stretched * springs
        pull = np.column_stack([np.linalg.norm(asked[:, :3], axis=1), np.abs(asked[:, 3])])
        # As springs up to the limit, then in proportion.
        stored = springs[[0, 3]] * grips.left * (1 - 0.5 * grips.left) * pull**2
        energy = float((pressing * deep).sum() / (law.exponent + 1) + stored.sum() + 0.5 * self.own @ y**2)
        left = self.into.T @ pressing + np.einsum("kij,ki->j", self.moves, friction) - self.own * y
        stiffness = (steep[:, None] * self.into).T @ self.into + self._grip(grips, friction) + np.diag(self.own)
        return Capped(energy, left, stiffness)

    def at(self, y: Array, since: Array, stretched: Array) -> Now:
        """After the motions ``y`` (p,), where friction's springs were ``stretched`` (k, 4) at ``since`` (p,)."""
        law, mu = self.problem.compliance, self.problem.mu
        deep = np.maximum(self.depths - self.into @ y, 0.0)
        normal, steep = law.normal_force(deep), law.exponent * law.stiffness * deep ** (law.exponent - 1)
        grips = _grips(self.problem, stretched - self.moves @ (y - since), normal)
        friction = grips.stretched * self.springs
        left = self.into.T @ normal + np.einsum("kij,ki->j", self.moves, friction) - self.own * y
        gripping = self._grip(grips, friction)
        # Friction falls with the normal force.
        slips = grips.left < 1.0
        direction = friction[:, :3] / np.maximum(np.linalg.norm(friction[:, :3], axis=1, keepdims=True), 1e-300)
        pressed = self.into + (slips[:, 0] * mu)[:, None] * np.einsum("kij,ki->kj", self.moves[:, :3], direction)
        stiffness = gripping + (steep[:, None] * pressed).T @ self.into + np.diag(self.own)
        return Now(normal, friction, grips.stretched, left, stiffness, gripping)

    def response(self, now: Now) -> Array:
        """How depths at rest follow those that joints give (k, k), to first order."""
        law = self.problem.compliance
        steep = law.exponent * law.stiffness * law.depth(now.normal) ** (law.exponent - 1)
        scaled = self.units[:, None] * now.stiffness * self.units
        pulled = np.linalg.lstsq(scaled, self.units[:, None] * (self.into.T * steep), rcond=1e-9)[0]
        return np.asarray(np.eye(len(steep)) - (self.into * self.units) @ pulled)

    def _grip(self, grips: _Grips, friction: Array) -> Array:
        """Stiffness of friction against motions (p, p).

        A spring that slips keeps its own in proportion to what is left, but for the way that it slips.
        """
        left, slips = np.maximum(grips.left, _KEPT), grips.left < 1.0
        lost = np.where(slips, np.maximum(grips.left - _KEPT, 0.0), 0.0)
        direction = friction[:, :3] / np.maximum(np.linalg.norm(friction[:, :3], axis=1, keepdims=True), 1e-300)
        along = np.zeros((len(friction), 4, 4))
        along[:, :3, :3] = lost[:, :1, None] * np.einsum("ki,kj->kij", direction, direction)
        along[:, 3, 3] = lost[:, 1]
        grip = self.springs[:, None] * (left[:, [0, 0, 0, 1], None] * np.eye(4) - along)
        moved = np.einsum("kij,kjb->kib", grip, self.moves)
        return np.asarray(np.tensordot(self.moves, moved, axes=([0, 1], [0, 1])))
