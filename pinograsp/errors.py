"""Exceptions and status values of the package.

Two families of failure reach the caller: the *input* could not be used (:class:`InvalidInput`, also a ``ValueError``)
or the input was fine and *no grasp* exists (:class:`NoGrasp`). Inside a stage a failure is a :class:`Status`
on the returned record; only the top level raises.
"""

from __future__ import annotations

from enum import Enum
from typing import Any


class Status(str, Enum):
    """How a stage ended. ``Status.OK`` is the only success."""

    OK = "ok"
    UNBALANCED = "unbalanced"
    INFEASIBLE = "infeasible"
    INACCURATE = "inaccurate"
    INTERRUPTED = "interrupted"
    JOINT_LIMIT = "joint_limit"
    NOT_TRACKED = "not_tracked"

    def __str__(self) -> str:
        return self.value

    @property
    def remedy(self) -> str:
        """What to do about it, in one sentence (empty for ``OK``)."""
        return _REMEDIES[self]


_REMEDIES = {
    Status.OK: "",
    Status.UNBALANCED: "These normal forces cannot balance the load: change them, raise mu or move the contacts.",
    Status.INFEASIBLE: "Raise mu, lighten the object, allow deeper penetration or an earlier impact, "
    "or refine the grid.",
    Status.INACCURATE: "The answer failed its certificate and nothing is proven: change load, mu or limits a little, "
    "or the solver.",
    Status.INTERRUPTED: "The search was stopped: run it again to the end for the optimum.",
    Status.JOINT_LIMIT: "A joint meets its limit: the motion's remedy names it. Widen it, or choose another contact "
    "posture or start.",
    Status.NOT_TRACKED: "Contact points cannot follow their paths: the motion's remedy says what keeps which finger "
    "from it.",
}


class PinograspError(Exception):
    """Root of every exception this package raises on purpose."""


class InvalidInput(PinograspError, ValueError):
    """An argument was unusable: says what was expected, what came, and what to do."""


class HandNotLoaded(InvalidInput):
    """A hand description could not be used. ``problems`` lists everything found, not only the first."""

    def __init__(self, source: str, problems: list[str] | str):
        self.source = str(source)
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        name = self.source if len(self.source) <= 300 else f"{self.source[:297]}..."
        super().__init__(f"hand '{name}' could not be loaded: " + "; ".join(self.problems))


class CaseRejected(InvalidInput):
    """A case file is missing, is not valid YAML, or holds a value that cannot be used."""


class ResultsNotWritten(InvalidInput):
    """The output cannot be written: its folder exists, holds files that are not ours or belongs to another writer, or
    the disk is full.
    """


class ExtraMissing(PinograspError, ImportError):
    """An optional dependency is not installed; the message names the extra that brings it."""


class NoGrasp(PinograspError):
    """The input is valid and no grasp was found for it."""


class ContactNotReached(NoGrasp):
    """A finger cannot bring its contact point to the place asked for. ``finger`` and ``details`` say which and why."""

    def __init__(self, finger: str, details: str):
        self.finger = finger
        self.details = details
        super().__init__(f"finger '{finger}' cannot reach its contact: {details}")


class GraspInfeasible(NoGrasp):
    """No forces were found that hold the object. ``solution`` is the record of the search, with its rejection
    histogram.

    Its ``status`` says whether it is known that there are none (``infeasible``: proven, or no point of the grid) or not
    (``inaccurate``, ``interrupted``).
    """

    def __init__(self, message: str, solution: Any = None):
        self.solution = solution  # Any: this room comes before the records of forces
        super().__init__(message)


class PlacementNotFound(NoGrasp):
    """No sampled placement of the palm holds the object. Carries the ``search`` with the outcomes of its samples."""

    def __init__(self, message: str, search: Any):
        super().__init__(message)
        self.search = search  # Any: this room comes before the records of a search


class GeometryFailed(PinograspError):
    """The distance between ``link`` and the object could not be computed: a mesh is likely degenerate."""

    def __init__(self, link: str, kind: str):
        self.link = link
        remedy = (
            "repair its mesh (slivers, zero-area triangles) or give it a simpler collision geometry"
            if kind.startswith(("BVH", "Convex"))
            else "check the object's mesh, if it is one, and the sizes and places of both: "
            "they may be deep inside each other"
        )
        super().__init__(f"the distance of link '{link}' ({kind}) from the object could not be computed: {remedy}")


class SimulationDiverged(PinograspError):
    """A simulation has come apart. ``time`` [s] and ``time_step`` [s] say when."""

    def __init__(self, time: float, time_step: float):
        self.time, self.time_step = time, time_step
        super().__init__(
            f"the simulation came apart at {time:.4g} s (step {1e3 * time_step:g} ms): take a smaller time_step "
            "or softer servos"
        )


# What an exception is called in tables and JSON, and the exit code of the command line: the first type that fits.
_MEANINGS: tuple[tuple[type[BaseException], str, int], ...] = (
    (KeyboardInterrupt, "interrupted", 130),
    (PlacementNotFound, "not_found", 3),
    (GraspInfeasible, "infeasible", 3),
    (NoGrasp, "not_reached", 3),
    (InvalidInput, "invalid_input", 2),
    (ExtraMissing, "extra_missing", 2),
    (BaseException, "failed", 2),
)


def status_of(error: BaseException) -> str:
    """One word for how what raised ``error`` ended: for a grasp that was not found the status of its search."""
    solution = getattr(error, "solution", None)
    return _meaning(error)[0] if solution is None else str(solution.status)


def exit_code_of(error: BaseException) -> int:
    """The exit code of a command that raised ``error``: 2 unusable input, 3 no grasp, 130 interrupted."""
    return 130 if status_of(error) == Status.INTERRUPTED else _meaning(error)[1]


def _meaning(error: BaseException) -> tuple[str, int]:
    return next((status, code) for kind, status, code in _MEANINGS if isinstance(error, kind))
