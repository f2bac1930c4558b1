"""From a name or a file to a :class:`HandModel`: URDF, xacro or MJCF in; fingers found from tree and geometry."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, get_args

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import flag, instance_of, items_of, mapping_of, one_of, path_of, text_of
from pinograsp.errors import HandNotLoaded
from pinograsp.hands import geometry
from pinograsp.hands.body_checks import mend_bodies
from pinograsp.hands.catalogue import CATALOGUE, Entry
from pinograsp.hands.convex_cuts import cut_hollow_links
from pinograsp.hands.descriptions import RobotDescription, read_description
from pinograsp.hands.drives import ON_DRIVES, Drive, Spring, one_each
from pinograsp.hands.finger_names import Labels, name_fingers
from pinograsp.hands.geometry import collision_geometry, fill_masses, moving_nothing, without_shapes
from pinograsp.hands.joint_limits import placeholder_notes, with_effort_limits
from pinograsp.hands.linkage import without_levers
from pinograsp.hands.mesh_file import tells_unit
from pinograsp.hands.model import Finger, HandModel
from pinograsp.hands.motors import Actuation, drives_of, motors_at, on_joints, remarks_on, springs_of
from pinograsp.hands.sheets import apply_sheet, find_sheet
from pinograsp.hands.srdf import disabled_collisions, pairs_in
from pinograsp.hands.tree import find_fingers, joints_before, palms_in, tip_of, with_followed
from pinograsp.hands.unit_checks import size_notes, speed_notes
from pinograsp.hands.urdf import PreparedHand, prepare_hand
from pinograsp.spatial import FARTHEST

if TYPE_CHECKING:
    import mujoco


Masses = Literal["estimate", "file"]

ON_ROOT = "root: "
_ARM = 4  # joints before a palm; wrists have up to three
_HAND = 0.4  # [m] from a palm to a fingertip, at most


def load_hand(
    source: str | Path | mujoco.MjSpec,
    *,
    pose: ArrayLike | None = None,
    root: str | None = None,
    palm: str | None = None,
    fingers: dict[str, str] | None = None,
    limits: dict[str, tuple[float, float]] | None = None,
    drives: Sequence[Drive] | str | Path | None = None,
    springs: Sequence[Spring] | None = None,
    hulls: bool = True,
    trusted: bool = False,
    packages: Mapping[str, str | Path] | None = None,
    masses: Masses = "estimate",
    exclude: Sequence[str] = (),
    srdf: str | Path | None = None,
    posture: Mapping[str, float] | None = None,
    xacro_args: Mapping[str, object] | None = None,
) -> HandModel:
    """Load a hand by name or from a file.

    The model has only the actuated joints in q, torques and Jacobians; joints that mimic others follow them.

    Args:
        source: a name of :data:`~pinograsp.hands.catalogue.CATALOGUE` (``pinograsp hands`` lists them), the path of a
            ``.urdf``, ``.xacro`` or MJCF ``.xml`` file, the text of a URDF or MJCF, or a ``mujoco.MjSpec``, which is
            not changed. File names in a text are relative to the working folder. Also a name of the package
            ``mujoco_menagerie`` or ``robot_descriptions``, as ``menagerie:leap_hand/right_hand`` or
            ``robot_descriptions:barrett_hand_description`` (extra ``names``), which fetches the file when it is first
            used.
        pose: oMh (4, 4), the hand's root frame in the world; identity by default.
        root: link whose sub-tree is the hand, if it is mounted on an arm or a whole robot; its frame is the hand's root
            frame.
        palm: link from which the fingers start; by default the first link at which moving chains branch.
        fingers: names to use, ``{finger name: a link of its outermost part}``, which is the fingertip if it is fixed
            beyond the last joint; by default every chain from the palm to a leaf that has geometry, named after what
            its links have in common.
        limits: position limits that replace the file's, ``{joint: (lower, upper)}`` [rad or m]; noted on the model.
        drives: motors that replace those of the file and the catalogue. If neither names any, one at each joint is
            assumed, with a note. With a path, or the name of a data sheet of the package
            (:func:`~pinograsp.hands.sheets.list_sheets`), the figures of the sheet replace the file's. By default a
            sheet beside the file is read, such as ``hand.drives.toml`` beside ``hand.urdf``.
        springs: springs at joints that replace the file's.
        hulls: use the convex hulls of the links' meshes, as physics engines do; the plan names contacts on hollow
            links. False: use the meshes as they are; plans are slower then, and simulations differ.
        trusted: let a xacro file run everything xacro offers (see :mod:`pinograsp.hands.xacro_files`), and an MJCF file
            include files from outside its own folder.
        packages: folders of ROS packages, ``{name: folder}``, for ``$(find name)`` and ``package://name/``. Others are
            searched in the folders above the file, in ROS_PACKAGE_PATH and in AMENT_PREFIX_PATH; ROS is not needed.
        masses: masses of links without any: ``"estimate"`` takes them from their shapes, with a note; ``"file"`` leaves
            such links massless.
        exclude: links that cannot touch anything, such as a soft cover or a coarse shape; with a note.
        srdf: MoveIt's SRDF file for this robot. Checks of the hand against itself skip the pairs of links that this
            file disables, and those that an MJCF file excludes.
        posture: fixed positions of joints that belong to no finger, such as those of an arm in the same model,
            ``{joint: position}`` [rad or m]: see :meth:`HandModel.with_posture`.
        xacro_args: values of the xacro file's arguments, ``{name: value}``.

    Raises:
        HandNotLoaded: the file is missing or broken; all problems found are listed.
        ExtraMissing: the package that a name belongs to is not installed.
        InvalidInput: a name, a limit, a posture, a drive or a spring given here does not fit the hand.

    Example:
        >>> import pinograsp as pg
        >>> hand = pg.load_hand("panda")
        >>> print(hand.describe().splitlines()[0])
        hand panda: 1 joint that moves 1 more, 2 fingers on 'panda_hand', 0.760 kg (panda)

    See Also:
        :class:`~pinograsp.hands.HandModel`; :func:`~pinograsp.hands.attach` mounts a hand on an arm.
    """
    for argument, value in (("root", root), ("palm", palm)):
        instance_of(argument, value, str, type(None))
    flag("hulls", hulls)
    flag("trusted", trusted)
    one_of("masses", masses, get_args(Masses))
    exclude = items_of("exclude", exclude, str)
    if fingers is not None:
        fingers = {
            text_of("name of a finger", finger): text_of(f"link of finger '{finger}'", link)
            for finger, link in mapping_of("fingers", fingers, "{finger: link}").items()
        }
    entry = CATALOGUE.get(source) if isinstance(source, str) else None
    if entry is not None:
        root, palm, fingers = root or entry.root, palm or entry.palm, fingers or entry.fingers
    hand = build_hand(
        read_description(source, root, trusted, packages, xacro_args),
        palm=palm,
        fingers=fingers,
        entry=entry,
        limits=limits,
        drives=None if isinstance(drives, str | Path) else drives,
        sheets=_choose_sheets(source, entry, drives),
        springs=springs,
        hulls=hulls,
        masses=masses,
        exclude=exclude,
        srdf=srdf,
    )
    if posture is not None:
        hand = hand.with_posture(posture)
    return hand if pose is None else hand.placed(pose)


def build_hand(
    description: RobotDescription,
    *,
    palm: str | None = None,
    fingers: dict[str, str] | None = None,
    entry: Entry | None = None,
    limits: dict[str, tuple[float, float]] | None = None,
    drives: Sequence[Drive] | None = None,
    sheets: Sequence[str | Path] = (),
    springs: Sequence[Spring] | None = None,
    hulls: bool = True,
    masses: Masses = "estimate",
    exclude: Sequence[str] = (),
    srdf: str | Path | None = None,
) -> HandModel:
    """The hand of a description; ``entry``: of the catalogue, ``sheets``: of its drives, the others as for
    :func:`load_hand`, checked.
    """
    prepared = prepare_hand(description, limits if isinstance(limits, Mapping) else {})
    labels = {"motor": motors_at(description.actuation), **description.labels}
    hand = _build_hand(description.name, prepared, palm, fingers, masses, exclude, labels)
    hand = with_effort_limits(hand, prepared.efforts, () if entry is None else entry.drives or ())
    hand = _add_drives(hand, description.actuation, entry, drives, springs)
    for sheet in sheets:
        hand = apply_sheet(hand, sheet)
    hand = _disable_collisions(hand, description, prepared.links, srdf)
    hand = hand.with_limits({} if limits is None else limits)
    slides = hand.slides.tolist()
    odd = [*speed_notes(hand.joint_names, slides, hand.velocity), *size_notes(hand.model, hand.geometry)]
    doubtful = any(note.startswith(ON_ROOT) for note in hand.notes) and not _is_on_arm(prepared, hand.palm)
    hand = replace(hand, notes=(*hand.notes, *odd, *([] if doubtful else placeholder_notes(hand))))
    if hulls:
        ends = {finger.joint_ids[-1] for finger in hand.fingers} | ({0} if len(hand.fingers) == 1 else set())
        cut, told = cut_hollow_links(hand.geometry, ends)
        hand = replace(hand, geometry=cut, notes=(*hand.notes, *told))
        shapes = tuple(one.geometry for one in hand.geometry.geometryObjects)
        hand = replace(hand, geometry=geometry.hulls(hand.geometry), own_shapes=shapes)
    return hand


def _build_model(source: str, prepared: PreparedHand) -> pin.Model:
    """Pinocchio's model, with joints and frames under their own names."""
    try:
        model = pin.buildModelFromXML(prepared.text, True)
    except (ValueError, RuntimeError) as error:
        raise HandNotLoaded(source, f"Pinocchio cannot build a model: {error}") from error
    for j, joint in enumerate(model.names):
        model.names[j] = prepared.aliases.get(joint, joint)
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY:
            frame.name = prepared.aliases.get(frame.name, frame.name)
    _check_kinematics(source, model)
    armature = model.armature.copy()
    for joint, value in prepared.armatures.items():
        armature[model.joints[model.getJointId(joint)].idx_v] = value
    model.armature = armature
    return model


