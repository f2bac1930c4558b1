"""From a name or a file to a :class:`HandModel`: URDF, xacro or MJCF in; fingers found from tree and geometry."""

from __future__ import annotations

import codecs
import copy
import difflib
import os
import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal, cast, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import flag, instance_of, items_of, mapping_of, one_of, path_of, text_of
from pinograsp.errors import HandNotLoaded
from pinograsp.hands import geometry, urdf_drives
from pinograsp.hands.body_checks import mend_bodies
from pinograsp.hands.catalogue import CATALOGUE, Entry, convex_parts_of, file_of
from pinograsp.hands.drives import (
    ON_DRIVES,
    Actuation,
    Drive,
    Spring,
    drives_of,
    motors_at,
    on_joints,
    one_each,
    remarks_on,
    springs_of,
)
from pinograsp.hands.elements import is_text, parse, read_bytes
from pinograsp.hands.finger_names import Labels, names_of
from pinograsp.hands.geometry import Triangles, collision_geometry, fill_masses, moving_nothing, without_shapes
from pinograsp.hands.joint_limits import with_effort_limits
from pinograsp.hands.linkage import without_levers
from pinograsp.hands.mesh_file import LFS_POINTER, tells_unit
from pinograsp.hands.model import Finger, HandModel
from pinograsp.hands.ros_packages import Packages, packages_of
from pinograsp.hands.srdf import disabled_collisions, pairs_in
from pinograsp.hands.tree import Part, find_fingers, joints_before, palms_in, tip_of, with_followed
from pinograsp.hands.unit_checks import size_notes, speed_notes
from pinograsp.hands.urdf import Prepared, prepare
from pinograsp.hands.urdf_couplings import add_couplings
from pinograsp.hands.xacro_guard import expand_xacro
from pinograsp.spatial import FARTHEST

if TYPE_CHECKING:
    import mujoco

    from pinograsp.hands.mjcf_source import Compiled

Masses = Literal["estimate", "file"]

ON_ROOT = "root: "
_ARM = 4  # joints before a palm; wrists have up to three
_HAND = 0.4  # [m] from a palm to a fingertip, at most
# Python knows others, some of which take hours for a small file.
_ENCODINGS = r"utf-?8(-sig)?|utf-?16|us-ascii|ascii|latin-?1|iso-?8859-?\d+|(windows-|cp)\d+"


