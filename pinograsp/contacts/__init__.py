"""Contacts: frames and grasp map, the compliant contact law and its energies."""

from pinograsp.contacts.compliance import Compliance, PenetrationProfile, energy_terms, impulse_energy, work_energy
from pinograsp.contacts.contact_set import Contact, ContactSet, contacts_at
from pinograsp.contacts.deceleration import DecelerationShape
from pinograsp.contacts.friction import FRICTION_MODELS, Friction

__all__ = [
    "FRICTION_MODELS",
    "Compliance",
    "Contact",
    "ContactSet",
    "DecelerationShape",
    "Friction",
    "PenetrationProfile",
    "contacts_at",
    "energy_terms",
    "impulse_energy",
    "work_energy",
]
