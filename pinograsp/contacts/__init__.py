"""Contacts: frames and grasp map, the compliant contact law and its energies."""

from pinograsp.contacts.compliance import Compliance, PenetrationProfile, impulse_energy, work_energy
from pinograsp.contacts.contact_set import Contact, ContactSet, contacts_at

__all__ = [
    "Compliance",
    "Contact",
    "ContactSet",
    "PenetrationProfile",
    "contacts_at",
    "impulse_energy",
    "work_energy",
]
