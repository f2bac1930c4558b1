"""The case file: YAML in, checked values out, and the objects that they describe."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field, model_validator

from pinograsp import defaults
from pinograsp.cases.changes import CaseChanges
from pinograsp.cases.object_case import ObjectCase
from pinograsp.cases.reading import change_values, check_extent, read_changes, read_mapping, validate
from pinograsp.cases.reserve_section import ReserveOrText
from pinograsp.cases.sections import (
    LONGEST_NAME,
    NAME,
    Angles,
    CaseSection,
    ComplianceSection,
    ContactSection,
    ForcesSection,
    FrictionSection,
    GridSection,
    HandSection,
    LimitsSection,
    MotionSection,
    ObjectSection,
    Steps,
    Vector,
    find_source,
    read_hand_settings,
)
from pinograsp.checks import instance_of, number, path_of
from pinograsp.contacts import (
    ContactSet,
    DecelerationShape,
    MarhefkaOrin,
    contacts_at,
    touching,
)
from pinograsp.errors import CaseRejected
from pinograsp.forces import ForceProblem, GridSpec, grid_values
from pinograsp.hands import HandModel, load_hand
from pinograsp.motion import MotionSpec
from pinograsp.objects import Cylinder, Sphere
from pinograsp.planner import GraspPlan, PlanOptions, plan_grasp
from pinograsp.spatial import Array, pose_of, rotation_rpy

_AS_IT_IS: CaseChanges = {}
_BIGGEST = 1_000_000  # bytes; a case file is a page of text
_MOST_STEPS = 200_000  # of the motion


class Case(CaseSection):
    """A case. Relative paths start at ``folder``, the case file's own."""

    schema_: Literal[1] = Field(1, alias="schema")
    name: str = Field(pattern=NAME, max_length=LONGEST_NAME)
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
    reserve: ReserveOrText = None
    assumed: dict[str, str] = Field(default_factory=dict)
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
        return load_hand(
            find_source(h.source, self.folder),
            pose=pose_of(1e-3 * np.array(h.position_mm), rotation_rpy(*np.radians(h.rpy_deg))),
            limits={joint: (math.radians(low), math.radians(high)) for joint, (low, high) in h.limits_deg.items()},
            **read_hand_settings(h, self.folder),
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
        """Plan the case: see :func:`~pinograsp.planner.plan_grasp`. A reserve is planned for by the convex search."""
        hand, reserve = self.load_hand(), None if self.reserve is None else self.reserve.make()
        options = PlanOptions(
            grid=self.make_grid(),
            search=self.forces.search if reserve is None else "convex",
            solver=self.forces.solver,
            objective=self.forces.objective,
            motion=self.make_motion(),
        )
        limit = self.limits.torque_limit
        problem = self.make_problem(hand)
        plan = plan_grasp(hand, problem, options, torque_limit=limit, reserve=reserve, progress=progress)
        return replace(plan, settings=self.settings())


def _radians(angles_deg: Angles) -> dict[str, Array]:
    return {finger: np.radians(np.array(angles)) for finger, angles in angles_deg.items()}


def builtin_cases() -> list[str]:
    """Names of the built-in cases."""
    return sorted(path.stem for path in Path(__file__).parent.glob("*.yaml"))


# "Case | Any" for "Case | ObjectCase": a script knows which it asks for, and a checker lets it use that one's methods,
# where overloads would cost the messages that name a misspelt key.
def load_case(source: str | Path, changes: CaseChanges = _AS_IT_IS, *, texts: Sequence[str] = ()) -> Case | Any:
    """A case by name or from a YAML file, with some values changed.

    A file with ``contacts`` says where the fingers touch, in a frame that it gives; one with the text ``hand: ...`` and
    an object is searched for grasps, its keys are the options of ``pinograsp plan``.

    Args:
        source: a built-in case's name (``"paper"``, ``"mug"``) or a path.
        changes: values by key, ``{"object.mass": 1.1}``.
        texts: the same as people type it, ``["object.mass=1.1"]``, read as YAML; after ``changes``.

    Raises:
        CaseRejected: unknown case, broken YAML, unknown keys or unusable values: all of them named at once; a file
            that says that its hand's file may run code.

    Example:
        >>> import pinograsp as pg
        >>> case = pg.load_case("paper", {"object.mass": 0.9})
        >>> print(case.make_object().mass, case.plan().status)
        0.9 ok

    See Also:
        :func:`~pinograsp.planner.plan_grasp`; :func:`~pinograsp.sweep.sweep` plans a case for many values.
    """
    name = source if isinstance(source, str) else str(path_of("case", source))
    path = Path(__file__).parent / f"{name}.yaml" if name in builtin_cases() else Path(name)
    wanted = f"a YAML file or one of: {', '.join(builtin_cases())}"
    data = read_mapping(path, "case", name, wanted, _BIGGEST, "hand, object, contacts...")
    pair = isinstance(data.get("hand"), str)
    trusting, key = (data, "trusted") if pair else (data.get("hand"), "hand.trusted")
    if isinstance(trusting, dict) and trusting.get("trusted", False) is not False:
        raise CaseRejected(
            f"case '{name}': {key}: a file cannot say this itself: give it when you open the case "
            f"(--set {key}=true, {{'{key}': True}})"
        )
    data = change_values(data, read_changes(changes, texts))
    check_extent(data, f"case '{name}'")
    if "folder" in data:
        raise CaseRejected(f"case '{name}': folder: unknown key")
    data["folder"] = path.resolve().parent
    if pair:
        return validate(ObjectCase, {"name": path.stem, **data}, f"case '{name}'")
    return validate(Case, data, f"case '{name}'")


def with_changes(case: Case, changes: Mapping[str, object]) -> Case:
    """``case`` with some values changed; keys and errors as in :func:`load_case`."""
    data = change_values(case.settings(), changes)
    return validate(Case, {**data, "folder": case.folder}, f"case '{case.name}'")
