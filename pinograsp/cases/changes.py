"""What can be changed of a case, for type checkers and completion."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Literal, TypedDict

from pinograsp.contacts import FrictionModel, Measure
from pinograsp.contacts.quality import Balance
from pinograsp.forces import ObjectiveName, SolverName
from pinograsp.hands.load import Masses
from pinograsp.planner import Search

Numbers = Sequence[float]
Values = Mapping[str, float | Numbers] | Numbers  # start, stop and step; or each

# Every key of a case file that has a name of its own; those of single contacts, fingers and joints are given as texts.
CaseChanges = TypedDict(
    "CaseChanges",
    {
        "name": str,
        "assumed": Mapping[str, str],
        "gravity": Numbers,
        "reserve": Mapping[str, float] | str | None,
        "contacts": Sequence[Mapping[str, object]],
        "hand": Mapping[str, object],
        "hand.source": str,
        "hand.position_mm": Numbers,
        "hand.rpy_deg": Numbers,
        "hand.root": str | None,
        "hand.palm": str | None,
        "hand.fingers": Mapping[str, str] | None,
        "hand.limits_deg": Mapping[str, Numbers],
        "hand.hulls": bool,
        "hand.packages": Mapping[str, str],
        "hand.xacro_args": Mapping[str, object],
        "hand.trusted": bool,
        "hand.masses": Masses,
        "hand.exclude": Sequence[str],
        "hand.srdf": str | None,
        "hand.drives": str | None,
        "hand.posture": Mapping[str, float],
        "object": Mapping[str, object],
        "object.shape": Literal["cylinder", "sphere"],
        "object.radius_mm": float,
        "object.height_mm": float | None,
        "object.mass": float,
        "object.position_mm": Numbers,
        "object.rpy_deg": Numbers,
        "friction": Mapping[str, object],
        "friction.mu": float,
        "friction.model": FrictionModel,
        "friction.edges": int,
        "friction.safety": float,
        "friction.torsion_mm": float,
        "compliance": Mapping[str, object],
        "compliance.stiffness": float,
        "compliance.damping": float,
        "compliance.exponent": float,
        "limits": Mapping[str, object],
        "limits.final_time": float,
        "limits.impact_time": Numbers,
        "limits.acceleration": Numbers,
        "limits.max_speed": float,
        "limits.max_depth_mm": float,
        "limits.max_normal_force": float | None,
        "limits.torque_limit": float | Literal["effort"] | None,
        "limits.deceleration": Literal["constant"] | Mapping[str, Numbers],
        "forces": Mapping[str, object],
        "forces.search": Search,
        "forces.balance": Balance,
        "forces.measure": Measure,
        "forces.objective": ObjectiveName | Mapping[ObjectiveName, float] | None,
        "forces.solver": SolverName,
        "forces.moment_length_mm": float | None,
        "grid": Mapping[str, object],
        "grid.impact_times": Values,
        "grid.accelerations": Values,
        "grid.multipliers": Values,
        "grid.residual_limit": float,
        "motion": Mapping[str, object],
        "motion.touch": Literal["length", "surface"],
        "motion.posture_deg": Mapping[str, Numbers],
        "motion.start_deg": Mapping[str, Numbers],
        "motion.spread_deg": float,
        "motion.samples": int,
        "motion.time_step": float,
        "motion.acceleration_at_start": Literal["rest", "paper"],
    },
    total=False,
)
