"""Exceptions and status values of the package, and the one table that joins them: exception, status, exit code, remedy.

Two families of failure reach the caller: the *input* cannot be used (:class:`InvalidInput`, also a ``ValueError``)
or the input is fine and *no grasp* was found (:class:`NoGrasp`). Inside a stage a failure is a :class:`Status`
on the returned record; only the top level raises.
"""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Any, NamedTuple

from pinograsp.words import escape_controls, printable

_LONGEST_PROBLEM = 600  # characters about a file of grasps


class Status(StrEnum):
    """How a stage, a plan, a certified grasp or a command ended, in one word.

    ``OK`` is the success of stages, plans and commands, ``HELD`` that of certified grasps.

    Example:
        >>> import pinograsp as pg
        >>> print(pg.Status.OK, pg.Status.OK.exit_code, pg.Status.OK == "ok")
        ok 0 True

    See Also:
        :class:`~pinograsp.errors.PinograspError`, :class:`~pinograsp.planner.GraspPlan`.
    """

    OK = "ok"
    UNBALANCED = "unbalanced"
    NOT_TRACKED = "not_tracked"
    JOINT_LIMIT = "joint_limit"
    EARLY_CONTACT = "early_contact"
    DOUBTFUL = "doubtful"
    INFEASIBLE = "infeasible"
    INACCURATE = "inaccurate"
    NOT_REACHED = "not_reached"
    NOT_FOUND = "not_found"
    INTERRUPTED = "interrupted"
    INVALID_INPUT = "invalid_input"
    EXTRA_MISSING = "extra_missing"
    FAILED = "failed"
    HELD = "held"
    PENETRATES = "penetrates"
    SELF_COLLISION = "self_collision"
    NO_CONTACT = "no_contact"
    NO_FORCES = "no_forces"
    FRICTION = "friction"
    RESERVE = "reserve"
    TORQUE = "torque"
    DRIVES = "drives"
    UNDECIDED = "undecided"
    GEOMETRY_FAILED = "geometry_failed"

    @property
    def words(self) -> str:
        """What it means."""
        return _MEANINGS[self].words

    @property
    def answer(self) -> str:
        """The first words of the answer whether a plan with this status holds."""
        return _MEANINGS[self].answer

    @property
    def remedy(self) -> str:
        """What to do about it, in one sentence (empty for ``OK`` and ``HELD``)."""
        return _MEANINGS[self].remedy

    @property
    def exit_code(self) -> int:
        """Exit code of a command with this status: 0 usable, 2 unusable input, 3 no grasp, 130 interrupted."""
        return _MEANINGS[self].exit_code

    @property
    def code(self) -> int:
        """Its number in arrays and files of certificates, which never changes; -1: not a status of certificates."""
        return _MEANINGS[self].code

    @classmethod
    def from_code(cls, code: int) -> Status:
        """Return the status of this number in arrays and files of certificates; ``ValueError`` if there is none."""
        if code >= 0:
            for status, meaning in _MEANINGS.items():
                if meaning.code == code:
                    return status
        raise ValueError(f"expected the code of a certificate, 0 to {max(one.code for one in cls)}, got {code}")


class PinograspError(Exception):
    """Base class of every exception that this package raises on purpose. Its text has no control characters of
    terminals, because names in it may come from a stranger's file.

    Example:
        >>> import pinograsp as pg
        >>> try:
        ...     pg.Sphere(radius=-0.03, mass=0.2)
        ... except pg.PinograspError as error:
        ...     print(type(error).__name__, "-", error)
        InvalidInput - sphere radius: expected a finite number > 0 [m], got -0.03

    See Also:
        :class:`~pinograsp.errors.Status`.
    """

    def __str__(self) -> str:
        return escape_controls(super().__str__(), keep="\n")

    def __reduce__(self) -> tuple[Any, ...]:
        return _restore, (type(self), self.args, vars(self))


def _restore(kind: type[PinograspError], args: tuple[object, ...], fields: dict[str, object]) -> PinograspError:
    """An error from another process, whatever its class is made of."""
    error = kind.__new__(kind, *args)
    vars(error).update(fields)
    return error


class InvalidInput(PinograspError, ValueError):
    """An argument was unusable; the message says what was expected, what was given, and what to do."""


class HandNotLoaded(InvalidInput):
    """A hand description could not be used. ``problems`` lists all problems that were found."""

    def __init__(self, source: str | Path, problems: list[str] | str):
        self.source = str(source)
        self.problems = [problems] if isinstance(problems, str) else list(problems)
        name = self.source if len(self.source) <= 300 else f"{self.source[:297]}..."
        super().__init__(f"hand '{name}' could not be loaded: " + "; ".join(self.problems))


class CaseRejected(InvalidInput):
    """A case file is missing, is not valid YAML, or holds a value that cannot be used."""


