"""The checked options of ``pinograsp plan --hand HAND --object SPEC``: a hand that is closed on an object."""

from __future__ import annotations

import glob
import json
import os
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import AfterValidator, BeforeValidator, Field, model_validator

from pinograsp import defaults
from pinograsp.cases.reading import validate
from pinograsp.cases.reserve_section import ReserveOrText, ReserveSection, TaskSection, read_task
from pinograsp.cases.sections import (
    LONGEST_NAME,
    NAME,
    CaseSection,
    NotNegative,
    Number,
    Objective,
    Solver,
    find_source,
    read_hand_settings,
)
from pinograsp.cases.wishes_section import WishesSection
from pinograsp.contacts import Closure, Friction, FrictionModel, Measure, close_hand
from pinograsp.contacts.compliance import MEASURES
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem, GraspConditions, Reserve
from pinograsp.hands import HandModel, load_hand
from pinograsp.hands.file_reads import Kept
from pinograsp.hands.joint_limits import find_placeholders
from pinograsp.hands.load import Masses
from pinograsp.objects import object_from
from pinograsp.objects.body import Body
from pinograsp.planner import GraspPlan, PlanOptions, Search, plan_best, plan_grasp_on
from pinograsp.spatial import Array, pose_of, rotation_rpy
from pinograsp.synthesis import GraspSearch, find_grasps


def _pose(at: tuple[float, ...]) -> tuple[float, ...]:
    if len(at) not in (3, 6):
        raise ValueError(f"expected x, y, z or x, y, z, roll, pitch, yaw [m, deg], got {len(at)} numbers")
    return at


