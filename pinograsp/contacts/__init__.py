"""Contacts: frames and grasp map, the compliant contact law and its energies."""

from pinograsp.contacts.clearance import (
    PALM,
    check_geometry,
    clearance,
)
from pinograsp.contacts.closing import close_hand
from pinograsp.contacts.closure import ClosingPath, Closure, Touch
from pinograsp.contacts.compliance import MEASURES, Compliance, MarhefkaOrin, Measure
from pinograsp.contacts.contact_set import Contact, ContactSet, contacts_at
from pinograsp.contacts.deceleration import DecelerationShape
from pinograsp.contacts.friction import FRICTION_MODELS, Friction
from pinograsp.contacts.hertz import hertz
from pinograsp.contacts.measured import MeasuredCompliance, law_of
from pinograsp.contacts.penetration import touching
from pinograsp.contacts.penetration_profile import PenetrationProfile
from pinograsp.contacts.posture import PostureContacts, contacts_of
from pinograsp.contacts.synergy import open_and_closed
from pinograsp.contacts.tips import fingertips, link_centre
from pinograsp.plan.parts import FrictionModel

__all__ = [
    "FRICTION_MODELS",
    "MEASURES",
    "PALM",
    "ClosingPath",
    "Closure",
    "Compliance",
    "Contact",
    "ContactSet",
    "DecelerationShape",
    "Friction",
    "FrictionModel",
    "MarhefkaOrin",
    "Measure",
    "MeasuredCompliance",
    "PenetrationProfile",
    "PostureContacts",
    "Touch",
    "check_geometry",
    "clearance",
    "close_hand",
    "contacts_at",
    "contacts_of",
    "fingertips",
    "hertz",
    "law_of",
    "link_centre",
    "open_and_closed",
    "touching",
]