class GraspsNotRead(InvalidInput):
    """A file of grasps could not be used: another format, broken, hostile, or an impossible value.

    Attributes:
        source: the file.
        problem: what was expected, what was given, and what to do; on one line.
        row: the row concerned, from 0; None for the file. Rows before it are good.
    """

    def __init__(self, source: str | Path, problem: str, row: int | None = None):
        self.source, self.problem, self.row = str(source), printable(problem, _LONGEST_PROBLEM), row
        where = "" if row is None else f", row {row}"
        name = self.source if len(self.source) <= 300 else f"...{self.source[-297:]}"
        super().__init__(f"grasps '{printable(name, _LONGEST_PROBLEM)}'{where}: {self.problem}")


class ResultsNotWritten(InvalidInput):
    """The output cannot be written: its folder exists, holds foreign files or belongs to another writer, or the disk is
    full.
    """


class ExtraMissing(PinograspError, ImportError):
    """An optional dependency is not installed; the message names the extra that installs it."""


class NoGrasp(PinograspError):
    """The input is valid and no grasp was found for it."""


class ContactNotReached(NoGrasp):
    """A finger cannot bring its contact point to the given place. ``finger`` and ``details`` say which and why."""

    def __init__(self, finger: str, details: str):
        self.finger = finger
        self.details = details
        super().__init__(f"finger '{finger}' cannot reach its contact: {details}")


class SearchFailed(NoGrasp):
    """A search for contact forces ended without any. ``solution`` is its record; ``remedy`` names changes that were
    tried and would suffice, "" if none was tried.
    """

    def __init__(self, message: str, solution: Any, *, remedy: str = ""):
        self.solution = solution  # Any: this room comes before the records of forces
        self.remedy = remedy
        super().__init__(message)


class GraspInfeasible(SearchFailed):
    """No forces hold the object: proven, or no point of the grid does."""


class GraspUndecided(SearchFailed):
    """No forces were found that pass their certificate, but it is not proven that none exist."""


class SearchInterrupted(SearchFailed):
    """A search was stopped before it found any forces."""


class CarryInfeasible(SearchFailed):
    """No timing of a path holds the object, or the given one does not: proven.

    ``at`` is a path parameter at which no forces within the limits hold the load, ``factor`` the possible speed
    over that of the given timing, 0 if even rest is impossible.
    """

    def __init__(self, message: str, *, at: float, solution: Any, factor: float = 0.0):
        super().__init__(message, solution)
        self.at, self.factor = at, factor


class CarryUndecided(SearchFailed):
    """No timing of a path was found, but it is not proven that none exists."""

    def __init__(self, message: str, *, solution: Any):
        super().__init__(message, solution)


class GraspNotFound(NoGrasp):
    """No grasp that was tried holds the object. ``search`` has the outcomes of its samples."""

    def __init__(self, message: str, search: Any):
        super().__init__(message)
        self.search = search  # Any: this room comes before the records of a search


class PickFailed(NoGrasp):
    """No grasp was found that the arm reaches, lifts and puts down. ``reasons`` counts the grasps by the reason against
    them.
    """

    def __init__(self, message: str, reasons: dict[str, int]):
        super().__init__(message)
        self.reasons = reasons


class GeometryFailed(PinograspError):
    """The distance between ``link`` and the object could not be computed; a mesh is probably degenerate."""

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
    """A simulation diverged, at ``time`` [s], with steps of ``time_step`` [s]."""

    def __init__(self, time: float, time_step: float):
        self.time, self.time_step = time, time_step
        super().__init__(
            f"the simulation diverged at {time:.4g} s (step {1e3 * time_step:g} ms): take a smaller time_step "
            "or softer servos"
        )


_HELD, _INCOMPLETE, _UNSURE, _NONE = "Yes", "The plan is not complete", "Not certain", "No grasp"


class _Meaning(NamedTuple):
    """A line of the table."""

    exit_code: int
    words: str
    remedy: str
    answer: str = _NONE
    code: int = -1
    errors: tuple[type[BaseException], ...] = ()


