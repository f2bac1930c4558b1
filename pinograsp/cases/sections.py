"""The sections of a case file and their checks."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from pinograsp import defaults
from pinograsp.checks import in_brief
from pinograsp.contacts import (
    ContactSet,
    DecelerationShape,
    Friction,
    FrictionModel,
    MarhefkaOrin,
    Measure,
)
from pinograsp.contacts.friction import default_friction
from pinograsp.forces import ObjectiveName, available_solvers
from pinograsp.forces.solve.solver_order import AT_HAND
from pinograsp.hands.load import Masses
from pinograsp.plan.parts import FRICTION_TRAITS
from pinograsp.planner import Search

# What the forces minimise, as case files call it.
Objective: TypeAlias = ObjectiveName

# Sizes of numbers: grasps of hands are well within, and computations cannot overflow or underflow.
_SMALLEST, _LARGEST = 1e-12, 1e12
_MOST_VALUES, _MOST_CELLS = 10_000, 1_000_000  # of a grid: along one axis; impact times x accelerations


def _check_increasing(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"lower bound {pair[0]:g} is above upper bound {pair[1]:g}")
    return pair


def _reasonable(value: float) -> float:
    if abs(value) > _LARGEST or 0 < abs(value) < _SMALLEST:
        raise ValueError(f"expected 0 or a size from {_SMALLEST:g} to {_LARGEST:g}")
    return value


def _there(name: str) -> str:
    if name not in AT_HAND and name not in available_solvers():
        raise ValueError(f"expected one of {', '.join(available_solvers())}")
    return name


Solver = Annotated[str, AfterValidator(_there)]
Number = Annotated[float, AfterValidator(_reasonable)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_reasonable)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_reasonable)]
Vector = tuple[Number, Number, Number]
Range = Annotated[tuple[Positive, Positive], AfterValidator(_check_increasing)]
Angles = dict[str, tuple[Number, ...]]


NAME, LONGEST_NAME = r"^\w[\w.-]*$", 100  # of a case: it becomes the name of a folder


class CaseSection(BaseModel):
    """A section of a case file: unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __repr__(self) -> str:
        return in_brief(self, type(self).model_fields)

    def __str__(self) -> str:
        return repr(self)


_READING = {
    *("root", "palm", "fingers", "packages", "xacro_args", "trusted", "masses", "hulls", "exclude", "srdf", "drives"),
    "posture",
}


class HandSection(CaseSection):
    """The hand: its file, placement, limits, and how the file is read (see :func:`~pinograsp.hands.load_hand`)."""

    source: str
    position_mm: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Vector = (0.0, 0.0, 0.0)
    root: str | None = None
    palm: str | None = None
    fingers: dict[str, str] | None = None
    limits_deg: dict[str, tuple[Number, Number]] = {}
    hulls: bool = True
    packages: dict[str, str] = {}
    xacro_args: dict[str, Any] = {}
    trusted: bool = False
    masses: Masses = "estimate"
    exclude: list[str] = []
    srdf: str | None = None
    drives: str | None = None
    posture: dict[str, Number] = {}


def read_hand_settings(section: BaseModel, folder: Path) -> dict[str, Any]:
    """How a section says that a hand's file is read, by the names of :func:`~pinograsp.hands.load_hand`; relative paths
    start at ``folder``.
    """
    settings = section.model_dump(include=_READING)
    settings["packages"] = {name: str(folder / Path(one).expanduser()) for name, one in settings["packages"].items()}
    if settings["srdf"] is not None:
        settings["srdf"] = str(folder / Path(settings["srdf"]).expanduser())
    if settings["drives"] is not None and settings["drives"].endswith(".toml"):
        settings["drives"] = str(folder / Path(settings["drives"]).expanduser())
    return settings


def find_source(source: str, folder: Path) -> str:
    """A hand's file in ``folder``, or its name where there is none."""
    beside = folder / source
    return str(beside) if os.path.isfile(beside) else source


class ObjectSection(CaseSection):
    """A sphere or a cylinder; the position is the centre of mass."""

    shape: Literal["cylinder", "sphere"]
    radius_mm: Positive
    height_mm: Positive | None = None
    mass: Positive
    position_mm: Vector = (0.0, 0.0, 0.0)
    rpy_deg: Vector = (0.0, 0.0, 0.0)

    @model_validator(mode="after")
    def _height_fits_shape(self) -> ObjectSection:
        if (self.shape == "cylinder") != (self.height_mm is not None):
            raise ValueError("height_mm is needed for a cylinder, and not accepted for other shapes")
        return self


class ContactSection(CaseSection):
    """One contact: finger and point; where a finger has several contacts, also the touching link and its length."""

    finger: str
    point_mm: Vector
    link: str | None = None
    length_mm: Positive | None = None