def load_hand(
    source: str | Path | mujoco.MjSpec,
    *,
    pose: ArrayLike | None = None,
    root: str | None = None,
    palm: str | None = None,
    fingers: dict[str, str] | None = None,
    limits: dict[str, tuple[float, float]] | None = None,
    drives: Sequence[Drive] | None = None,
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

    Joints that mimic others are reduced to the joints that move them: q, torques and Jacobians are those of the
    actuated joints.

    Args:
        source: a name of :data:`~pinograsp.hands.catalogue.CATALOGUE` (``pinograsp hands`` lists them), the path of a
            ``.urdf``, ``.xacro`` or MJCF ``.xml`` file, the text of a URDF or MJCF, or a ``mujoco.MjSpec``, which
            stays as it is. Files that a text names are looked for from the working folder on.
        pose: oMh (4, 4), the hand's root frame in the world; identity by default.
        root: link whose sub-tree is the hand, where it sits on an arm or a whole robot; its frame is the hand's root
            frame.
        palm: link the fingers start from; by default the first link at which moving chains part.
        fingers: names to use, ``{finger name: a link of its outermost part}``, which is the fingertip if it is fixed
            beyond the last joint; by default every chain from the palm to a leaf that has geometry, named after what
            its links have in common.
        limits: position limits that replace the file's, ``{joint: (lower, upper)}`` [rad or m]; noted on the model.
        drives: motors that replace the file's and the catalogue's; by default one at each joint, noted, where neither
            names any.
        springs: springs at joints that replace the file's.
        hulls: take the convex hulls of the links' meshes, as physics engines do; contacts where a link is hollow are
            told by the plan. False: the meshes as they are, for which plans are slower, and simulations differ.
        trusted: let a xacro file run everything xacro offers (see :mod:`pinograsp.hands.xacro_guard`), and an MJCF file
            include files from outside its own folder.
        packages: folders of ROS packages, ``{name: folder}``, for ``$(find name)`` and ``package://name/``. Others are
            looked for in the folders above the file, in ROS_PACKAGE_PATH and in AMENT_PREFIX_PATH; ROS is not needed.
        masses: of links without any: ``"estimate"`` takes them from their shapes, noted; ``"file"`` leaves such links
            massless.
        exclude: links whose shapes take no part in touching, as a cover that gives way, or a coarse shape; noted.
        srdf: file of MoveIt's for this robot: pairs of links whose collisions it disables are not looked at where the
            hand's own links are checked against each other; nor are those that an MJCF file excludes itself.
        posture: of joints of no finger, as of an arm in the same model, ``{joint: position}`` [rad or m], where they
            stay: see :meth:`HandModel.with_posture`.
        xacro_args: values of the xacro file's arguments, ``{name: value}``.

    Raises:
        HandNotLoaded: the file is missing or broken; all problems found are listed.
        InvalidInput: a name, a limit, a posture, a drive or a spring given here does not fit the hand.
    """
    for argument, value in (("root", root), ("palm", palm)):
        instance_of(argument, value, str, type(None))
    flag("hulls", hulls)
    flag("trusted", trusted)
    one_of("masses", masses, get_args(Masses))
    folders = packages_of(packages)
    arguments = dict(mapping_of("xacro_args", {} if xacro_args is None else xacro_args, "{name: value}"))
    exclude = items_of("exclude", exclude, str)
    if fingers is not None:
        fingers = {
            text_of("name of a finger", finger): text_of(f"link of finger '{finger}'", link)
            for finger, link in mapping_of("fingers", fingers, "{finger: link}").items()
        }
    entry = CATALOGUE.get(source) if isinstance(source, str) else None
    if entry is not None:
        root, palm, fingers = root or entry.root, palm or entry.palm, fingers or entry.fingers
    description = _read(source, root, arguments, trusted, folders)
    robot, found = description.robot, description.actuation
    prepared = prepare(
        description.name,
        robot,
        description.folder,
        description.root,
        description.problems,
        description.notes,
        packages=folders,
        inline=description.inline,
    )
    labels = {"motor": motors_at(found), **description.labels}
    hand = _hand_model(description.name, prepared, palm, fingers, masses, exclude, labels)
    hand = with_effort_limits(hand, prepared.efforts, () if entry is None else entry.drives or ())
    hand = _driven(hand, found, entry, drives, springs)
    pairs, told = pairs_in(robot, prepared.links), list(hand.notes)
    if srdf is not None:
        driven = [joint for drive in hand.drives for joint in drive.joints]
        pairs += disabled_collisions(path_of("srdf", srdf).expanduser(), prepared.links, driven, told)
    hand = replace(hand, disabled_collisions=tuple(dict.fromkeys(pairs)), notes=tuple(told))
    hand = hand.with_limits({} if limits is None else limits)
    slides = hand.slides.tolist()
    odd = [*speed_notes(hand.joint_names, slides, hand.velocity), *size_notes(hand.model, hand.geometry)]
    hand = replace(hand, notes=(*hand.notes, *odd))
    if posture is not None:
        hand = hand.with_posture(posture)
    if hulls:
        shapes = tuple(one.geometry for one in hand.geometry.geometryObjects)
        hand = replace(hand, geometry=geometry.hulls(hand.geometry), own_shapes=shapes)
    return hand if pose is None else hand.placed(pose)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Description:
    """What a source says, as a URDF.

    Attributes:
        name: what to call it in errors.
        robot: the URDF.
        folder: its relative paths start there.
        actuation: motors and springs.
        root: link whose sub-tree is the hand, where that is still to be cut out.
        labels: other names that tell what fingers are called.
        inline: meshes that come from no file.
        problems, notes: found so far.
    """

    name: str
    robot: ElementTree.Element
    folder: Path
    actuation: Actuation
    root: str | None = None
    labels: Labels = field(default_factory=dict)
    inline: Mapping[str, Triangles] = field(default_factory=dict)
    problems: list[str] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)


def _read(
    source: object, root: str | None, arguments: dict[str, object], trusted: bool, packages: Packages
) -> _Description:
    """The description that a name, a path, a text or a specification of MuJoCo's stands for."""
    if type(source).__name__ == "MjSpec":
        from pinograsp.hands.mjcf_source import compile_spec

        spec = cast("mujoco.MjSpec", source)
        return _from_mjcf(spec.modelname, compile_spec(spec.modelname, spec), root, Path())
    name = source if isinstance(source, str) else str(path_of("hand", source))
    if is_text(name):
        path, text, name = Path("text.xml"), name, "text"
    else:
        path = file_of(name) if name in CATALOGUE else _file(name)
        text = "" if path.suffix.lower() == ".xacro" else _text(name, path)
    if path.suffix.lower() == ".xacro":
        text = expand_xacro(path, arguments, trusted=trusted, packages=packages)
    elif arguments:
        raise HandNotLoaded(name, f"arguments {', '.join(arguments)} given, but only xacro files take arguments")
    robot = parse(name, text)
    if robot.tag == "mujoco":
        from pinograsp.hands.mjcf_source import compile_file

        return _from_mjcf(name, compile_file(name, robot, path, trusted), root, path.resolve().parent)
    if name in CATALOGUE:
        _in_convex_parts(robot, convex_parts_of(name))
    problems, notes = list[str](), list[str]()
    add_couplings(robot, problems, notes)
    return _Description(
        name=name,
        robot=robot,
        folder=path.resolve().parent,
        actuation=urdf_drives.actuation_of(robot, problems),
        root=root,
        problems=problems,
        notes=notes,
    )


def _from_mjcf(name: str, compiled: Compiled, root: str | None, folder: Path) -> _Description:
    from pinograsp.hands.mjcf import Urdf

    urdf = Urdf(name, compiled, root)
    return _Description(
        name=name,
        robot=urdf.robot,
        folder=folder,
        actuation=urdf.actuation,
        labels=urdf.labels,
        inline=urdf.inline,
        problems=urdf.problems,
        notes=urdf.notes,
    )


def _in_convex_parts(robot: ElementTree.Element, parts: Mapping[str, list[Path]]) -> None:
    """Put the files of convex parts where a collision shape has the mesh that they stand for."""
    for link in robot.iter("link"):
        for collision in link.findall("collision"):
            mesh = collision.find("geometry/mesh")
            files = [] if mesh is None else parts.get(Path(mesh.get("filename", "")).stem, [])
            for path in files:
                part = copy.deepcopy(collision)
                cast(ElementTree.Element, part.find("geometry/mesh")).set("filename", str(path))
                link.append(part)
            if files:
                link.remove(collision)


def _file(name: str) -> Path:
    """The file called ``name``, which is no name of the catalogue."""
    try:
        path = Path(name).expanduser()
    except RuntimeError:  # of an unknown user: ~name
        path = Path(name)
    if os.path.isfile(path):
        return path
    near = difflib.get_close_matches(name, CATALOGUE, n=1)
    hint = f"; did you mean '{near[0]}'?" if near else ""
    raise HandNotLoaded(
        name, f"no such file; expected a .urdf, .xacro or MJCF .xml file, or one of: {', '.join(CATALOGUE)}{hint}"
    )


def _text(name: str, path: Path) -> str:
    """Text of an XML file, in the encoding that it declares."""
    try:
        content = read_bytes(path)
        if content.startswith(LFS_POINTER):
            raise LookupError("it is a pointer of Git LFS to the file: run 'git lfs pull' where it was cloned")
        if content.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            return content.decode("utf-16")
        declared = re.match(rb"\s*<\?xml[^>]*encoding=[\"']([A-Za-z0-9._-]+)", content)
        encoding = declared[1].decode() if declared else "utf-8-sig"
        if not re.fullmatch(_ENCODINGS, encoding, re.IGNORECASE):
            raise LookupError(f"encoding '{encoding}' is not supported: save it as UTF-8")
        return content.decode(encoding)
    except (OSError, UnicodeError, LookupError) as error:
        raise HandNotLoaded(name, f"cannot be read as text: {error}") from error


def _hand_model(
    source: str,
    prepared: Prepared,
    palm: str | None,
    names: dict[str, str] | None,
    masses: Masses,
    exclude: Sequence[str],
    labels: Labels,
) -> HandModel:
    notes = list(prepared.notes)
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
    geometry, unit = collision_geometry(model, prepared.shapes, notes)
    visuals = [
        replace(one, size=tuple(unit * size for size in one.size))
        if one.kind == "mesh" and not tells_unit(one.path)
        else one
        for one in prepared.visuals
    ]
    if not geometry.ngeoms:
        notes.append("no collision geometry: nothing of this hand can touch")
    if masses == "estimate":
        fill_masses(model, geometry, prepared.unweighed, notes)
    elif prepared.unweighed:
        notes.append(f"no masses given, so massless: {', '.join(prepared.unweighed)}")
    mend_bodies(model, geometry, visuals, masses == "estimate", notes)
    geometry = without_shapes(geometry, model, [one_of("exclude", link, prepared.links) for link in exclude], notes)
    if massless := moving_nothing(model):
        hint = "" if masses == "estimate" else ", or take masses='estimate'"
        problems = [f"joint '{joint}' moves no mass at all: give its links a mass{hint}" for joint in massless]
        raise HandNotLoaded(source, [*problems, *(note for note in notes if "mesh" in note)])
    solid = {model.frames[one.parentFrame].name for one in geometry.geometryObjects}
    palm, chains = find_fingers(
        source,
        prepared.joints,
        prepared.links,
        solid.__contains__,
        lambda chains: without_levers(model, geometry, chains, notes),
        palm,
        names,
        lambda chains: names_of(chains, labels),
    )
    fingers = tuple(_finger(model, name, chain) for name, chain in chains.items())
    notes += _on_root(model, prepared, solid, palm, fingers)
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
        continuous=tuple(prepared.continuous),
    )


