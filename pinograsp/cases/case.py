"""The case file: YAML in, checked values out, and the objects that they describe."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np
from pydantic import AfterValidator, BaseModel, ConfigDict, Field, model_validator

from pinograsp import defaults
from pinograsp.cases.changes import CaseChanges
from pinograsp.cases.reading import changes_of, check_extent, put_value, read_mapping, validated
from pinograsp.checks import in_brief, instance_of, number, path_of
from pinograsp.contacts import (
    ContactSet,
    DecelerationShape,
    Friction,
    FrictionModel,
    MarhefkaOrin,
    Measure,
    contacts_at,
    touching,
)
from pinograsp.contacts.friction import default_friction
from pinograsp.errors import CaseRejected
from pinograsp.forces import ForceProblem, GridSpec, ObjectiveName, available_solvers, grid_values
from pinograsp.hands import HandModel, load_hand
from pinograsp.hands.load import Masses
from pinograsp.motion import MotionSpec
from pinograsp.objects import Cylinder, Sphere
from pinograsp.planner import GraspPlan, PlanOptions, Search, plan_grasp
from pinograsp.spatial import Array, pose_of, rotation_rpy

# What the forces minimise, as case files call it.
Objective: TypeAlias = ObjectiveName

_AS_IT_IS: CaseChanges = {}
_BIGGEST = 1_000_000  # bytes; a case file is a page of text
# Sizes of numbers: grasps of hands are well within, and computations cannot overflow or underflow.
_SMALLEST, _LARGEST = 1e-12, 1e12
_MOST_STEPS = 200_000  # of the motion
_LONGEST_NAME = 100  # it becomes the name of a folder
_MOST_VALUES, _MOST_CELLS = 10_000, 1_000_000  # of a grid: along one axis; impact times x accelerations


def _increasing(pair: tuple[float, float]) -> tuple[float, float]:
    if pair[0] > pair[1]:
        raise ValueError(f"lower bound {pair[0]:g} is above upper bound {pair[1]:g}")
    return pair


def _reasonable(value: float) -> float:
    if abs(value) > _LARGEST or 0 < abs(value) < _SMALLEST:
        raise ValueError(f"expected 0 or a size from {_SMALLEST:g} to {_LARGEST:g}")
    return value


def _there(name: str) -> str:
    if name not in available_solvers():
        raise ValueError(f"expected one of {', '.join(available_solvers())}")
    return name


Solver = Annotated[str, AfterValidator(_there)]
Number = Annotated[float, AfterValidator(_reasonable)]
Positive = Annotated[float, Field(gt=0), AfterValidator(_reasonable)]
NotNegative = Annotated[float, Field(ge=0), AfterValidator(_reasonable)]
Vector = tuple[Number, Number, Number]
Range = Annotated[tuple[Positive, Positive], AfterValidator(_increasing)]
Angles = dict[str, tuple[Number, ...]]


class Section(BaseModel):
    """A section of a case file: unknown keys and numbers that are not finite are refused."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    def __repr__(self) -> str:
        return in_brief(self, type(self).model_fields)

    def __str__(self) -> str:
        return repr(self)


class HandSection(Section):
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
    posture: dict[str, Number] = {}


class ObjectSection(Section):
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


class ContactSection(Section):
    """One contact: finger and point; where a finger has several contacts, also the touching link and its length."""

    finger: str
    point_mm: Vector
    link: str | None = None
    length_mm: Positive | None = None


class FrictionSection(Section):
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
        if self.model == "soft" and self.torsion_mm == 0:
            raise ValueError("model 'soft' needs torsion_mm above 0")
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


class ComplianceSection(Section):
    """The contact law: stiffness [N/m^exponent], damping [N s/m^(exponent + 1)], exponent."""

    stiffness: Positive = MarhefkaOrin().stiffness
    damping: NotNegative = MarhefkaOrin().damping
    exponent: Annotated[float, Field(ge=0.5, le=10)] = MarhefkaOrin().exponent


class DecelerationSection(Section):
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
        return DecelerationShape.sampled(() if self.sampled is None else self.sampled)


class LimitsSection(Section):
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


class ForcesSection(Section):
    """The search for the forces, and its objective."""

    search: Search = "hybrid"
    balance: Literal["force", "wrench"] = "wrench"
    measure: Measure = "impulse"
    objective: Objective | dict[Objective, NotNegative] | None = None
    solver: Solver = "auto"
    moment_length_mm: Positive | None = None


class Steps(Section):
    """start, start + step, ... up to stop."""

    start: Number
    stop: Number
    step: Positive

    @model_validator(mode="after")
    def _not_too_many(self) -> Steps:
        if self.count > _MOST_VALUES:
            raise ValueError(f"expected at most {_MOST_VALUES} values, got {self.count:.3g}: take a larger step")
        return self

    @property
    def count(self) -> float:
        """Number of values, before rounding."""
        return max(0.0, (self.stop - self.start) / self.step + 1)


