"""What a plan is to withstand, and what is done with the object, as case files and options say it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated, Literal

import numpy as np
from pydantic import BeforeValidator, Field, model_validator

from pinograsp.cases.reading import validate
from pinograsp.cases.sections import CaseSection, NotNegative, Vector
from pinograsp.forces import Reserve, Task

Share = Annotated[float, Field(ge=0, lt=1)]
Times = Annotated[float, Field(ge=1, le=1000)]
_TASKS = {  # of each its size, and what else it may have
    "screw": ("torque", "axis"),
    "pour": ("tilt_deg",),
    "insert": ("force", "direction", "at"),
    "pull": ("force", "direction", "at"),
    "shake": ("acceleration",),
}


class ReserveSection(CaseSection):
    """What the plan is to withstand besides the weight, see :class:`~pinograsp.forces.Reserve`."""

    disturbance: NotNegative = Reserve().disturbance
    moment_arm: NotNegative | None = None
    mass: Share = Reserve().mass
    friction: Share = Reserve().friction
    normal_force: NotNegative = Reserve().normal_force
    torque: Share = Reserve().torque
    softer: Times | Literal["sheet"] = 1.0
    stiffer: Times | Literal["sheet"] = 1.0
    drive: Share | Literal["sheet"] = 0.0

    def make(self, tasks: Sequence[TaskSection] = ()) -> Reserve:
        """As the plan takes it."""
        return Reserve(**self.model_dump(), tasks=tuple(task.make() for task in tasks))


def read_reserve(given: object) -> object:
    """The fields in a text: ``none``, ``default``, or some of them, as in ``disturbance=0.3,mass=0.1``."""
    if not isinstance(given, str):
        return given
    if given.strip() in ("none", "default"):
        return None if given.strip() == "none" else {}
    parts = [part.partition("=") for part in given.split(",")]
    names = [name.strip() for name, _, _ in parts]
    if not all(sign for _, sign, _ in parts) or len(set(names)) < len(names):
        known = ", ".join(ReserveSection.model_fields)
        raise ValueError(f"expected none, default, or NAME=VALUE,... each once of {known}, got '{given:.60}'")
    return {name.strip(): value.strip() for name, _, value in parts}


ReserveOrText = Annotated[ReserveSection | None, BeforeValidator(read_reserve)]


class _Wish(CaseSection):
    reserve: ReserveOrText


def make_reserve(text: str) -> Reserve | None:
    """The reserve that a text means: ``none``, ``default``, or values, as in ``disturbance=0.3,mass=0.1``.

    Raises:
        CaseRejected: the text means none, with what may stand there.
    """
    section = validate(_Wish, {"reserve": text}).reserve
    return None if section is None else section.make()


class TaskSection(CaseSection):
    """What is done with the object, see :class:`~pinograsp.forces.Task`: its name and its numbers."""

    name: Literal["screw", "pour", "insert", "pull", "shake"]
    torque: NotNegative | None = None
    tilt_deg: Annotated[float, Field(ge=0, le=180)] | None = None
    force: NotNegative | None = None
    acceleration: NotNegative | None = None
    axis: Vector | None = None
    direction: Vector | None = None
    at: Vector | None = None

    @model_validator(mode="after")
    def _fits(self) -> TaskSection:
        size, *more = _TASKS[self.name]
        given = [name for name in type(self).model_fields if name != "name" and getattr(self, name) is not None]
        if size not in given or not set(given) <= {size, *more}:
            may = f" (and {', '.join(more)})" if more else ""
            raise ValueError(f"{self.name}: expected {size}{may}, got {', '.join(given) or 'nothing'}")
        return self

    def make(self) -> Task:
        """As the reserve takes it."""
        values = self.model_dump(exclude={"name"}, exclude_none=True)
        if "tilt_deg" in values:
            values = {"tilt": float(np.radians(values["tilt_deg"]))}
        made: Task = getattr(Task, self.name)(**values)
        return made


def read_task(given: object) -> object:
    """The fields in a text: ``screw:torque=0.5,axis=0 0 1``."""
    if not isinstance(given, str):
        return given
    name, _, rest = given.partition(":")
    parts = [part.partition("=") for part in rest.split(",")] if rest.strip() else []
    if not all(sign for _, sign, _ in parts):
        raise ValueError(f"expected a task such as screw:torque=0.5 or pull:force=5,direction=0 0 1, got '{given:.60}'")
    fields = {key.strip(): value.split() if " " in value.strip() else value.strip() for key, _, value in parts}
    return {"name": name.strip(), **fields}