def _on_root(model: pin.Model, prepared: Prepared, solid: set[str], palm: str, fingers: Sequence[Finger]) -> list[str]:
    """A note where the file has more than a hand, with the root= that takes one alone."""

    def alone(link: str) -> str:
        return with_followed(prepared.joints, prepared.followed, link)

    if (before := joints_before(prepared.joints, palm)) >= _ARM:
        root = alone(palm)
        return [f"{ON_ROOT}{before} joints come before the palm '{palm}', an arm's: root='{root}' is the hand alone"]
    data = model.createData()
    pin.framesForwardKinematics(model, data, (model.lowerPositionLimit + model.upperPositionLimit) / 2)

    def near(one: str, other: str) -> bool:
        at, to = (data.oMf[model.getFrameId(name, pin.FrameType.BODY)].translation for name in (one, other))
        return float(np.linalg.norm(to - at)) < _HAND

    palms = palms_in(prepared.joints, prepared.links, solid.__contains__, near)
    if palms and palm not in palms:
        roots = dict.fromkeys(alone(one) for one in palms)
        return [f"{ON_ROOT}this looks like a whole robot: a hand alone is root= {' or '.join(roots)}"]
    long = [finger for finger in fingers if len(finger.joints) > _ARM]
    arms = [finger for finger in long if len(fingers) == 1 or not near(palm, finger.tip)]
    if not arms:
        return []
    last = {finger.joints[-1] for finger in arms}
    roots = dict.fromkeys(alone(joint.parent) for joint in prepared.joints if joint.name in last)
    named = ", ".join(f"'{finger.name}' ({len(finger.joints)} joints)" for finger in arms)
    return [
        f"{ON_ROOT}{named}: an arm, not a finger, if it ends in one jaw that moves: "
        f"{' or '.join(map('root={!r}'.format, roots))} takes that alone"
    ]


