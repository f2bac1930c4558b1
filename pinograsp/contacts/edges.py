"""Edges of an object: which contacts lie on them, and which a small error turns there."""

from __future__ import annotations

import numpy as np

from pinograsp.checks import array_of, instance_of
from pinograsp.contacts.contact_set import ContactSet
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array, BoolArray

# Edges: points so near [m], so many of them, and the turns of normals [rad] that count as an edge and as the same.
ASIDE, _AROUND, TURNED, _SAME = 1e-3, 12, np.radians(25.0), np.radians(10.0)
# The nearest point of the surface is the same one up to this share of the depth, and to this rounding [m].
_LIKE, _EXACT = 0.05, 1e-5


def on_edges(body: Body, contacts: ContactSet) -> BoolArray:
    """Which contacts (k,) lie on an edge, a rim or a corner of the object.

    Where the surface turns by more than 25 deg within 1 mm of the point. Points of a link that faces the object flat,
    with another point of the same normal, are not: its area decides, not its corners.
    """
    instance_of("body", body, Body)
    instance_of("contacts", contacts, ContactSet)
    return np.asarray(turns_nearby(body, contacts.points_o, contacts.rotations_oc[:, :, 2]) & ~_flat(contacts))


def turns_nearby(body: Body, points: Array, normals: Array, aside: float = ASIDE) -> BoolArray:
    """Whether the object's surface turns by more than 25 deg from the normals (k, 3) within ``aside`` [m] of points
    (k, 3).
    """
    return np.asarray(_look_around(body, points, normals, aside).min(axis=1) < np.cos(TURNED))


def _look_around(body: Body, points: Array, normals: Array, aside: float = ASIDE) -> Array:
    """Cosines (k, a) between the normals (k, 3) and those of the surface ``aside`` [m] round points (k, 3)."""
    turn = np.linspace(0, 2 * np.pi, _AROUND, endpoint=False)
    circle = aside * np.column_stack([np.cos(turn), np.sin(turn)])
    around = points[:, None] + np.einsum("kij,aj->kai", tangents(normals), circle)
    seen = body.project(around.reshape(-1, 3))[1].reshape(len(points), _AROUND, 3)
    return np.asarray(np.einsum("kai,ki->ka", seen, normals))


def sharp_contacts(body: Body, contacts: ContactSet) -> BoolArray:
    """Which contacts (k,) a small error turns: on edges of the object, unless a face of the link steadies them."""
    steadied = np.array([contact.sharp is False for contact in contacts])
    return np.asarray(on_edges(body, contacts) & ~steadied)


def past_edges(body: Body, contacts: ContactSet, depths: Array) -> BoolArray:
    """Which contacts (k,) press so deep, ``depths`` (k,) [m], that another face of the object is nearer than their own.

    Near an edge, or through half of a thin plate: what is pressed there gives way sideways. Points of a link that faces
    the object flat are not, as for :func:`on_edges`; nor are those on an edge with a normal between its faces'.
    """
    instance_of("body", body, Body)
    instance_of("contacts", contacts, ContactSet)
    points, normals = np.array([contact.point_o for contact in contacts]), contacts.rotations_oc[:, :, 2]
    depths = array_of("depths", depths, (len(points),))
    nearest = body.project(points + depths[:, None] * normals)[0]
    moved = np.linalg.norm(nearest - points, axis=1)
    between = _look_around(body, points, normals).max(axis=1) < np.cos(_SAME)
    return np.asarray((moved > np.maximum(_LIKE * depths, _EXACT)) & ~_flat(contacts) & ~between)


def _flat(contacts: ContactSet) -> BoolArray:
    """Which contacts (k,) share their link and their normal with another one."""
    links, normals = np.array([contact.link for contact in contacts]), contacts.rotations_oc[:, :, 2]
    flat = (links[:, None] == links) & (normals @ normals.T > np.cos(_SAME))
    return np.asarray(flat.sum(axis=1) > 1)