Several = Annotated[tuple[Number, ...], Field(max_length=_MOST_VALUES)]


class GridSection(Section):
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


class MotionSection(Section):
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


class Case(Section):
    """A case. Relative paths start at ``folder``, the case file's own."""

    schema_: Literal[1] = Field(1, alias="schema")
    name: str = Field(pattern=r"^\w[\w.-]*$", max_length=_LONGEST_NAME)
    hand: HandSection
    object: ObjectSection
    contacts: tuple[ContactSection, ...] = Field(min_length=1, max_length=200)
    friction: FrictionSection
    gravity: Vector = defaults.GRAVITY
    compliance: ComplianceSection = ComplianceSection()
    limits: LimitsSection = LimitsSection()
    forces: ForcesSection = ForcesSection()
    grid: GridSection = GridSection()
    motion: MotionSection = MotionSection()
    assumed: dict[str, str] = {}
    folder: Path = Field(Path("."), exclude=True)

    def __repr__(self) -> str:
        where = f"hand={self.hand.source!r:.60}, object={self.object.shape!r}, contacts={len(self.contacts)}"
        return (
            f"{type(self).__name__}(name={self.name!r:.60}, {where}, search={self.forces.search!r}, "
            f"balance={self.forces.balance!r})"
        )

    @model_validator(mode="after")
    def _not_too_many_steps(self) -> Case:
        steps = self.limits.final_time / self.motion.time_step
        if steps > _MOST_STEPS:
            raise ValueError(
                f"limits.final_time, motion.time_step: expected at most {_MOST_STEPS} steps, got {steps:.3g}"
            )
        return self

    def settings(self) -> dict[str, Any]:
        """The case as plain values with all defaults, as a run's file records it."""
        return self.model_dump(mode="json", by_alias=True)

    def load_hand(self) -> HandModel:
        """The hand, placed, with the case's limits."""
        h = self.hand
        beside = self.folder / h.source
        return load_hand(
            beside if os.path.isfile(beside) else h.source,
            pose=pose_of(1e-3 * np.array(h.position_mm), rotation_rpy(*np.radians(h.rpy_deg))),
            root=h.root,
            palm=h.palm,
            fingers=h.fingers,
            limits={joint: (math.radians(low), math.radians(high)) for joint, (low, high) in h.limits_deg.items()},
            hulls=h.hulls,
            packages={name: self.folder / Path(folder).expanduser() for name, folder in h.packages.items()},
            trusted=h.trusted,
            masses=h.masses,
            exclude=h.exclude,
            srdf=None if h.srdf is None else self.folder / Path(h.srdf).expanduser(),
            posture=h.posture,
            xacro_args=h.xacro_args,
        )

    def make_object(self) -> Cylinder | Sphere:
        """The object, placed."""
        o = self.object
        pose = pose_of(1e-3 * np.array(o.position_mm), rotation_rpy(*np.radians(o.rpy_deg)))
        if o.shape == "sphere":
            return Sphere(radius=1e-3 * o.radius_mm, mass=o.mass, pose=pose)
        return Cylinder(
            radius=1e-3 * o.radius_mm, height=1e-3 * number("height_mm", o.height_mm), mass=o.mass, pose=pose
        )

    def make_contacts(self, hand: HandModel) -> ContactSet:
        """The contacts of ``hand`` on the object."""
        instance_of("hand", hand, HandModel)
        points: dict[str, list[Array]] = {}
        links: dict[str, list[str | None]] = {}
        lengths: dict[str, list[float | None]] = {}
        for contact in self.contacts:
            points.setdefault(contact.finger, []).append(1e-3 * np.array(contact.point_mm))
            links.setdefault(contact.finger, []).append(contact.link)
            lengths.setdefault(contact.finger, []).append(
                None if contact.length_mm is None else 1e-3 * contact.length_mm
            )
        named = {finger: [link for link in own if link is not None] for finger, own in links.items()}
        for finger, own in links.items():
            if 0 < len(named[finger]) < len(own):
                raise CaseRejected(
                    f"case '{self.name}': finger '{finger}': expected the link of all its contacts or of none"
                )
        contacts = contacts_at(
            hand,
            self.make_object(),
            {finger: np.array(own) for finger, own in points.items()},
            links={finger: own for finger, own in named.items() if own},
            lengths={finger: given for finger, given in lengths.items() if any(v is not None for v in given)},
            gravity_o=self.gravity,
        )
        if self.motion.touch == "length":
            return contacts
        return touching(hand, self.make_object(), contacts, hand.configuration(_radians(self.motion.posture_deg)))

    def make_problem(self, hand: HandModel) -> ForceProblem:
        """The force problem of ``hand`` holding the object."""
        length, contacts = self.forces.moment_length_mm, self.make_contacts(hand)
        return ForceProblem.holding(
            self.make_object(),
            contacts,
            gravity_o=self.gravity,
            mu=self.friction.mu,
            friction=self.friction.of(contacts, self.forces.search),
            compliance=MarhefkaOrin(**self.compliance.model_dump()),
            balance=self.forces.balance,
            measure=self.forces.measure,
            final_time=self.limits.final_time,
            impact_time_range=self.limits.impact_time,
            acceleration_range=self.limits.acceleration,
            max_speed=self.limits.max_speed,
            max_depth=1e-3 * self.limits.max_depth_mm,
            max_normal_force=self.limits.max_normal_force,
            shape=DecelerationShape.constant()
            if self.limits.deceleration == "constant"
            else self.limits.deceleration.shape(),
            moment_length=None if length is None else 1e-3 * length,
        )

    def make_grid(self) -> GridSpec:
        """The search grid."""

        def values(spec: Steps | tuple[float, ...]) -> Array:
            return np.array(grid_values(spec.start, spec.stop, spec.step) if isinstance(spec, Steps) else spec)

        return GridSpec(
            impact_times=values(self.grid.impact_times),
            accelerations=values(self.grid.accelerations),
            multipliers=values(self.grid.multipliers),
            residual_limit=self.grid.residual_limit,
        )

    def make_motion(self) -> MotionSpec:
        """Postures and sampling of the motion."""
        m = self.motion
        return MotionSpec(
            posture=_radians(m.posture_deg),
            start=_radians(m.start_deg),
            spread=float(np.radians(m.spread_deg)),
            samples=m.samples,
            time_step=m.time_step,
            acceleration_at_start=m.acceleration_at_start,
        )

    def plan(self, *, progress: bool | None = None) -> GraspPlan:
        """Plan the case: see :func:`~pinograsp.planner.plan_grasp`."""
        hand = self.load_hand()
        options = PlanOptions(
            grid=self.make_grid(),
            search=self.forces.search,
            solver=self.forces.solver,
            objective=self.forces.objective,
            motion=self.make_motion(),
        )
        limit = self.limits.torque_limit
        plan = plan_grasp(hand, self.make_problem(hand), options, torque_limit=limit, progress=progress)
        return replace(plan, settings=self.settings())