class ObjectCase(CaseSection):
    """The options of ``pinograsp plan``, by their names.

    ``object`` is the text of :func:`~pinograsp.objects.object_from` or its fields,
    ``{"shape": "sphere", "radius": 0.03, ...}``. ``at`` is the placement of the object's frame, that of its file, in
    the hand's: x, y, z [m] and optionally roll, pitch, yaw [deg]; without it, the best of ``samples`` is used.
    ``wishes``: how it is to be held, :class:`~pinograsp.synthesis.Wishes`. ``tasks``: what is done with it, each as
    ``{"name": "screw", "torque": 0.5}`` or a text, ``screw:torque=0.5``; in the reserve. ``friction``: None: as
    :class:`~pinograsp.forces.GraspConditions` choose it. ``reserve``: ``"none"``, ``"default"``, its fields, or a text
    of them; not given: the default one, and none where the search or the objective knows none. ``torque_limit``: of
    every joint [N m or N], where it is below its effort limit, or that is a placeholder. ``check``: simulate grasps
    that were found, and take one that is held. ``posture``: of joints of no finger, as of an arm, by name [rad or m].
    Relative paths start at ``folder``. ``name``: of the results' folder, runs/NAME; ``out``: another folder for them.
    """

    hand: str
    object: str | dict[str, Any]
    root: str | None = None
    at: Annotated[tuple[Number, ...], AfterValidator(_pose)] | None = None
    mu: NotNegative = defaults.MU
    friction: FrictionModel | None = None
    safety: Annotated[float, Field(ge=1, le=1000)] = 1.0
    samples: Annotated[int, Field(ge=1, le=100_000)] = defaults.GRASPS
    seed: Annotated[int, Field(ge=0)] = 0
    wrap: bool = False
    wishes: WishesSection = WishesSection()
    tasks: tuple[Annotated[TaskSection, BeforeValidator(read_task)], ...] = ()
    table: bool = False
    hulls: bool = True
    palm: str | None = None
    fingers: dict[str, str] | None = None
    packages: dict[str, str] = Field(default_factory=dict)
    xacro_args: dict[str, Any] = Field(default_factory=dict)
    trusted: bool = False
    masses: Masses = "estimate"
    exclude: list[str] = Field(default_factory=list)
    srdf: str | None = None
    drives: str | None = None
    posture: dict[str, Number] = Field(default_factory=dict)
    search: Search = "convex"
    balance: Literal["force", "wrench"] = "wrench"
    measure: Measure = "impulse"
    objective: Objective | dict[Objective, NotNegative] | None = None
    solver: Solver = "auto"
    reserve: ReserveOrText = Field(default_factory=ReserveSection)
    torque_limit: Annotated[float, Field(gt=0)] | None = None
    check: bool = False
    schema_: Literal[1] = Field(1, alias="schema", exclude=True)
    name: Annotated[str, Field(pattern=NAME, max_length=LONGEST_NAME)] | None = Field(None, exclude=True)
    out: str | None = Field(None, exclude=True)
    folder: Path = Field(Path("."), exclude=True)

    @model_validator(mode="after")
    def _search(self) -> ObjectCase:
        if self.wishes != WishesSection() and self.at is not None:
            raise ValueError("wishes say how a search holds the object: expected them without at")
        if self.tasks and self.reserve is None:
            raise ValueError("tasks are part of the reserve: expected reserve other than none")
        if self.torque_limit is not None and self.search != "convex":
            raise ValueError(f"torque_limit: expected with search='convex', got search='{self.search}'")
        return self

    @classmethod
    def of(cls, **values: Any) -> ObjectCase:
        """From keyword arguments.

        Raises:
            CaseRejected: values that cannot be used, all of them named at once.
        """
        return validate(cls, values, "hand and object")

    def change(self, options: Mapping[str, Any]) -> ObjectCase:
        """The same with other values, by name; wishes one by one.

        Raises:
            CaseRejected: values that cannot be used, all of them named at once.
        """
        kept = {name: getattr(self, name) for name in self.model_fields_set if name != "schema_"}
        wishes = self.wishes.model_dump(exclude_unset=True) | options.get("wishes", {})
        return validate(type(self), kept | dict(options) | {"wishes": wishes}, "hand and object")

    def settings(self) -> dict[str, Any]:
        """As plain values with all defaults."""
        return self.model_dump(mode="json")

    def load_hand(self) -> HandModel:
        """The hand at the world's origin; one that was loaded before is reused until one of its files changes."""
        source, settings = find_source(self.hand, self.folder), read_hand_settings(self, self.folder)
        key = (os.getcwd(), source, json.dumps(settings, sort_keys=True))
        return _HANDS.get(key, lambda: load_hand(source, **settings))

    def make_object(self) -> Body:
        """The object at the world's origin."""
        fields = object_fields(self.object)
        if "path" in fields:
            path = self.folder / str(fields["path"])
            if os.path.exists(path) or glob.glob(os.path.join(glob.escape(str(self.folder)), str(fields["path"]))):
                fields["path"] = path
        if "package" in fields:
            name, _, folder = str(fields["package"]).partition("=")
            fields["package"] = f"{name}={self.folder / Path(folder).expanduser()}" if folder else name
        return object_from(
            f"{fields.pop('shape', '')}:" + ",".join(f"{name}={_text(value)}" for name, value in fields.items()),
            packages=read_hand_settings(self, self.folder)["packages"],
        )

    def grasps(self, *, jobs: int = -1, progress: bool | None = None) -> GraspSearch:
        """Grasps of the object: see :func:`~pinograsp.synthesis.find_grasps`."""
        return find_grasps(
            self.load_hand(),
            self.make_object(),
            GraspConditions(
                mu=self.mu,
                friction=self._friction(),
                table=self.table,
                torque_limit=self._torque_limit(),
                reserve=ReserveSection().make(self.tasks),
            ),
            count=self.samples,
            seed=self.seed,
            wrap=self.wrap,
            wishes=self.wishes.make(),
            jobs=jobs,
            progress=progress,
        )

    def closure(self) -> Closure:
        """The hand closed on the object, at ``at`` or in the best grasp found (in this process)."""
        if self.at is None:
            return self._find().best.closure
        turn = rotation_rpy(*np.radians(self.at[3:])) if len(self.at) == 6 else None
        return close_hand(self.load_hand(), self.make_object().placed(pose_of(self.at[:3], turn)), wrap=self.wrap)

    def problem(self) -> ForceProblem:
        """The force problem of the closed hand, without torque limits."""
        closure = self.closure()
        return self._conditions().problem(closure.object, closure.contacts())

    def plan(self, found: GraspSearch | None = None, *, progress: bool | None = None) -> GraspPlan:
        """Plan the best grasp of ``found`` whose motion can be carried out: see :func:`~pinograsp.planner.plan_best`.

        Without it: the hand closed ``at`` the given place (:func:`~pinograsp.planner.plan_grasp_on`), or a search in
        this process.
        """
        conditions = self._conditions()
        options = PlanOptions(search=self.search, solver=self.solver, objective=self.objective)
        if self.at is None:
            jobs, found = (1, self._find()) if found is None else (-1, found)
            plan = plan_best(found, conditions, options, jobs=jobs, progress=progress, check=self.check)
        else:
            closure = self.closure()
            plan = plan_grasp_on(closure.hand, closure, conditions, options, progress=progress)
        what = self.object if isinstance(self.object, str) else str(self.object.get("shape", "object"))
        return replace(plan, settings={"name": self.name or f"{self.hand}, {what}", **self.settings()})

    def _find(self) -> GraspSearch:
        found = self.grasps(jobs=1, progress=False)
        if found.interrupted:
            raise KeyboardInterrupt
        return found

    def _conditions(self) -> GraspConditions:
        return GraspConditions(
            mu=self.mu,
            friction=self._friction(),
            balance=self.balance,
            measure=self.measure,
            torque_limit=self._torque_limit() if self.search == "convex" else None,
            reserve=self._kept_reserve(),
            table=self.table,
        )

    def _torque_limit(self) -> Array | Literal["effort"]:
        """Of each joint (n,) [N m or N]."""
        if self.torque_limit is None:
            return "effort"
        hand = self.load_hand()
        return np.where(
            find_placeholders(hand), self.torque_limit, np.minimum(hand.effort_or_infinity, self.torque_limit)
        )

    def _friction(self) -> Friction | None:
        if self.friction is None and self.search != "convex":
            return Friction(safety=self.safety)  # grids know the paper's pyramid alone
        if self.friction is None:
            if self.safety != 1:
                raise InvalidInput(
                    f"safety: expected with a friction model (cone, pyramid or soft), got {self.safety:g} alone; the "
                    "reserve has a share of friction, too"
                )
            return None
        return Friction.standard(self.friction, safety=self.safety)

    def _kept_reserve(self) -> Reserve | None:
        """The reserve; where none was asked for, only what the search, its solver and objective can plan for."""
        objective = self.objective
        names = {objective} if isinstance(objective, str) else set(objective or ())
        knows = self.search == "convex" and self.solver in ("auto", "clarabel") and names <= {*MEASURES, "peak"}
        if self.reserve is None or not (knows or {"reserve", "tasks"} & self.model_fields_set):
            return None
        return self.reserve.make(self.tasks)


def object_fields(spec: str | dict[str, Any]) -> dict[str, Any]:
    """The fields of an object's text, which can then be changed: ``{"shape": ..., "radius": "0.02", ...}``."""
    if isinstance(spec, dict):
        return dict(spec)
    shape, _, rest = spec.partition(":")
    parts = [part.partition("=") for part in re.split(r",(?=\s*\w+\s*=)", rest)] if rest.strip() else []
    return {"shape": shape.strip(), **{name.strip(): value.strip() for name, _, value in parts}}


def _text(value: object) -> str:
    if isinstance(value, list | tuple):
        return "x".join(map(str, value))
    return str(value).lower() if isinstance(value, bool) else str(value)


_HANDS: Kept[HandModel] = Kept(4)