def _driven(
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
            notes.append(f"{ON_DRIVES}no motors are named, assumed is one torque motor at each joint")
        elif moving.isdisjoint(joint for drive in drives for joint in drive.joints):
            bare = [joint in moving for joint in joints]
            drives += one_each([joint for joint in joints if joint in moving], efforts[bare])
            notes.append(f"{ON_DRIVES}no motor of a finger is named, assumed is one torque motor at each of its joints")
    if not given and entry is not None:
        drives = tuple(
            drive if moving.isdisjoint(drive.joints) else replace(drive, sources=entry.sources) for drive in drives
        )
    hand = replace(hand, notes=(*hand.notes, *notes))
    return hand.with_drives(drives, springs_of(found, joints, couplings) if springs is None else springs)


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


def _finger(model: pin.Model, name: str, chain: list[Part]) -> Finger:
    joints = tuple(part.joint.name for part in chain)
    ids = tuple(model.getJointId(joint) for joint in joints)
    dofs = list(dict.fromkeys(model.joints[j].idx_v for j in ids))
    actuated = {model.joints[j].idx_v: model.names[j] for j in range(1, model.njoints) if model.joints[j].nv}
    return Finger(
        name=name,
        joints=joints,
        links=tuple(part.joint.child for part in chain),
        tip=tip_of(chain),
        joint_ids=ids,
        dofs=np.array(dofs),
        actuated=tuple(actuated[i] for i in dofs),
    )
