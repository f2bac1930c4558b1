"""Contact points with their frames, and the grasp map they make."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from numbers import Real
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import (
    are_rotations,
    array_of,
    brief,
    flag,
    floats_of,
    frozen,
    instance_of,
    items_of,
    mapping_of,
    number,
    one_of,
    read_only,
    rebuild,
    shorten,
    text_of,
)
from pinograsp.errors import InvalidInput
from pinograsp.hands import Finger, HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, skew, tangent_frame
from pinograsp.words import lines_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Contact:
    """One point contact with friction.

    Attributes:
        finger: name of the finger.
        link: the link that touches ("" without a hand).
        point_o: contact point (3,) in the world [m].
        rotation_oc: contact frame R_oc (3, 3); columns x, y tangent, z the inward normal (into the object).
        length: distance of the contact point from the link's joint [m] (l_c of Eq. 3); None if the contact phase
            determines it.
        distance: signed distance of the point from the object's surface [m], negative inside.
        point_l: the link's point that touches, in its joint's frame (3,) [m]; None: on the line along the link, at
            ``length``.
        sharp: whether a millimetre along the surface turns the normal by more than 25 deg: on an edge of the object
            that a corner, an edge or a narrow tip of the link touches, not its face. None: not known, the object
            decides.
    """

    finger: str
    link: str
    point_o: Array
    rotation_oc: Array
    length: float | None
    distance: float
    point_l: Array | None = None
    sharp: bool | None = None

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: object) -> None:
            object.__setattr__(self, name, value)

        text_of("finger of the contact", self.finger)
        text_of("link of the contact", self.link)
        put("point_o", array_of("contact point", self.point_o, (3,)))
        put("rotation_oc", array_of("contact frame", self.rotation_oc, (3, 3)))
        if not are_rotations(self.rotation_oc):
            raise InvalidInput(f"contact frame of '{self.finger}': expected an orthonormal right-handed rotation")
        if self.length is not None:
            put("length", number("contact length", self.length, at_least=0, unit="m"))
        put("distance", number("distance of the contact", self.distance, unit="m"))
        if self.point_l is not None:
            put("point_l", array_of("point of the link", self.point_l, (3,)))
        if self.sharp is not None:
            flag("sharp", self.sharp)

    @property
    def normal_o(self) -> Array:
        """Inward unit normal (3,) in the world."""
        return self.rotation_oc[:, 2]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactSet:
    """k contacts on one object. Iterates over :class:`Contact`.

    Attributes:
        com_o: the object's centre of mass (3,) [m].
        posture: of the hand that touches there (n,) [rad]; None if the contact phase has to find it.
        G: grasp map (6, 3k): stacked contact forces f_c -> wrench on the object, linear first [N, N m]. The force on
            the object at contact i is h_i = R_oc,i f_c,i (Eqs. 6, 7); moments are about the centre of mass, world axes.
        mean_distance: mean distance of the contacts from the centre of mass [m]; 1 if that is zero.
    """

    contacts: tuple[Contact, ...]
    com_o: Array
    posture: Array | None = None
    G: Array = field(init=False, repr=False)
    mean_distance: float = field(init=False, repr=False)

    __repr__ = brief("names", "com_o")

    def __str__(self) -> str:
        return lines_of(
            f"{len(self)} contacts",
            *(
                f"{name}: at ({', '.join(f'{1e3 * value:.1f}' for value in one.point_o)}) mm"
                + (f" on {one.link}" if one.link else "")
                for name, one in zip(self.names, self.contacts)
            ),
        )

    def __post_init__(self) -> None:
        object.__setattr__(self, "contacts", items_of("contacts", self.contacts, Contact))
        if not self.contacts:
            raise InvalidInput("contacts: expected at least one, got none")
        object.__setattr__(self, "com_o", array_of("centre of mass", self.com_o, (3,)))
        if self.posture is not None:
            object.__setattr__(self, "posture", array_of("posture of the contacts", self.posture, (None,)))
        offsets, rotations = self.points_o - self.com_o, self.rotations_oc
        stacked = np.concatenate([rotations, skew(offsets) @ rotations], axis=1).transpose(1, 0, 2)
        mean = float(np.linalg.norm(offsets, axis=1).mean())
        object.__setattr__(self, "G", read_only(stacked.reshape(6, -1)))
        object.__setattr__(self, "mean_distance", mean if mean > 0 else 1.0)

    def __len__(self) -> int:
        return len(self.contacts)

    def __reduce__(self) -> tuple[Any, ...]:
        return rebuild(self)

    def __iter__(self) -> Iterator[Contact]:
        return iter(self.contacts)

    def __getitem__(self, i: int) -> Contact:
        return self.contacts[i]

    @property
    def names(self) -> tuple[str, ...]:
        """A label per contact: the finger's name, with the link if a finger has several contacts, and a number if a
        link has several.
        """
        fingers = [c.finger for c in self.contacts]
        names = [f"{c.finger}/{c.link}" if fingers.count(c.finger) > 1 else c.finger for c in self.contacts]
        return tuple(
            f"{name} {names[: i + 1].count(name)}" if names.count(name) > 1 else name for i, name in enumerate(names)
        )

    @property
    def points_o(self) -> Array:
        """Contact points (k, 3) in the world [m]."""
        return frozen(np.array([c.point_o for c in self.contacts]))

    @property
    def rotations_oc(self) -> Array:
        """Contact frames R_oc (k, 3, 3)."""
        return frozen(np.array([c.rotation_oc for c in self.contacts]))

    def checked_moment_length(self, length: float | None = None) -> float:
        """Return the length [m] by which moments are divided, default ``mean_distance``; InvalidInput if it is
        unsuitable.
        """
        name = (
            "moment length"
            if length is not None
            else "moment length, the contacts' mean distance from the centre of mass"
        )
        length = number(name, self.mean_distance if length is None else length, at_least=1e-9, at_most=1e3, unit="m")
        farthest = float(np.abs(self.points_o - self.com_o).max(initial=0.0))
        if farthest > 1e9 * length:
            raise InvalidInput(
                f"contacts: expected within a billion moment lengths of {length:g} m, got one {farthest:.3g} m from "
                "the centre of mass"
            )
        return length


def contacts_at(
    hand: HandModel | None,
    body: Body,
    points: Mapping[str, ArrayLike] | ArrayLike,
    *,
    links: Mapping[str, Sequence[str]] | None = None,
    lengths: Mapping[str, Sequence[float | None]] | None = None,
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
    tolerance: float = 1e-3,
) -> ContactSet:
    """Return the contacts of ``hand`` on ``body`` at given points.

    A point keeps its place; its frame comes from the nearest point of the surface (on a cylinder's side: the radial
    direction). Points farther than ``tolerance`` from the surface are rejected.

    Args:
        hand: a :class:`~pinograsp.hands.HandModel`, or None to work with forces alone.
        body: a shape of :mod:`pinograsp.objects`.
        points: ``{finger: (3,) or (c, 3)}`` in the world [m], base to tip if a finger has several; with ``hand=None``
            an array (k, 3) is enough.
        links: ``{finger: [link, ...]}`` that touch, one per point. Default: one point on the last link; three points
            on the last three links.
        lengths: ``{finger: [l_c, ...]}``, distance of each contact point from the link's joint [m]. Default: the
            fingertip on a last link, and None (left to the contact phase) elsewhere.
        gravity_o: gravity (3,) [m/s^2]; orients the tangent axes (:func:`~pinograsp.spatial.tangent_frame`).
        tolerance: largest distance from the surface [m].

    Raises:
        InvalidInput: unknown finger or link, wrong shapes, or a point that is not on the surface.

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> contacts = pg.contacts_at(None, ball, [[0.03, 0, 0], [-0.03, 0, 0]])
        >>> print(contacts.names, contacts.rotations_oc[:, :, 2])  # normals into the object
        ('contact 1', 'contact 2') [[-1.  0.  0.]
         [ 1.  0.  0.]]

    See Also:
        :func:`~pinograsp.contacts.close_hand` finds contacts; :class:`~pinograsp.forces.ForceProblem` asks for their
        forces.
    """
    instance_of("hand", hand, HandModel, type(None))
    instance_of("body", body, Body)
    tolerance = number("tolerance", tolerance, at_least=0, unit="m")
    gravity = array_of("gravity", gravity_o, (3,))
    links = {} if links is None else mapping_of("links", links, "{finger: [link, ...]}")
    lengths = {} if lengths is None else mapping_of("lengths", lengths, "{finger: [length, ...]}")
    by_finger = _points_by_finger(hand, points)
    contacts = []
    for finger, given in by_finger.items():
        where = floats_of(f"contact points of {shorten(finger)}", given)
        where = array_of(f"contact points of {shorten(finger)}", where[None] if where.ndim == 1 else where, (None, 3))
        surface, normals, distances = body.project(where)
        for i, distance in enumerate(distances):
            if abs(distance) > tolerance:
                raise InvalidInput(
                    f"contact point of '{finger}' at {(1e3 * where[i]).round(3).tolist()} mm: "
                    f"{1e3 * abs(distance):.3f} mm {'inside' if distance < 0 else 'outside'} the object's surface, "
                    f"more than the tolerance of {1e3 * tolerance:g} mm; nearest surface point: "
                    f"{(1e3 * surface[i]).round(3).tolist()} mm (are the units right?)"
                )
        touching = [""] * len(where)
        reach: list[float | None] = [None] * len(where)
        if hand is not None:
            chain = hand.finger(finger)
            touching = _links_of(chain, len(where), links.get(finger))
            reach = _lengths_of(hand, chain, touching, lengths.get(finger))
        for point, normal, distance, link, length in zip(where, normals, distances, touching, reach):
            contacts.append(
                Contact(
                    finger=finger,
                    link=link,
                    point_o=read_only(point),
                    rotation_oc=read_only(tangent_frame(normal, gravity)),
                    length=length,
                    distance=float(distance),
                )
            )
    for option, named in (("links", list(links)), ("lengths", list(lengths))):
        for finger in named:
            one_of(f"finger named in {option}", finger, by_finger)
    return ContactSet(contacts=tuple(contacts), com_o=read_only(body.com_o))


def bare_contacts(points_o: Array, rotations_oc: Array, com_o: Array) -> ContactSet:
    """Contacts without a hand: at points (k, 3) [m] with frames (k, 3, 3), the centre of mass at ``com_o`` (3,) [m]."""
    return ContactSet(
        contacts=tuple(
            Contact(finger=f"contact {i + 1}", link="", point_o=point, rotation_oc=rotation, length=None, distance=0.0)
            for i, (point, rotation) in enumerate(zip(points_o, rotations_oc))
        ),
        com_o=com_o,
    )


def _points_by_finger(hand: HandModel | None, points: Mapping[str, ArrayLike] | ArrayLike) -> dict[str, ArrayLike]:
    """Contact points by the name of the finger, or of the contact where there is no hand."""
    if not isinstance(points, Mapping):
        if hand is not None:
            raise InvalidInput(f"points: expected {{finger: point}}, since a hand is given; got {shorten(points)}")
        points = {f"contact {i + 1}": point for i, point in enumerate(array_of("points", points, (None, 3)))}
    if not points:
        raise InvalidInput("points: expected at least one contact point, got none")
    return mapping_of("points", points, "{finger: point}")


def _links_of(finger: Finger, count: int, links: Sequence[str] | None) -> list[str]:
    if links is None:
        if count not in (1, 3) or count > len(finger.links):
            raise InvalidInput(
                f"finger '{finger.name}' has {count} contact points: say which links touch, "
                f"links={{'{finger.name}': [...]}} from {', '.join(finger.links)}"
            )
        return list(finger.links[-count:])
    links = items_of(f"links of finger '{finger.name}'", links, str)
    if len(links) != count:
        raise InvalidInput(f"finger '{finger.name}': expected {count} links, one per contact point, got {len(links)}")
    order = [finger.links.index(one_of(f"link of finger '{finger.name}'", link, finger.links)) for link in links]
    if any(b <= a for a, b in itertools.pairwise(order)):
        raise InvalidInput(f"finger '{finger.name}': list the touching links from base to tip, each once; got {links}")
    return list(links)


def _lengths_of(
    hand: HandModel, finger: Finger, links: list[str], lengths: Sequence[float | None] | None
) -> list[float | None]:
    given = (
        (None,) * len(links)
        if lengths is None
        else items_of(f"contact lengths of '{finger.name}'", lengths, Real, type(None))
    )
    if len(given) != len(links):
        raise InvalidInput(f"finger '{finger.name}': expected {len(links)} contact lengths, got {len(given)}")
    tip = float(np.linalg.norm(hand.model.frames[hand.frame_id(finger.tip)].placement.translation))
    reach: list[float | None] = []
    for link, length in zip(links, given):
        if length is not None:
            reach.append(number(f"contact length of '{finger.name}'", length, above=0, unit="m"))
        elif link != finger.links[-1]:
            reach.append(None)
        elif tip > 0:
            reach.append(tip)
        else:
            raise InvalidInput(
                f"finger '{finger.name}' has no fingertip frame beyond its last joint: give the contact length, "
                f"lengths={{'{finger.name}': [...]}}"
            )
    return reach