# Exceptions of several lines' kinds mean the first of them.
_MEANINGS = {
    Status.OK: _Meaning(
        0, "forces are proven, a motion is found, and only the warnings cast doubt on the plan", "", _HELD
    ),
    Status.UNBALANCED: _Meaning(
        0,
        "the forces of a grid search balance the load except for a small residual",
        "These normal forces cannot balance the load: change them, raise mu or move the contacts.",
        "Almost",
    ),
    Status.NOT_TRACKED: _Meaning(
        0,
        "a finger cannot follow its path exactly; the message says by how much it misses it",
        "Contact points cannot follow their paths: the motion's remedy names the finger and the cause.",
        _UNSURE,
    ),
    Status.JOINT_LIMIT: _Meaning(
        3,
        "a joint reaches its limit, or is beyond it",
        "A joint reaches its limit: the motion's remedy names it. Widen the limit, or choose another posture or start.",
        _INCOMPLETE,
        code=1,
    ),
    Status.EARLY_CONTACT: _Meaning(
        0,
        "a link touches the object, or another link, too early",
        "A link hits the object, or another link, too early: the motion's remedy names it. Choose another start.",
        _INCOMPLETE,
    ),
    Status.DOUBTFUL: _Meaning(
        0,
        "more than a twentieth of the forces act on edges or hollow links, or the object gives way by more than 2 mm "
        "to the push of its reserve",
        "Forces act on edges of the object or on hollow links, where a small error changes the normal, or the object "
        "gives way too far: the motion's remedy says which. Choose another grasp.",
        _UNSURE,
    ),
    Status.INFEASIBLE: _Meaning(
        3,
        "no forces within the limits hold the load (proven), or no point of the grid balances the load",
        "The message of a plan, or diagnose(), names the cause and the changes that would suffice.",
        errors=(GraspInfeasible, CarryInfeasible),
    ),
    Status.INACCURATE: _Meaning(
        3,
        "neither certified nor refuted",
        "The answer failed its certificate and nothing is proven: change load, mu or limits a little, or the solver.",
        errors=(GraspUndecided, CarryUndecided),
    ),
    Status.INTERRUPTED: _Meaning(
        130,
        "Ctrl-C; no file is half-written",
        "It was stopped before its end: run it again.",
        _INCOMPLETE,
        errors=(SearchInterrupted, KeyboardInterrupt),
    ),
    Status.NOT_FOUND: _Meaning(
        3,
        "no sample of a search holds the object",
        "The message says how the samples ended, and which changes would suffice.",
        errors=(GraspNotFound,),
    ),
    Status.NOT_REACHED: _Meaning(
        3,
        "a finger cannot reach its contact",
        "A finger cannot reach its contact: move the contact or the hand, or widen joint limits.",
        errors=(NoGrasp,),
    ),
    Status.INVALID_INPUT: _Meaning(
        2,
        "an argument cannot be used; the message says what was expected and what to do",
        "The message says what was expected, what was given and what to do.",
        errors=(InvalidInput,),
    ),
    Status.EXTRA_MISSING: _Meaning(
        2,
        "an optional package is not installed; the message names the extra",
        "Install the extra that the message names.",
        errors=(ExtraMissing,),
    ),
    Status.FAILED: _Meaning(
        2,
        "anything else; the message says what",
        "The message says what happened.",
        errors=(BaseException,),
    ),
    Status.HELD: _Meaning(0, "holds the weight and the reserve", "", _HELD, code=0),
    Status.PENETRATES: _Meaning(
        3,
        "a link is deeper in the object than the tolerance",
        "Check the frames and units of hand and object, close the hand there again, or allow a greater depth.",
        code=2,
    ),
    Status.SELF_COLLISION: _Meaning(3, "links of the hand overlap", "Choose another posture.", code=3),
    Status.NO_CONTACT: _Meaning(
        3,
        "fewer than two links touch the object",
        "Check the frames and units of hand and object, or close the hand there.",
        code=4,
    ),
    Status.NO_FORCES: _Meaning(
        3,
        "no forces at these contacts hold the weight, whatever the friction (proven up to mu = 2)",
        "Choose other contacts: these do not oppose each other.",
        code=5,
    ),
    Status.FRICTION: _Meaning(
        3,
        "no forces at these contacts hold the weight with this friction (proven); with more some do",
        "The record gives the least friction that does.",
        code=6,
    ),
    Status.RESERVE: _Meaning(
        3,
        "the hand holds the weight, but not everything that the reserve adds",
        "The record gives the share that is held: ask for less, or choose other contacts.",
        code=7,
    ),
    Status.TORQUE: _Meaning(
        3,
        "forces hold the object, but the squeeze takes more torque than the joints have",
        "The record gives the largest weight that the joints hold.",
        code=8,
    ),
    Status.DRIVES: _Meaning(
        3,
        "forces hold the object, but the hand's drives cannot produce them together",
        "Choose a posture in which they can, or leave the drives out (drives=False).",
        code=9,
    ),
    Status.UNDECIDED: _Meaning(
        3,
        "the solver found no answer that passes its certificate",
        "Nothing is proven: change load, mu or limits a little.",
        code=10,
    ),
    Status.GEOMETRY_FAILED: _Meaning(
        3,
        "the distance from the object could not be computed",
        "Repair the mesh of the object or the link (slivers, triangles without area).",
        code=11,
    ),
}


def status_of(error: BaseException) -> Status:
    """Return the status that corresponds to an exception."""
    return next(status for status, meaning in _MEANINGS.items() if isinstance(error, meaning.errors))
