"""Drives: the motors of a hand, the joints that they move, and the springs at its joints."""

from __future__ import annotations

import functools
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, frozen, instance_of, items_of, number, one_of, shorten, text_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.closing_table import ClosingTable
from pinograsp.hands.coupling import Coupling
from pinograsp.hands.sources import Figure, Source
from pinograsp.spatial import Array

Control: TypeAlias = Literal["torque", "position", "jaw"]

LEAST_ARM, LARGEST_ARM = 1e-9, 1e6
FARTHEST_OFF = 1e3  # [-] of contact stiffness, from the planned one
_MOST_SHOWN = 4  # joints of a drive in words
# Where the stiffness of a servo is not known: that of a small one [N m/rad], and of the same 30 mm from its axis [N/m].
SERVO = 50.0
SLIDING_SERVO = SERVO / 0.03**2
# How notes on drives and on springs begin, so that those of others take their place.
ON_DRIVES, ON_SPRINGS = "drives: ", "springs: "


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """A motor and the joints that it moves.

    Its effort e [N or N m] produces the torque ``arms[i] * e`` at ``joints[i]``; its coordinate is a = sum arms_i q_i.

    Attributes:
        name: of the motor.
        joints: names of the independent joints that it moves.
        arms: torque or force at each of these joints per unit of effort: 1.0 for a motor at its own joint, the moment
            arm [m] of a tendon.
        control: ``torque``: the effort is commanded; ``position``: a servo holds a commanded coordinate; ``jaw``:
            closes until it presses with the effort asked for.
        limit: largest effort [N or N m]; infinity if it is not known.
        stiffness: of a position servo, effort per unit of a; None if it is not known.
        damping: effort per unit of da/dt; None if it is not known.
        exact: whether the torques at its joints are in the ratio of the arms. False if springs or friction that nobody
            has measured carry a part at these joints; plans then only say where they rely on them.
        efforts: least and largest effort, if it is weaker in one direction, such as a tendon that only pulls; None:
            ``limit`` in both directions.
        step: of the encoder by which a position servo holds its coordinate, in units of a; None if it is not known.
        floor: least effort with which it holds once it has closed, as in grippers that cannot be set lower; 0: any.
        continuous: largest effort that it can hold for long without overheating; None if it is not known.
        effort_step: effort per unit of its effort or current register; None if it is not known.
        backlash: play of its gears, in units of a; None if it is not known.
        friction: effort lost to dry friction; None if it is not known.
        latency: time from a command to the motion [s]; None if it is not known.
        closing: force of its finger when it closes on a stop; None if nobody has measured it.
        contact_stiffness: least and largest stiffness of its fingers' contacts over the planned one [-], as
            (0.8, 1.3); None: nobody has measured it.
        sources: the sources of these figures, with a mark for guesses; at most one for each figure.

    Raises:
        InvalidInput: the values do not describe a drive.
    """

    name: str
    joints: tuple[str, ...]
    arms: tuple[float, ...]
    control: Control = "torque"
    limit: float = math.inf
    stiffness: float | None = None
    damping: float | None = None
    exact: bool = True
    efforts: tuple[float, float] | None = None
    step: float | None = None
    floor: float = 0.0
    continuous: float | None = None
    effort_step: float | None = None
    backlash: float | None = None
    friction: float | None = None
    latency: float | None = None
    closing: ClosingTable | None = None
    contact_stiffness: tuple[float, float] | None = None
    sources: tuple[Source, ...] = ()

    __repr__ = brief()

    def __post_init__(self) -> None:
        if not text_of("name of a drive", self.name):
            raise InvalidInput("name of a drive: expected a text, got an empty one: give each drive a name")
        where = f"drive '{self.name}'"
        joints = items_of(f"joints of {where}", self.joints, str)
        if not joints or len(set(joints)) < len(joints):
            raise InvalidInput(f"joints of {where}: expected one or more joints, each once, got {shorten(joints)}")
        arms = array_of(f"arms of {where}", self.arms, (None,))
        if len(arms) != len(joints):
            raise InvalidInput(f"arms of {where}: expected one per joint, {len(joints)}, got {len(arms)}")
        if not np.all((np.abs(arms) >= LEAST_ARM) & (np.abs(arms) <= LARGEST_ARM)):
            raise InvalidInput(
                f"arms of {where}: expected sizes from {LEAST_ARM:g} to {LARGEST_ARM:g}, got {arms.tolist()}: leave "
                "out joints that it does not move"
            )
        one_of(f"control of {where}", self.control, get_args(Control))
        flag(f"exact of {where}", self.exact)
        for key in ("stiffness", "step", "continuous", "effort_step"):
            _optional(self, key, where, above=0)
        for key in ("damping", "backlash", "friction", "latency"):
            _optional(self, key, where, at_least=0)
        instance_of(f"closing of {where}", self.closing, ClosingTable, type(None))
        if self.stiffness is not None and self.control != "position":
            raise InvalidInput(
                f"stiffness of {where}: expected none for control '{self.control}', got {self.stiffness:g}: leave it "
                "out, or set control='position'"
            )
        limit = math.inf if _infinite(self.limit) else number(f"limit of {where}", self.limit, above=0)
        if self.efforts is not None:
            least, most = array_of(f"efforts of {where}", self.efforts, (2,)).tolist()
            if not least < most or not math.isclose(max(-least, most), limit, rel_tol=1e-9):
                raise InvalidInput(
                    f"efforts of {where}: expected the least and the largest, the larger of both in size its limit "
                    f"{limit:g}, got {least:g} and {most:g}"
                )
            object.__setattr__(self, "efforts", (least, most))
        if self.contact_stiffness is not None:
            low, high = array_of(f"contact_stiffness of {where}", self.contact_stiffness, (2,)).tolist()
            if not 1 / FARTHEST_OFF <= low <= 1.0 <= high <= FARTHEST_OFF:
                raise InvalidInput(
                    f"contact_stiffness of {where}: expected the least and the largest over the planned one, within "
                    f"{1 / FARTHEST_OFF:g} to 1 and 1 to {FARTHEST_OFF:g}, got {low:g} and {high:g}"
                )
            object.__setattr__(self, "contact_stiffness", (low, high))
        floor = number(f"floor of {where}", self.floor, at_least=0)
        if floor > limit:
            raise InvalidInput(
                f"floor of {where}: expected at most its limit {limit:g}, got {floor:g}: both are efforts of the "
                "drive, N m where it turns joints, not newtons at the fingertips"
            )
        if self.continuous is not None and self.continuous > limit:
            raise InvalidInput(
                f"continuous effort of {where}: expected at most its limit {limit:g}, got {self.continuous:g}"
            )
        sources = items_of(f"sources of {where}", self.sources, Source)
        _each_once(f"figures with a source of {where}", [source.figure for source in sources])
        checked = {"joints": joints, "arms": tuple(arms.tolist()), "limit": limit, "floor": floor, "sources": sources}
        for key, value in checked.items():
            object.__setattr__(self, key, value)

    @property
    def figures(self) -> set[str]:
        """Names of the figures that it has."""
        none = {"limit": math.inf, "floor": 0.0}
        return {figure for figure in get_args(Figure) if getattr(self, figure) not in (None, none.get(figure))}

    def source(self, figure: Figure) -> Source | None:
        """The source of one of its figures; None if it is not known."""
        return next((source for source in self.sources if source.figure == figure), None)

    def __str__(self) -> str:
        """Its control and its joints with their arms, the first few of many, in words."""
        moved = [joint if arm == 1 else f"{joint} (arm {arm:.4g})" for joint, arm in zip(self.joints, self.arms)]
        if len(moved) > _MOST_SHOWN:
            moved[_MOST_SHOWN - 1 :] = [f"{len(moved) - _MOST_SHOWN + 1} more"]
        return f"{self.name}: {self.control}, moves {', '.join(moved)}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Spring:
    """A spring at an independent joint: torque -stiffness (q - rest).

    Attributes:
        joint: name of the joint.
        stiffness: [N m/rad or N/m], above zero.
        rest: position [rad or m] without torque.

    Raises:
        InvalidInput: the values do not describe a spring.
    """

    joint: str
    stiffness: float
    rest: float = 0.0

    def __post_init__(self) -> None:
        where = f"spring at joint '{text_of('joint of a spring', self.joint)}'"
        object.__setattr__(self, "stiffness", number(f"stiffness of {where}", self.stiffness, above=0))
        object.__setattr__(self, "rest", number(f"rest of {where}", self.rest))


