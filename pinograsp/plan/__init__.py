"""A grasp plan, the failure of a search, and a simulation, as data."""

from pinograsp.plan.link_contacts import LinkContacts
from pinograsp.plan.motion import Motion
from pinograsp.plan.parts import (
    ComparisonRow,
    ContactLaw,
    Layout,
    PlanCertificate,
    PlanContacts,
    PlanForces,
    PlanFriction,
    PlanGrid,
    PlanMargins,
    PlanReserve,
    Reach,
    StiffnessBand,
)
from pinograsp.plan.record import PlanFailure, PlanRecord, Proof
from pinograsp.plan.simulation import History, Simulation, Verdict
from pinograsp.plan.tolerance import PoseError, PoseTolerance

__all__ = [
    "ComparisonRow",
    "ContactLaw",
    "History",
    "Layout",
    "LinkContacts",
    "Motion",
    "PlanCertificate",
    "PlanContacts",
    "PlanFailure",
    "PlanForces",
    "PlanFriction",
    "PlanGrid",
    "PlanMargins",
    "PlanRecord",
    "PlanReserve",
    "PoseError",
    "PoseTolerance",
    "Proof",
    "Reach",
    "Simulation",
    "StiffnessBand",
    "Verdict",
]