class FrictionSection(CaseSection):
    """Friction: ``safety`` divides mu; ``torsion_mm`` is the largest moment per newton of normal force.

    ``model``: None: as :class:`~pinograsp.forces.ForceProblem` chooses it; the grids' pyramid where they search.
    """

    mu: NotNegative
    model: FrictionModel | None = None
    edges: Annotated[int, Field(ge=4, le=128, multiple_of=2)] = 4
    safety: Annotated[float, Field(ge=1, le=1000)] = 1.0
    torsion_mm: NotNegative = 0.0

    @model_validator(mode="after")
    def _soft_fingers_have_torsion(self) -> FrictionSection:
        if self.model is not None and FRICTION_TRAITS[self.model].elliptic and self.torsion_mm == 0:
            raise ValueError(f"model '{self.model}' needs torsion_mm above 0")
        return self

    def of(self, contacts: ContactSet, search: Search) -> Friction:
        """The friction model at these contacts."""
        given: dict[str, Any] = {"edges": self.edges, "safety": self.safety}
        if self.torsion_mm:
            given["torsion"] = 1e-3 * self.torsion_mm
        if self.model is not None:
            return Friction(model=self.model, **given)
        by_default = search == "convex"  # grids know the paper's pyramid alone
        return replace(default_friction(c.finger for c in contacts) if by_default else Friction(), **given)


class ComplianceSection(CaseSection):
    """The contact law: stiffness [N/m^exponent], damping [N s/m^(exponent + 1)], exponent."""

    stiffness: Positive = MarhefkaOrin().stiffness
    damping: NotNegative = MarhefkaOrin().damping
    exponent: Annotated[float, Field(ge=0.5, le=10)] = MarhefkaOrin().exponent


class DecelerationSection(CaseSection):
    """Shape of the deceleration over the grasp phase: exactly one of the three."""

    linear: tuple[Number, Number] | None = None
    polynomial: Annotated[tuple[Number, ...], Field(max_length=20)] | None = None
    sampled: Annotated[tuple[Number, ...], Field(max_length=10_000)] | None = None

    @model_validator(mode="after")
    def _one_shape(self) -> DecelerationSection:
        if sum(v is not None for v in (self.linear, self.polynomial, self.sampled)) != 1:
            raise ValueError("give one of linear, polynomial and sampled")
        return self

    def shape(self) -> DecelerationShape:
        """The shape that the section describes."""
        if self.linear is not None:
            return DecelerationShape.linear(*self.linear)
        if self.polynomial is not None:
            return DecelerationShape.polynomial(self.polynomial)
        return DecelerationShape.from_samples(() if self.sampled is None else self.sampled)


class LimitsSection(CaseSection):
    """Eqs. (13) and (14); force caps, torque limits and decelerations that are not constant need the convex search."""

    final_time: Positive = defaults.FINAL_TIME
    impact_time: Range = defaults.IMPACT_TIMES
    acceleration: Range = defaults.ACCELERATIONS
    max_speed: Positive = defaults.MAX_SPEED
    max_depth_mm: Positive = 1e3 * defaults.MAX_DEPTH
    max_normal_force: Positive | None = None
    torque_limit: Positive | Literal["effort"] | None = None
    deceleration: Literal["constant"] | DecelerationSection = "constant"

    @model_validator(mode="after")
    def _impact_before_end(self) -> LimitsSection:
        if self.impact_time[1] >= self.final_time:
            raise ValueError(f"impact_time {self.impact_time[1]:g} s must lie before final_time {self.final_time:g} s")
        return self


class ForcesSection(CaseSection):
    """The search for the forces, and its objective."""

    search: Search = "hybrid"
    balance: Literal["force", "wrench"] = "wrench"
    measure: Measure = "impulse"
    objective: Objective | dict[Objective, NotNegative] | None = None
    solver: Solver = "auto"
    moment_length_mm: Positive | None = None


class Steps(CaseSection):
    """start, start + step, ... up to stop."""

    start: Number
    stop: Number
    step: Positive

    @model_validator(mode="after")
    def _not_too_many(self) -> Steps:
        if self.count > _MOST_VALUES:
            raise ValueError(f"expected at most {_MOST_VALUES} values, got {self.count:.3g}: use a larger step")
        return self

    @property
    def count(self) -> float:
        """Number of values, before rounding."""
        return max(0.0, (self.stop - self.start) / self.step + 1)


Several = Annotated[tuple[Number, ...], Field(max_length=_MOST_VALUES)]


class GridSection(CaseSection):
    """The paper's grid: impact times [s], accelerations [m/s^2], multipliers."""

    impact_times: Steps | Several = Steps(start=0.80, stop=0.95, step=0.05)
    accelerations: Steps | Several = Steps(start=0.01, stop=1.0, step=0.005)
    multipliers: Steps | Several = Steps(start=-1.0, stop=1.0, step=0.1)
    residual_limit: NotNegative = 0.1

    @model_validator(mode="after")
    def _not_too_many(self) -> GridSection:
        times, accelerations = (
            values.count if isinstance(values, Steps) else len(values)
            for values in (self.impact_times, self.accelerations)
        )
        if times * accelerations > _MOST_CELLS:
            raise ValueError(
                f"expected at most {_MOST_CELLS} pairs of impact time and acceleration, got {times * accelerations:.3g}"
            )
        return self


class MotionSection(CaseSection):
    """Postures and sampling.

    ``touch`` says which point of a link meets its contact point: ``"length"``, the point at length l_c on the line
    along the link (the paper); or ``"surface"``, a point of its surface, which simulations need.
    """

    touch: Literal["length", "surface"] = "length"
    posture_deg: Angles = {}
    start_deg: Angles = {}
    spread_deg: NotNegative = 3.0
    samples: Annotated[int, Field(ge=1, le=1000)] = 13
    time_step: Annotated[float, Field(ge=1e-5, le=0.1)] = 1e-3
    acceleration_at_start: Literal["rest", "paper"] = "rest"
