"""Contacts that a small error changes much: on edges of the object, and where a link is hollow behind its hull."""

from __future__ import annotations

from pinograsp.contacts.clearance import HOLLOW, behind_hulls
from pinograsp.contacts.contact_set import ContactSet
from pinograsp.contacts.edges import sharp_contacts
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

DOUBTFUL = 0.05  # share of the normal forces that a grasp may have there


def doubtful_share(hand: HandModel, body: Body, contacts: ContactSet, normal_forces: Array) -> float:
    """Share [-] of normal forces (k,) that act on edges of the object, or where a link is hollow."""
    doubtful = sharp_contacts(body, contacts) | (behind_hulls(hand, contacts) > HOLLOW)
    return float(normal_forces[doubtful].sum() / normal_forces.sum())
