"""Drives: the motors of a hand, the joints that they move, and the springs at its joints."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any, Literal, NamedTuple, TypeAlias, get_args

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, frozen, items_of, number, one_of, shown, text_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.coupling import Coupling
from pinograsp.hands.sources import Figure, Source
from pinograsp.spatial import Array

Control: TypeAlias = Literal["torque", "position", "jaw"]

_LEAST_ARM, _LARGEST_ARM = 1e-9, 1e6
_MOST_SHOWN = 4  # joints of a drive in words
# Where the stiffness of a servo is not known: that of a small one [N m/rad], and of the same 30 mm from its axis [N/m].
SERVO = 50.0
SLIDING_SERVO = SERVO / 0.03**2
# How notes on drives and on springs begin, so that those of others take their place.
ON_DRIVES, ON_SPRINGS = "drives: ", "springs: "


@dataclass(frozen=True, slots=True, kw_only=True)
class Drive:
    """A motor and the joints that it moves.

    Its effort e [N or N m] makes the torque ``arms[i] * e`` at ``joints[i]``; its coordinate is a = sum arms_i q_i.

    Attributes:
        name: of the motor.
        joints: names of the independent joints that it moves.
        arms: torque or force at each of these joints per unit of effort: 1.0 for a motor at its own joint, the moment
            arm [m] of a tendon.
        control: ``torque``: the effort is commanded; ``position``: a servo holds a commanded coordinate; ``jaw``:
            closes until it presses with the effort asked for.
        limit: largest effort [N or N m]; infinity where it is not known.
        stiffness: of a position servo, effort per unit of a; None where it is not known.
        damping: effort per unit of da/dt; None where it is not known.
        exact: whether the torques at its joints are in the ratio of the arms. Not so where other springs or friction
            at these joints, which nobody has measured, bear a part: then plans only say where they rely on them.
        efforts: least and largest effort, where it can do less one way than the other, as a tendon that only pulls;
            None: ``limit`` either way.
        step: of the encoder by which a position servo holds its coordinate, in units of a; None where it is not known.
        sources: where limit, stiffness, damping and step come from, and which of them are guesses; each at most once.

    Raises:
        InvalidInput: for values that make no drive.
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
    sources: tuple[Source, ...] = ()

    __repr__ = brief()

    def __post_init__(self) -> None:
        if not text_of("name of a drive", self.name):
            raise InvalidInput("name of a drive: expected a text, got an empty one: give each drive a name")
        where = f"drive '{self.name}'"
        joints = items_of(f"joints of {where}", self.joints, str)
        if not joints or len(set(joints)) < len(joints):
            raise InvalidInput(f"joints of {where}: expected one or more joints, each once, got {shown(joints)}")
        arms = array_of(f"arms of {where}", self.arms, (None,))
        if len(arms) != len(joints):
            raise InvalidInput(f"arms of {where}: expected one per joint, {len(joints)}, got {len(arms)}")
        if not np.all((np.abs(arms) >= _LEAST_ARM) & (np.abs(arms) <= _LARGEST_ARM)):
            raise InvalidInput(
                f"arms of {where}: expected sizes from {_LEAST_ARM:g} to {_LARGEST_ARM:g}, got {arms.tolist()}: leave "
                "out joints that it does not move"
            )
        one_of(f"control of {where}", self.control, get_args(Control))
        flag(f"exact of {where}", self.exact)
        _optional(self, "stiffness", where, above=0)
        _optional(self, "damping", where, at_least=0)
        _optional(self, "step", where, above=0)
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
        sources = items_of(f"sources of {where}", self.sources, Source)
        _each_once(f"figures with a source of {where}", [source.figure for source in sources])
        checked = {"joints": joints, "arms": tuple(arms.tolist()), "limit": limit, "sources": sources}
        for key, value in checked.items():
            object.__setattr__(self, key, value)

    def source(self, figure: Figure) -> Source | None:
        """Where one of its figures comes from; None where that is not known."""
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
        InvalidInput: for values that make no spring.
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


def drive_record(drive: Drive) -> dict[str, Any]:
    """A drive as plain JSON values; None for a limit, stiffness, damping or step that is not known."""
    plain = asdict(drive) | {"limit": drive.limit if drive.limit < math.inf else None}
    plain["sources"] = [one | {"interval": one["interval"] and list(one["interval"])} for one in plain["sources"]]
    lists = {"joints": list(drive.joints), "arms": list(drive.arms), "efforts": drive.efforts and list(drive.efforts)}
    return plain | lists


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
        raise InvalidInput(f"{name}: expected each once, got more than once {shown(', '.join(twice))}")


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
    """What the drives, which move several joints each or leave some out, cannot choose of the torques of ``joints``.

    Jaws are geared: their joints share the force as the object has it. So do the joints of drives that are not exact.

    Raises:
        InvalidInput: names of joints that are no texts or come twice, or a drive of a joint that is not among them.
    """
    joints, drives = items_of("joints", joints, str), items_of("drives", drives, Drive)
    _each_once("joints", list(joints))
    for drive in drives:
        for joint in drive.joints:
            one_of(f"joint of drive '{drive.name}'", joint, joints)
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


# -- as a file has them ------------------------------------------------------------------------------------------------


@dataclass(slots=True, kw_only=True)
class Motor:
    """A motor as a file gives it: ``arms`` by joint, coupled ones and those outside of the hand included.

    ``remark``: what the user should know of it.
    """

    name: str
    arms: dict[str, float]
    control: Control = "torque"
    limit: float = math.inf
    efforts: tuple[float, float] | None = None
    stiffness: float | None = None
    damping: float | None = None
    remark: str = ""