def _build_hand(
    source: str,
    prepared: PreparedHand,
    palm: str | None,
    names: dict[str, str] | None,
    masses: Masses,
    exclude: Sequence[str],
    labels: Labels,
) -> HandModel:
    """The hand without drives: its model, geometry, masses and fingers."""
    model, notes = _build_model(source, prepared), list(prepared.notes)
    geometry, unit = collision_geometry(model, prepared.shapes, notes)
    visuals = [
        replace(one, size=tuple(unit * size for size in one.size))
        if one.kind == "mesh" and not tells_unit(one.path)
        else one
        for one in prepared.visuals
    ]
    if not geometry.ngeoms:
        notes.append("neither collision nor visual shapes that can be read: nothing of this hand can touch")
    if masses == "estimate":
        fill_masses(model, geometry, prepared.unweighed, notes)
    elif prepared.unweighed:
        notes.append(f"no masses given, so massless: {', '.join(prepared.unweighed)}")
    mend_bodies(model, geometry, visuals, masses == "estimate", notes)
    geometry = without_shapes(geometry, model, [one_of("exclude", link, prepared.links) for link in exclude], notes)
    _check_masses(source, model, masses, notes)
    solid = {model.frames[one.parentFrame].name for one in geometry.geometryObjects}
    pinned: list[tuple[str, str]] = []
    palm, chains = find_fingers(
        source,
        prepared.joints,
        prepared.links,
        solid.__contains__,
        lambda chains: without_levers(model, geometry, chains, labels["motor"], pinned, notes),
        palm,
        names,
        lambda chains: name_fingers(chains, labels),
    )
    fingers = tuple(
        Finger.on_model(
            model,
            name,
            [part.joint.name for part in chain],
            [part.joint.child for part in chain],
            tip_of(chain),
        )
        for name, chain in chains.items()
    )
    notes += _on_root(model, prepared, solid, palm, fingers) or _on_pedestal(model, geometry, palm, fingers)
    return HandModel(
        name=prepared.name,
        source=source,
        model=model,
        geometry=geometry,
        palm=palm,
        fingers=fingers,
        pose=np.eye(4),
        notes=tuple(notes),
        description=prepared.text,
        visuals=tuple(visuals),
        disabled_collisions=tuple(pinned),
        continuous=tuple(prepared.continuous),
    )


