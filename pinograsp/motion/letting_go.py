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

from typing import NamedTuple

import numpy as np

from pinograsp.forces import ForceProblem
from pinograsp.motion.contact_springs import Capped, Contacts, Now, ObjectMotion, Servos, measure_friction_springs
from pinograsp.motion.rounds import REST
from pinograsp.spatial import Array


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
    before = given
    for i in range(1, len(depths)):
        held = Contacts(problem, depths[i], servos=None if servos is None else servos[i], free=False)
        for part in np.arange(1, REST.parts + 1) / REST.parts:
            deep = depths[i - 1] + part * (depths[i] - depths[i - 1])
            known = held.displace(given, stretched + (slid[i] - slid[i - 1]) / REST.parts, deep)
            if servos is None:
                now = Now(held, known, given)
            else:
                sent = servos[i - 1].torques + part * (servos[i].torques - servos[i - 1].torques)
                now = _rest(held, sent, known, given, given + (given - before))
                before, given = given, now.y
            stretched = now.stretched
    return Pressed(stretched * measure_friction_springs(problem), given)


def let_go(
    problem: ForceProblem,
    depths: Array,
    pressed: Pressed,
    servos: Servos | None = None,
    motion: ObjectMotion | None = None,
) -> LetGo:
    """The contacts' rest under the problem's load, from ``depths`` (k,) [m] as if joints did not give way, at t_F.

    ``motion``: the twists of the problem's object, where they are known already.
    """
    contacts, springs = Contacts(problem, depths, servos=servos, motion=motion), measure_friction_springs(problem)
    pull = np.concatenate([problem.load, np.zeros(0) if servos is None else servos.torques])
    y = np.concatenate([np.zeros(6), pressed.given])
    stretched = pressed.friction / np.where(springs > 0, springs, 1.0)
    now = contacts.at(y, y, stretched)
    before = y
    support = np.concatenate([-(now.left + pull)[:6], np.zeros(len(pressed.given))])
    for stage in range(1, REST.stages + 1):
        # Forces that do not balance the moments let the object turn far, and there is more than one rest.
        ahead = now.y + (now.y - before) if problem.balance == "wrench" else None
        before = now.y
        known = contacts.displace(before, stretched)
        now = _rest(contacts, pull + support * (1 - stage / REST.stages), known, before, ahead)
        stretched = now.stretched
    balanced = contacts.size(now.left + pull) < REST.nearly * float(now.normal.sum())
    stiffness, gripping = now.stiffness[:6, :6], now.gripping[:6, :6]
    return LetGo(now.y[:6], now.normal, now.friction, stiffness, gripping, contacts.response(now), balanced)


def _rest(contacts: Contacts, pull: Array, known: Array, since: Array, ahead: Array | None) -> Now:
    """The contacts in balance with ``pull`` (p,), or nearly, from the motions ``since`` (p,) on.

    ``known``: z_0 (k, r) of the contacts; ``ahead``: motions (p,) where the balance may be, None: far away.
    """
    now = Now(contacts, known, since if ahead is None else ahead)
    enough = REST.balanced * max(float(now.normal.sum()), REST.balanced)
    if ahead is not None:
        # Newton's method mostly leads there at once.
        now, balanced = _find_balance(contacts, pull, now, known, enough)
        if balanced:
            return now
        now = Now(contacts, known, since)
    for _ in range(REST.rounds):
        # As if normal forces gave the cones their size, but no more: a convex energy, whose least is always found.
        y = _least_energy(contacts, pull, now.y, known, now.normal, enough)
        now, balanced = _find_balance(contacts, pull, Now(contacts, known, y), known, enough)
        if balanced:
            break
    return now


def _least_energy(contacts: Contacts, pull: Array, y: Array, known: Array, normal: Array, enough: float) -> Array:
    """The motions (p,) of least energy, from ``y``, with the cones of the forces ``normal`` (k,) [N]."""
    now = Capped(contacts, known, y, normal)
    for _ in range(REST.steps):
        left = now.left + pull
        if contacts.size(left) < enough:
            break
        step, share, energy = contacts.least_motion(now.stiffness, left), 1.0, now.energy
        for _ in range(REST.halvings):
            tried = Capped(contacts, known, now.y + share * step, normal)
            if tried.energy - energy - share * (pull @ step) <= -1e-4 * share * (left @ step):
                break
            share /= 2
        else:
            break
        now = tried
    return now.y


def _find_balance(contacts: Contacts, pull: Array, now: Now, known: Array, enough: float) -> tuple[Now, bool]:
    """Newton's method for the balance, as long as it leads there; with the last stiffness, as long as that is quick.

    Returns where it led, and whether that is in balance.
    """
    left, step = now.left + pull, None
    off = contacts.size(left)
    for _ in range(REST.full_steps):
        if off < enough:
            break
        new = step is None
        step = contacts.least_motions(now.stiffness) if step is None else step
        tried = Now(contacts, known, now.y + step(left))
        tried_left = tried.left + pull
        size = contacts.size(tried_left)
        if size > REST.left * off and new:
            break
        if size > REST.quick * off:
            step = None
        if size <= REST.left * off:
            now, left, off = tried, tried_left, size
    return now, off < enough