def _radians(angles_deg: Angles) -> dict[str, Array]:
    return {finger: np.radians(np.array(angles)) for finger, angles in angles_deg.items()}


def builtin_cases() -> list[str]:
    """Names of the built-in cases."""
    return sorted(path.stem for path in Path(__file__).parent.glob("*.yaml"))


def load_case(source: str | Path, changes: CaseChanges = _AS_IT_IS, *, texts: Sequence[str] = ()) -> Case:
    """A case by name or from a YAML file, with some values changed.

    Args:
        source: a built-in case's name (``"paper"``) or a path.
        changes: values by key, ``{"object.mass": 1.1}``.
        texts: the same as people type it, ``["object.mass=1.1"]``, read as YAML; after ``changes``.

    Raises:
        CaseRejected: unknown case, broken YAML, unknown keys or unusable values: all of them named at once; a file
            that says that its hand's file may run code.
    """
    name = source if isinstance(source, str) else str(path_of("case", source))
    path = Path(__file__).parent / f"{name}.yaml" if name in builtin_cases() else Path(name)
    wanted = f"a YAML file or one of: {', '.join(builtin_cases())}"
    data = read_mapping(path, "case", name, wanted, _BIGGEST, "hand, object, contacts...")
    if isinstance(data.get("hand"), dict) and data["hand"].get("trusted", False) is not False:
        raise CaseRejected(
            f"case '{name}': hand.trusted: no file can say so itself: give it where the case is opened "
            "(--set hand.trusted=true, {'hand.trusted': True})"
        )
    for key, value in changes_of(changes, texts).items():
        put_value(data, key, value)
    check_extent(data, f"case '{name}'")
    if "folder" in data:
        raise CaseRejected(f"case '{name}': folder: unknown key")
    return validated(Case, {**data, "folder": path.resolve().parent}, f"case '{name}'")


def with_changes(case: Case, changes: Mapping[str, object]) -> Case:
    """``case`` with some values changed; keys and errors as in :func:`load_case`."""
    data = case.settings()
    for key, value in changes.items():
        put_value(data, key, value)
    return validated(Case, {**data, "folder": case.folder}, f"case '{case.name}'")