def _is_on_arm(prepared: PreparedHand, palm: str) -> bool:
    """Whether so many joints come before the palm that they are those of an arm."""
    return joints_before(prepared.joints, palm) >= _ARM


def _on_root(
    model: pin.Model, prepared: PreparedHand, solid: set[str], palm: str, fingers: Sequence[Finger]
) -> list[str]:
    """A note where the file has more than a hand, with the root= that takes one alone."""

    def alone(link: str) -> str:
        return with_followed(prepared.joints, prepared.followed, link)

    if _is_on_arm(prepared, palm):
        root, before = alone(palm), joints_before(prepared.joints, palm)
        return [
            f"{ON_ROOT}{before} joints, those of an arm, come before the palm '{palm}': root='{root}' loads the hand "
            "alone"
        ]
    data = model.createData()
    pin.framesForwardKinematics(model, data, (model.lowerPositionLimit + model.upperPositionLimit) / 2)

    def near(one: str, other: str) -> bool:
        at, to = (data.oMf[model.getFrameId(name, pin.FrameType.BODY)].translation for name in (one, other))
        return float(np.linalg.norm(to - at)) < _HAND

    palms = palms_in(prepared.joints, prepared.links, solid.__contains__, near)
    if palms and palm not in palms:
        roots = dict.fromkeys(alone(one) for one in palms)
        return [f"{ON_ROOT}this looks like a whole robot: for a hand alone give root= {' or '.join(roots)}"]
    long = [finger for finger in fingers if len(finger.joints) > _ARM]
    arms = [finger for finger in long if len(fingers) == 1 or not near(palm, finger.tip)]
    if not arms:
        return []
    last = {finger.joints[-1] for finger in arms}
    roots = dict.fromkeys(alone(joint.parent) for joint in prepared.joints if joint.name in last)
    named = ", ".join(f"'{finger.name}' ({len(finger.joints)} joints)" for finger in arms)
    return [
        f"{ON_ROOT}{named}: an arm, not a finger, if it ends in one moving jaw: "
        f"{' or '.join(map('root={!r}'.format, roots))} loads that jaw alone"
    ]


