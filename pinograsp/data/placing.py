"""Grasps of a file on the user's own description of the hand: its root's placements and its joints' positions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, floats_of, instance_of, mapping_of, one_of, placement_of, read_only
from pinograsp.data.alignment import Alignment, JointAxes, alignment, joint_axes
from pinograsp.data.conventions import CONVENTIONS, Convention, known_names
from pinograsp.data.formats import FORMATS
from pinograsp.data.rows import GraspRows
from pinograsp.errors import InvalidInput
from pinograsp.hands.model import HandModel
from pinograsp.spatial import Array, inverse_of

# [m] between axes of two descriptions of the same hand: DexGraspNet's Shadow and newer ones differ by 1.8 mm
_ALIKE = 3e-3
_FRAME_OFF = 5e-3  # [m] and, times 0.05 m, [rad]: a frame that is given is another one than the joints' axes tell
_STILL = 1e-6  # [rad or m] of a joint that the hand has not
_COUPLED = 2e-3  # [rad or m] of a joint that follows another
_JAW_AXIS = 0.0584  # [m] from panda_hand to its fingers' frames

Names = Mapping[str, str | None] | Sequence[str]


def place_hand(
    rows: GraspRows,
    hand: HandModel,
    *,
    joints: Names | None = None,
    frame: str | None = None,
    palm_in_root: ArrayLike | None = None,
    original: HandModel | None = None,
    convention: str | None = None,
    at: Mapping[str, ArrayLike] | None = None,
) -> tuple[Array, Array]:
    """Compute where the hand is in these grasps: placements bMh (N, 4, 4) of its root frame in the object's, and its q
    (N, n).

    Data sets use other frames, names, orders and directions of joints than the hand's own file. For public ones the
    package knows them (:data:`~pinograsp.data.conventions.CONVENTIONS`); otherwise they come from ``original``: joints
    are matched by name, and the alignment of their axes gives the placement of the file's root in the hand and the
    direction of each joint. Descriptions that differ by more than 3 mm are rejected.

    Args:
        rows: the grasps.
        hand: the hand of these grasps.
        joints: the hand's joints by those of the file, ``{file: hand}`` (None: leave it out; the file must have 0), in
            addition to those whose names are known; or the hand's joints in the order of the file, for all of them.
        frame: link of the hand that is the file's root frame.
        palm_in_root: hMf (4, 4), the file's root frame in the hand's root frame, instead. For GraspNet it is a frame
            between the fingertips' ends: x approaches, y closes.
        original: the file's own description of the hand, whose root frame is the file's.
        convention: a name of ``CONVENTIONS``, if the file alone does not determine it.
        at: positions of joints that the file does not give, ``{hand's joint: position}``, also (N,) [rad or m].

    Raises:
        InvalidInput: something does not match; the message says what, and what to give.
    """
    instance_of("rows", rows, GraspRows)
    instance_of("hand", hand, HandModel)
    known = _choose_convention(rows, convention, frame, palm_in_root, original)
    match = _match_joints(rows, hand, joints, known, original)
    given = _check_given(rows, hand, at)
    q = _positions(rows, hand, match, given)
    resting = {name: float(values[0]) for name, values in given.items() if len(values)}
    names = hand.joint_names
    pairs = [pair for pair in match.pairs if pair[1] in names]
    laid = _lay_axes(hand, pairs, match, resting)
    root = _root(rows, hand, laid, frame, palm_in_root, known, resting)
    if laid is not None:
        for (_, name), sign in zip(pairs, laid.signs):
            q[:, names.index(name)] *= sign
    poses = np.array(rows.poses)
    kind = FORMATS.get(rows.format)
    if kind is not None and kind.reach in rows.labels:
        poses[:, :3, 3] += rows.labels[kind.reach][:, None] * poses[:, :3, 0]
    return read_only(poses @ inverse_of(root)), read_only(q)


@dataclass(kw_only=True, eq=False)
class _Match:
    """Joints of the file and of the hand.

    Attributes:
        file: names of the file's joints, in its order.
        pairs: (file's joint, hand's joint), in the order of the file.
        axes: of the file's joints, where they are known, by the file's names.
        what: whose axes, in words.
    """

    file: tuple[str, ...]
    pairs: list[tuple[str, str]]
    axes: JointAxes | None
    what: str


def _choose_convention(
    rows: GraspRows, name: str | None, frame: object, palm_in_root: object, original: object
) -> Convention | None:
    if name is not None:
        return CONVENTIONS[one_of("convention", name, CONVENTIONS)]
    if original is not None:
        return None
    if (meant := _find_convention(rows)) is not None:
        return meant
    if frame is None and palm_in_root is None:
        kind = FORMATS.get(rows.format)
        which = (kind.ask if kind is not None else "") or f"convention=, one of {', '.join(CONVENTIONS)}"
        raise InvalidInput(
            f"rows: the frame and the joints of hand '{rows.hand_name}' in a file of format {rows.format} are not "
            f"known: give {which}; or original=, the file's own description of the hand; or frame= or palm_in_root= "
            "with joints="
        )
    return None


def _find_convention(rows: GraspRows) -> Convention | None:
    """What a file means, as far as its format, names and number of joints tell."""
    kind = FORMATS.get(rows.format)
    return None if kind is None else CONVENTIONS.get(kind.convention(rows) or "")


def _match_joints(
    rows: GraspRows, hand: HandModel, joints: Names | None, known: Convention | None, original: HandModel | None
) -> _Match:
    """Which joint of the hand each of the file's is."""
    width = rows.q.shape[1]
    names = () if joints is None or isinstance(joints, Mapping) else _names(joints, width)
    file = rows.joint_names or (known.joints if known is not None and len(known.joints) == width else names)
    if len(file) != width:
        wanted = "" if known is None or not known.joints else f", and {known.name} has {len(known.joints)} joints"
        raise InvalidInput(
            f"joints: the file does not name its {width} joints{wanted}: give the hand's joints in the file's order"
        )
    there = (*hand.joint_names, *hand.couplings)
    naming = known or _find_convention(rows)
    match = dict(zip(file, names)) if names else _by_name(file, there, naming)
    if isinstance(joints, Mapping):
        for name, target in mapping_of("joints", joints, "{file's joint: hand's joint}").items():
            one_of("joints: joint of the file", name, file)
            match.pop(name, None)
            if target is not None:
                match[name] = target
    for target in match.values():
        one_of(f"joints: joint of hand '{hand.name}'", target, there)
    if len(set(match.values())) < len(match):
        raise InvalidInput("joints: expected each joint of the hand once")
    axes, what = None, ""
    if original is not None:
        axes, what = joint_axes(instance_of("original", original, HandModel)), "original"
        odd = [name for name in match if name not in axes.names]
        if odd:
            raise InvalidInput(f"original: expected the file's joints, got none called {', '.join(odd[:6])}")
    elif known is not None and known.axes is not None:
        axes, what = _rename_axes(known, file), f"the hand that {known.name} is for"
    pairs = [(name, match[name]) for name in file if name in match]
    return _Match(file=file, pairs=pairs, axes=axes, what=what)


def _names(joints: object, count: int) -> tuple[str, ...]:
    """``joints`` as the names of ``count`` joints, or :class:`InvalidInput`."""
    names = tuple(joints) if isinstance(joints, Sequence) and not isinstance(joints, str) else ()
    if len(names) != count or not all(isinstance(name, str) for name in names):
        raise InvalidInput(f"joints: expected {{file's joint: hand's joint}}, or {count} names of the hand's joints")
    return names


def _by_name(file: Sequence[str], there: Sequence[str], known: Convention | None) -> dict[str, str]:
    """Joints whose names are the same, or mean the same in their family."""
    match = {name: name for name in file if name in there}
    if known is not None and len(match) < len(file):
        ours, theirs = known_names(known.family, file), known_names(known.family, there)
        match = {name: theirs[shared] for shared, name in ours.items() if shared in theirs}
    return match


def _rename_axes(known: Convention, file: Sequence[str]) -> JointAxes:
    """The convention's axes under the file's names."""
    assert known.axes is not None
    ours, theirs = known_names(known.family, file), known_names(known.family, known.axes.names)
    both = [(name, theirs[shared]) for shared, name in ours.items() if shared in theirs]
    axes = known.axes.choose([one for _, one in both])
    return JointAxes(names=tuple(name for name, _ in both), origins=axes.origins, directions=axes.directions)


def _check_given(rows: GraspRows, hand: HandModel, at: Mapping[str, ArrayLike] | None) -> dict[str, Array]:
    given = {}
    for name, value in mapping_of("at", {} if at is None else at, "{hand's joint: position}").items():
        one_of(f"at: joint of hand '{hand.name}'", name, hand.joint_names)
        values = floats_of(f"at: '{name}'", value)
        given[name] = array_of(f"at: '{name}'", np.full(rows.n, values) if values.ndim == 0 else values, (rows.n,))
    return given


def _positions(rows: GraspRows, hand: HandModel, match: _Match, given: dict[str, Array]) -> Array:
    """q (N, n) before joints that count the other way are turned."""
    columns = {name: rows.q[:, at] for at, name in enumerate(match.file)}
    paired = dict(match.pairs)
    left = [name for name in match.file if name not in paired and np.abs(columns[name]).max(initial=0) > _STILL]
    if left:
        raise InvalidInput(
            f"rows: hand '{hand.name}' has no joint for {', '.join(left[:8])} of the file, which move: give "
            f"joints={{file's: hand's}} (the hand has {', '.join(hand.joint_names[:30])})"
        )
    q, names = np.tile(hand.resting, (rows.n, 1)), hand.joint_names
    missing = []
    of_fingers = {name for finger in hand.fingers for name in finger.actuated}
    targets = set(paired.values())
    for i, name in enumerate(names):
        if name in given:
            q[:, i] = given[name]
        elif name not in targets and name in of_fingers:
            missing.append(name)
    for name, target in match.pairs:
        if target in names:
            q[:, names.index(target)] = columns[name]
    if missing and rows.widths is not None and _is_panda(hand) and len(missing) == 1:
        q[:, names.index(missing.pop())] = rows.widths / 2
    if missing:
        raise InvalidInput(
            f"rows: the file gives no position of {', '.join(missing[:8])} of hand '{hand.name}': give joints= for "
            "joints of other names, or at= for their positions"
        )
    for name, target in match.pairs:
        if target not in names:
            _check_coupled(hand, name, target, columns, {one: file for file, one in match.pairs})
    return q


def _check_coupled(hand: HandModel, name: str, target: str, columns: dict[str, Array], file_of: dict[str, str]) -> None:
    coupling = hand.couplings[target]
    leader = columns.get(file_of.get(coupling.followed, ""))
    if leader is None:
        return
    off = np.abs(np.abs(columns[name]) - np.abs(coupling.factor * leader + coupling.offset)).max(initial=0)
    if off > _COUPLED:
        raise InvalidInput(
            f"rows: joint '{target}' of hand '{hand.name}' follows '{coupling.followed}', and the file moves "
            f"'{name}' on its own (off by {off:.3g}): give a description of the hand without this coupling"
        )


def _lay_axes(
    hand: HandModel, pairs: list[tuple[str, str]], match: _Match, resting: dict[str, float]
) -> Alignment | None:
    """The file's axes laid on the hand's; None where they are not known, or too few."""
    if match.axes is None:
        return None
    pairs = [pair for pair in pairs if pair[0] in match.axes.names]
    if len(pairs) < 3:
        raise InvalidInput(
            f"joints: expected at least three joints of hand '{hand.name}' that the file has, got "
            f"{len(pairs)}: the file has {', '.join(match.file[:30])}; give joints={{file's: hand's}}"
        )
    theirs = match.axes.choose([name for name, _ in pairs])
    slides = b"" if theirs.slides is None else theirs.slides.tobytes()
    laid = _lay(
        hand,
        tuple(target for _, target in pairs),
        tuple(resting.items()),
        theirs.names,
        theirs.origins.tobytes() + theirs.directions.tobytes() + slides,
    )
    if laid.residual > _ALIKE:
        here, there = laid.worst
        raise InvalidInput(
            f"hand '{hand.name}' is not {match.what}, or has other zeros, or is the other side: axes differ by "
            f"{1e3 * laid.residual:.1f} mm, most at '{here}' ('{there}' of the file); give original=, or joints="
        )
    return laid


@lru_cache(maxsize=8)  # the same for all files of a data set
def _lay(
    hand: HandModel,
    joints: tuple[str, ...],
    resting: tuple[tuple[str, float], ...],
    names: tuple[str, ...],
    numbers: bytes,
) -> Alignment:
    """Axes of others laid on those of a hand's ``joints``; ``numbers``: origins, directions, and which slide."""
    count = 48 * len(names)
    origins, directions = np.frombuffer(numbers[:count]).reshape(2, -1, 3)
    slides = np.frombuffer(numbers[count:], dtype=bool) if len(numbers) > count else None
    theirs = JointAxes(names=names, origins=origins, directions=directions, slides=slides)
    return alignment(joint_axes(hand, joints, dict(resting)), theirs)


def _root(
    rows: GraspRows,
    hand: HandModel,
    laid: Alignment | None,
    frame: str | None,
    palm_in_root: ArrayLike | None,
    known: Convention | None,
    resting: dict[str, float],
) -> Array:
    """hMf (4, 4): the file's root frame in the hand's."""
    if frame is not None and palm_in_root is not None:
        raise InvalidInput("frame, palm_in_root: expected one of them")
    given = None
    if palm_in_root is not None:
        given = placement_of("palm_in_root", palm_in_root)
    elif frame is not None:
        given = _frame(hand, frame, resting)
    if laid is not None:
        if given is not None:
            off = inverse_of(laid.pose) @ given
            turn = float(np.arccos(np.clip((np.trace(off[:3, :3]) - 1) / 2, -1, 1)))
            if max(float(np.linalg.norm(off[:3, 3])), 0.05 * turn) > _FRAME_OFF:
                name, far = "palm_in_root" if frame is None else "frame", 1e3 * np.linalg.norm(off[:3, 3])
                raise InvalidInput(
                    f"{name}: by the joints' axes the file's root frame is {far:.1f} mm and {np.degrees(turn):.1f} deg "
                    "away from it: leave it out"
                )
            return given
        return laid.pose
    if given is not None:
        return given
    if known is not None and known.pose is not None:
        return _jaws(hand, known, resting)
    raise InvalidInput(
        f"rows: where the file's root frame is in hand '{hand.name}' is not known: give frame= or palm_in_root="
    )


def _frame(hand: HandModel, name: str, resting: dict[str, float]) -> Array:
    """A frame of the hand that its fingers do not move, in its root frame (4, 4)."""
    q = np.array(hand.resting)
    for joint, value in resting.items():
        q[hand.joint_names.index(joint)] = value
    moved = {j for finger in hand.fingers for j in finger.joint_ids}
    parent = hand.model.frames[hand.frame_id(name)].parentJoint
    if moved & set(hand.model.supports[parent]):
        raise InvalidInput(f"frame: expected a link that no finger's joint moves, as '{hand.palm}', got '{name}'")
    return np.asarray(inverse_of(np.asarray(hand.pose)) @ hand.frame_placements(q, [name])[0])


def _is_panda(hand: HandModel) -> bool:
    return any(hand.model.existFrame(link) for link in CONVENTIONS["panda_graspgen"].link) and hand.n == 1


def _jaws(hand: HandModel, known: Convention, resting: dict[str, float]) -> Array:
    """The root frame of jaws by a link of theirs, whose fingers slide as they should."""
    link = next((name for name in known.link if hand.model.existFrame(name)), None)
    if link is None:
        raise InvalidInput(
            f"hand '{hand.name}': expected a link {' or '.join(known.link)}, whose frame is known for {known.name}; "
            "for other jaws give palm_in_root=, the file's root frame in the hand's root frame"
        )
    frame = _frame(hand, link, resting)
    fingers = [name for finger in hand.fingers for name in finger.actuated]
    axes = joint_axes(hand, list(dict.fromkeys(fingers)), resting).move(inverse_of(frame))
    off = np.abs(np.cross(axes.directions, [0.0, 1.0, 0.0])).max(initial=0)
    height = np.abs(axes.origins[:, 2] - _JAW_AXIS).max(initial=0)
    if not len(axes.names) or off > 1e-3 or height > 1e-3:
        raise InvalidInput(
            f"hand '{hand.name}': expected fingers that slide along y, {1e3 * _JAW_AXIS:g} mm before '{link}': it is "
            f"not the gripper of {known.name}; give palm_in_root="
        )
    assert known.pose is not None
    return frame @ known.pose