def _infinite(value: object) -> bool:
    return isinstance(value, float | np.floating) and value == math.inf


def _optional(drive: Drive, key: str, where: str, *, above: float | None = None, at_least: float | None = None) -> None:
    value = getattr(drive, key)
    if value is not None:
        object.__setattr__(drive, key, number(f"{key} of {where}", value, above=above, at_least=at_least))


def one_each(joints: Iterable[str], limits: ArrayLike, control: Control = "torque") -> tuple[Drive, ...]:
    """A motor at each joint, called like it, with its effort limit (n,) [N m or N], infinity where there is none."""
    return tuple(
        Drive(name=joint, joints=(joint,), arms=(1.0,), control=control, limit=limit)
        for joint, limit in zip(joints, np.ravel(limits).tolist())
    )


def checked_drives(
    hand: str, joints: Sequence[str], couplings: Mapping[str, Coupling], drives: object
) -> tuple[Drive, ...]:
    """``drives`` as those of a hand with these independent joints, or :class:`InvalidInput`."""
    found = items_of(f"drives of hand '{hand}'", drives, Drive)
    _each_once(f"drives of hand '{hand}'", [drive.name for drive in found])
    for drive in found:
        for joint in drive.joints:
            _independent(f"joint of drive '{drive.name}'", joint, joints, couplings)
    return found