@dataclass(slots=True, kw_only=True)
class Actuation:
    """Motors and springs of a file.

    Attributes:
        motors, springs: in the order of the file, at any of its joints.
        alone: coupled joints have one motor between them, even where the file names one at each.
        notes: for the user.
    """

    motors: list[Motor] = field(default_factory=list)
    springs: list[Spring] = field(default_factory=list)
    alone: bool = False
    notes: list[str] = field(default_factory=list)


def motors_at(found: Actuation) -> dict[str, list[str]]:
    """Names of a file's motors, by the joints that they move."""
    names: dict[str, list[str]] = {}
    for motor in found.motors:
        for joint in motor.arms:
            names.setdefault(joint, []).append(motor.name)
    return names


def drives_of(
    found: Actuation, joints: Sequence[str], couplings: Mapping[str, Coupling], efforts: ArrayLike
) -> tuple[Drive, ...]:
    """Drives of the independent ``joints`` (n), from the motors of a file.

    Args:
        found: motors at any joint; those at none of the hand's are left out.
        joints: names of the independent joints.
        couplings: of the coupled joints.
        efforts: limits of the joints (n,) [N m or N], infinity where there are none; they bound a motor at one joint.
    """
    limits = dict(zip(joints, np.ravel(efforts).tolist()))
    motors = _one_per_group(found.motors, couplings) if found.alone else found.motors
    drives: list[Drive] = []
    taken: Counter[str] = Counter()
    for motor in motors:
        arms: dict[str, float] = {}
        for joint, arm in motor.arms.items():
            one = couplings.get(joint, Coupling(followed=joint, factor=1.0, offset=0.0))
            if one.followed in limits:
                arms[one.followed] = arms.get(one.followed, 0.0) + arm * one.factor
        arms = {joint: arm for joint, arm in arms.items() if _LEAST_ARM <= abs(arm) <= _LARGEST_ARM}
        if not arms:
            continue
        limit, ways = motor.limit, motor.efforts
        if len(arms) == 1:
            limit = min(limit, *(limits[joint] / abs(arm) for joint, arm in arms.items()))
        if ways is not None:
            ways = max(ways[0], -limit), min(ways[1], limit)
        name = motor.name
        while name in taken:
            taken[motor.name] += 1
            name = f"{motor.name} {taken[motor.name]}"
        taken[name] += 1
        drives.append(
            Drive(
                name=name,
                joints=tuple(arms),
                arms=tuple(arms.values()),
                control=motor.control,
                limit=limit if limit > 0 else math.inf,
                efforts=ways if limit > 0 else None,
                stiffness=motor.stiffness if motor.control == "position" else None,
                damping=motor.damping,
            )
        )
    return tuple(drives)


def _one_per_group(motors: list[Motor], couplings: Mapping[str, Coupling]) -> list[Motor]:
    """Of the motors at joints that move together, the one at the joint that the others follow, or else the first."""
    kept: dict[str, Motor] = {}
    for motor in motors:
        (joint,) = motor.arms
        leader = couplings[joint].followed if joint in couplings else joint
        if leader == joint or leader not in kept:
            kept[leader] = motor
    return list(kept.values())


def remarks_on(motors: Iterable[Motor], joints: Iterable[str]) -> list[str]:
    """Notes on those of a file's motors that move any of the hand's ``joints``."""
    own = set(joints)
    told: dict[str, list[str]] = {}
    for motor in motors:
        if motor.remark and not own.isdisjoint(motor.arms):
            told.setdefault(motor.remark, []).append(motor.name)
    return [f"{ON_DRIVES}{remark}: {', '.join(names)}" for remark, names in told.items()]


def on_joints(drives: Iterable[Drive], joints: Sequence[str], efforts: ArrayLike) -> tuple[Drive, ...]:
    """What the drives do at ``joints``; those without a limit do at none more than its effort limit (n,) [N m or N]."""
    limits = dict(zip(joints, np.ravel(efforts).tolist()))
    found = []
    for drive in drives:
        arms = {joint: arm for joint, arm in zip(drive.joints, drive.arms) if joint in limits}
        if arms:
            limit = min(limits[joint] / abs(arm) for joint, arm in arms.items())
            limit = drive.limit if drive.limit < math.inf else limit
            ways = drive.efforts if limit == drive.limit else None
            found.append(replace(drive, joints=tuple(arms), arms=tuple(arms.values()), limit=limit, efforts=ways))
    return tuple(found)


def springs_of(found: Actuation, joints: Sequence[str], couplings: Mapping[str, Coupling]) -> tuple[Spring, ...]:
    """Springs at the independent ``joints``, from those of a file at any joint: one spring for all that act on one."""
    sums: dict[str, tuple[float, float]] = {}  # stiffness, and its product with the position at rest
    for spring in found.springs:
        one = couplings.get(spring.joint, Coupling(followed=spring.joint, factor=1.0, offset=0.0))
        if one.followed in joints:
            # A joint at f q + o: the torque on q is -k f (f q + o - rest).
            stiffness, moment = sums.get(one.followed, (0.0, 0.0))
            own = spring.stiffness * one.factor
            sums[one.followed] = (stiffness + own * one.factor, moment + own * (spring.rest - one.offset))
    return tuple(
        Spring(joint=joint, stiffness=stiffness, rest=moment / stiffness)
        for joint, (stiffness, moment) in sums.items()
        if stiffness > 0
    )