def _on_pedestal(model: pin.Model, geometry: pin.GeometryModel, palm: str, fingers: Sequence[Finger]) -> list[str]:
    """A note on a link beside the palm, larger than a hand, with fingers inside at the middle of their ranges."""
    data, placed, request = model.createData(), geometry.createData(), coal.CollisionRequest()
    pin.forwardKinematics(model, data, (model.lowerPositionLimit + model.upperPositionLimit) / 2)
    pin.updateGeometryPlacements(model, data, geometry, placed)
    at = [coal.Transform3s(pose.rotation, pose.translation) for pose in placed.oMg]
    joints = {joint for finger in fingers for joint in finger.joint_ids}
    objects = list(geometry.geometryObjects)
    parts = [i for i, one in enumerate(objects) if one.parentJoint in joints]
    for i, one in enumerate(objects):
        link, shape = model.frames[one.parentFrame].name, one.geometry
        shape.computeLocalAABB()
        if one.parentJoint or link == palm or 2 * shape.aabb_radius < _HAND:
            continue
        if any(coal.collide(shape, at[i], objects[j].geometry, at[j], request, coal.CollisionResult()) for j in parts):
            return [f"{ON_ROOT}fingers are inside '{link}', which is not part of a hand: root='{palm}' leaves it out"]
    return []