def checked_springs(
    hand: str, joints: Sequence[str], couplings: Mapping[str, Coupling], springs: object
) -> tuple[Spring, ...]:
    """``springs`` as those of a hand with these independent joints, or :class:`InvalidInput`."""
    found = items_of(f"springs of hand '{hand}'", springs, Spring)
    for spring in found:
        _independent("joint of a spring", spring.joint, joints, couplings)
    _each_once(f"joints with springs of hand '{hand}'", [spring.joint for spring in found])
    return found


def _independent(name: str, joint: str, joints: Sequence[str], couplings: Mapping[str, Coupling]) -> None:
    if joint in couplings:
        one = couplings[joint]
        raise InvalidInput(
            f"{name}: expected a joint that follows no other, got '{joint}', which follows {one}: give "
            f"'{one.followed}', with {one.factor:g} times the arm"
        )
    one_of(name, joint, joints)


def _each_once(name: str, names: list[str]) -> None:
    if twice := [one for one, count in Counter(names).items() if count > 1]:
        raise InvalidInput(f"{name}: expected each once, got more than once {shorten(', '.join(twice))}")


def transmission(joints: Sequence[str], drives: Sequence[Drive]) -> Array:
    """S^T (m, n): joint torques are its transpose times the efforts of the drives."""
    matrix = np.zeros((len(drives), len(joints)))
    column = {joint: j for j, joint in enumerate(joints)}
    for row, drive in zip(matrix, drives):
        row[[column[joint] for joint in drive.joints]] = drive.arms
    return frozen(matrix)


class Ratio(NamedTuple):
    """Torques that joints can have only together.

    Attributes:
        row: combination of the joint torques (n,) that is zero but for springs, of unit length.
        why: the drive, or the lack of one, in words.
    """

    row: Array
    why: str


def ratios_of(joints: Sequence[str], drives: Sequence[Drive]) -> tuple[Ratio, ...]:
    """Return the combinations of the torques of ``joints`` that the drives cannot choose.

    These exist if drives move several joints each, or leave some out. Jaws are geared: the object decides how their
    joints share the force. The same holds for joints of drives that are not exact.

    Raises:
        InvalidInput: names of joints that are no texts or come twice, or a drive of a joint that is not among them.
    """
    joints, drives = items_of("joints", joints, str), items_of("drives", drives, Drive)
    _each_once("joints", list(joints))
    for drive in drives:
        for joint in drive.joints:
            one_of(f"joint of drive '{drive.name}'", joint, joints)
    return _find_ratios(tuple(joints), tuple(drives))


@functools.lru_cache(maxsize=32)
def _find_ratios(joints: tuple[str, ...], drives: tuple[Drive, ...]) -> tuple[Ratio, ...]:
    """As :func:`ratios_of`."""
    arms, found = transmission(joints, drives), list[Ratio]()
    left = set(range(len(joints)))
    while left:
        own, moving = {min(left)}, np.zeros(len(drives), dtype=bool)
        while True:  # all joints that these drives connect
            moving = np.any(arms[:, sorted(own)] != 0, axis=1)
            more = own | set(np.flatnonzero(np.any(arms[moving] != 0, axis=0)).tolist())
            if more == own:
                break
            own = more
        left -= own
        which, group = sorted(own), [drive for drive, moves in zip(drives, moving) if moves]
        if any(drive.control == "jaw" or not drive.exact for drive in group):
            continue
        why = f"no drive moves {joints[which[0]]}"
        if group:
            names = ", ".join(f"'{drive.name}'" for drive in group)
            why = f"drive{'s' if len(group) > 1 else ''} {names}, which moves several joints at once"
        block = arms[np.ix_(moving, which)]
        rows = np.linalg.svd(block)[2][np.linalg.matrix_rank(block) if block.size else 0 :]
        for one in rows:
            row = np.zeros(len(joints))
            row[which] = one
            found.append(Ratio(frozen(row), why))
    return tuple(found)
