"""Actuation: how drives and contacts change a squeeze: quasi-static maps, stability, bands of the forces."""

from pinograsp.actuation.bands import (
    FACTORS,
    ForceBand,
    GainLimit,
    drive_scenarios,
    force_band,
    gains_within,
    stiffness_scenarios,
)
from pinograsp.actuation.compliant_hand import CompliantHand
from pinograsp.actuation.quasistatic import QuasistaticMaps, contact_stiffness, quasistatic_maps
from pinograsp.actuation.stability import ObjectStiffness, object_stiffness

__all__ = [
    "FACTORS",
    "CompliantHand",
    "ForceBand",
    "GainLimit",
    "ObjectStiffness",
    "QuasistaticMaps",
    "contact_stiffness",
    "drive_scenarios",
    "force_band",
    "gains_within",
    "object_stiffness",
    "quasistatic_maps",
    "stiffness_scenarios",
]