def _add_drives(
    hand: HandModel,
    found: Actuation,
    entry: Entry | None,
    drives: Sequence[Drive] | None,
    springs: Sequence[Spring] | None,
) -> HandModel:
    """The hand with the drives and springs that are given, or else the catalogue's, or its file's; assumptions are
    noted.
    """
    joints, couplings, efforts = hand.joint_names, hand.couplings, hand.effort_or_infinity
    moving = {joint for finger in hand.fingers for joint in finger.actuated}
    notes: list[str] = []
    given = drives is not None
    if not given and entry is not None and entry.drives is not None:
        drives = on_joints(entry.drives, joints, efforts)  # another root= may leave some out
    elif drives is None:
        notes = [*found.notes, *remarks_on(found.motors, [*joints, *couplings])]
        drives = drives_of(found, joints, couplings, efforts)
        if not drives:
            drives = one_each(joints, efforts)
            notes.append(f"{ON_DRIVES}no motors are named; one torque motor at each joint is assumed")
        elif moving.isdisjoint(joint for drive in drives for joint in drive.joints):
            bare = [joint in moving for joint in joints]
            drives += one_each([joint for joint in joints if joint in moving], efforts[bare])
            notes.append(f"{ON_DRIVES}no motor of a finger is named; one torque motor at each of its joints is assumed")
    if not given and entry is not None:
        drives = tuple(
            drive if moving.isdisjoint(drive.joints) else replace(drive, sources=entry.sources) for drive in drives
        )
    hand = replace(hand, notes=(*hand.notes, *notes))
    hand = hand.with_drives(drives, springs_of(found, joints, couplings) if springs is None else springs)
    sprung = {spring.joint for spring in hand.springs}
    if held := [joint for joint in hand.passive_joints if joint in sprung]:
        why = (
            "in a plan, contacts get only the torque of the springs; if tendons or stops carry a part, give "
            "drives=[Drive(exact=False)]"
        )
        return replace(hand, notes=(*hand.notes, f"{ON_DRIVES}springs alone hold {', '.join(held)}: {why}"))
    return hand


def _choose_sheets(
    source: str | Path | mujoco.MjSpec, entry: Entry | None, drives: Sequence[Drive] | str | Path | None
) -> list[str | Path]:
    """Data sheets of a hand's drives, the later over the earlier: the catalogue's, the one given or beside the file."""
    if not isinstance(drives, str | Path | None):
        return []
    beside = find_sheet(source) if entry is None and isinstance(source, str | Path) else None
    found = [None if entry is None else entry.sheet, beside if drives is None else drives]
    return [sheet for sheet in found if sheet is not None]


def _check_masses(source: str, model: pin.Model, masses: Masses, notes: Sequence[str]) -> None:
    """Refuse a model with joints that move nothing."""
    if massless := moving_nothing(model):
        hint = "" if masses == "estimate" else ", or take masses='estimate'"
        problems = [f"joint '{joint}' moves no mass at all: give its links a mass{hint}" for joint in massless]
        raise HandNotLoaded(source, [*problems, *(note for note in notes if "mesh" in note)])


def _disable_collisions(
    hand: HandModel, description: RobotDescription, links: Sequence[str], srdf: str | Path | None
) -> HandModel:
    """The hand without more pairs of links, those whose collisions its description or an SRDF file disables."""
    pairs, notes = [*hand.disabled_collisions, *pairs_in(description.collisions, links)], list(hand.notes)
    if srdf is not None:
        driven = [joint for drive in hand.drives for joint in drive.joints]
        pairs += disabled_collisions(path_of("srdf", srdf).expanduser(), links, driven, notes)
    return replace(hand, disabled_collisions=tuple(dict.fromkeys(pairs)), notes=tuple(notes))


def _check_kinematics(source: str, model: pin.Model) -> None:
    """Refuse a model whose placements, Jacobians or inertias are not finite, or that is larger than any hand."""
    middle = 0.5 * (model.lowerPositionLimit + model.upperPositionLimit)
    for q in (model.lowerPositionLimit, middle, model.upperPositionLimit):
        data = model.createData()  # crba adds into a matrix that was there before
        pin.framesForwardKinematics(model, data, q)
        pin.computeJointJacobians(model, data, q)
        places = np.array([placement.translation for placement in data.oMf])
        M = pin.crba(model, data, q)
        if not (np.isfinite(places).all() and np.isfinite(data.J).all() and np.isfinite(M).all()):
            raise HandNotLoaded(
                source, "its kinematics are not finite within the joint limits: numbers too large or too small"
            )
        if np.abs(places).max() > FARTHEST:
            raise HandNotLoaded(
                source, f"it reaches farther than {FARTHEST:g} m from its root: expected lengths in metres"
            )
