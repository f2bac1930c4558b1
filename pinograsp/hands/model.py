"""A hand as the other rooms see it: a Pinocchio model placed in the world, and its fingers."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from typing import Any

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import (
    array_of,
    brief,
    integer,
    items_of,
    mapping_of,
    number,
    one_of,
    placement_of,
    read_only,
    text_of,
)
from pinograsp.errors import InvalidInput
from pinograsp.hands.coupling import Coupling
from pinograsp.hands.drives import (
    ON_DRIVES,
    ON_SPRINGS,
    Drive,
    Ratio,
    Spring,
    checked_drives,
    checked_springs,
    ratios_of,
    transmission,
)
from pinograsp.hands.geometry import Shape
from pinograsp.hands.hand_lines import beyond_effort, describe_hand
from pinograsp.hands.mesh_file import pack_shapes, unpack_shapes
from pinograsp.hands.unit_checks import ON_LIMITS, limit_notes
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array, BoolArray, IntArray, pose_of


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finger:
    """A serial chain from the palm to a fingertip.

    Attributes:
        name: finger name.
        joints: moving joints, base to tip, coupled ones included.
        links: the link each joint moves.
        tip: frame at the fingertip (the outermost link fixed beyond the last joint).
        joint_ids: Pinocchio joint indices, one per joint.
        dofs: positions (n,) in q and v of the actuated joints that move the finger; coupled fingers share them.
        actuated: the names of those joints.
    """

    name: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    tip: str
    joint_ids: tuple[int, ...]
    dofs: IntArray
    actuated: tuple[str, ...]

    __repr__ = brief()

    @classmethod
    def on_model(cls, model: pin.Model, name: str, joints: Sequence[str], links: Sequence[str], tip: str) -> Finger:
        """The finger of these moving joints, base to tip, and the links that they move."""
        ids = tuple(int(model.getJointId(joint)) for joint in joints)
        dofs = list(dict.fromkeys(model.joints[j].idx_v for j in ids))
        actuated = {model.joints[j].idx_v: model.names[j] for j in range(1, model.njoints) if model.joints[j].nv}
        return cls(
            name=name,
            joints=tuple(joints),
            links=tuple(links),
            tip=tip,
            joint_ids=ids,
            dofs=np.array(dofs),
            actuated=tuple(actuated[i] for i in dofs),
        )

    @property
    def n(self) -> int:
        """Number of actuated joints."""
        return len(self.dofs)

    def joint_of(self, link: str) -> int:
        """Pinocchio index of the joint that moves ``link``."""
        return self.joint_ids[self.links.index(one_of(f"link of finger '{self.name}'", link, self.links))]

    @property
    def coupled(self) -> bool:
        """Whether joints of the finger move together."""
        return self.n < len(self.joints)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandModel:
    """A hand placed in the world.

    Attributes:
        name: hand name.
        source: the file it came from.
        model: Pinocchio model; its universe frame is the world o, the palm is fixed in it. q and v are those of the
            actuated joints: joints that follow others are Pinocchio's mimic joints.
        geometry: collision geometry of palm and links.
        palm: link from which the fingers start.
        fingers: in the order of the description.
        pose: oMh (4, 4), the hand's root frame in the world.
        notes: remarks for the caller (widened limits, coupled joints, missing meshes...).
        description: the URDF text that the model was built from.
        own_shapes: the links' shapes as in the file, in the order of ``geometry``, if that has their convex hulls.
        drives: the motors (m), and the joints that each of them moves.
        springs: springs at joints; torques do not include theirs.
        disabled_collisions: pairs of links that are not checked for collisions with each other.
        visuals: what is visible of the links, if the description has it; pictures read its meshes.
        posture: fixed positions of joints that belong to no finger, such as an arm's, ``{joint: position}`` [rad or m];
            others are at 0.
        continuous: joints that turn without end; their limits, -180 and 180 deg, do not apply to the path of an arm.

    Example:
        >>> import pinograsp as pg
        >>> hand = pg.load_hand("allegro_right")
        >>> print(len(hand.joint_names), "joints;", *(finger.name for finger in hand.fingers))
        16 joints; index middle ring thumb

    See Also:
        :func:`~pinograsp.hands.load_hand` and :func:`~pinograsp.hands.attach`, which make hands.
    """

    name: str
    source: str
    model: pin.Model
    geometry: pin.GeometryModel
    palm: str
    fingers: tuple[Finger, ...]
    pose: Array
    notes: tuple[str, ...] = ()
    description: str = ""
    own_shapes: tuple[coal.CollisionGeometry, ...] = ()
    drives: tuple[Drive, ...] = ()
    springs: tuple[Spring, ...] = ()
    disabled_collisions: tuple[tuple[str, str], ...] = ()
    visuals: tuple[Shape, ...] = ()
    posture: Mapping[str, float] = field(default_factory=dict)
    continuous: tuple[str, ...] = ()

    __repr__ = brief("name", "n", "fingers", "palm", "source")
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        return self.describe()

    def __reduce__(self) -> tuple[Callable[..., HandModel], tuple[object, ...]]:
        values = {field.name: getattr(self, field.name) for field in fields(self)}
        return _unpickle, tuple((values | {"own_shapes": pack_shapes(self.own_shapes)}).values())

    @property
    def n(self) -> int:
        """Number of actuated joints of the whole model."""
        return int(self.model.nv)

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the actuated joints in the order of q."""
        model = self.model
        return tuple(model.names[j] for j in range(1, model.njoints) if model.joints[j].nv)

    @property
    def lower(self) -> Array:
        """Lower joint limits (n,) [rad or m]."""
        return read_only(self.model.lowerPositionLimit)

    @property
    def upper(self) -> Array:
        """Upper joint limits (n,) [rad or m]."""
        return read_only(self.model.upperPositionLimit)

    @property
    def travel(self) -> tuple[Array, Array]:
        """Ends of the joints' travel (n,), (n,) [rad or m]: their limits; infinity for a joint that turns without
        end.
        """
        endless = np.isin(self.joint_names, self.continuous)
        return read_only(np.where(endless, -np.inf, self.lower)), read_only(np.where(endless, np.inf, self.upper))

    @property
    def resting(self) -> Array:
        """q (n,) [rad or m] with the joints of ``posture`` where they stay and all others at 0."""
        return read_only(np.array([self.posture.get(joint, 0.0) for joint in self.joint_names]))

    @property
    def arm(self) -> IntArray:
        """Which of the actuated joints carry the palm (a,): those of an arm, from its root on; empty for a hand
        alone.
        """
        palm = self.model.frames[self.frame_id(self.palm)].parentJoint
        joints = [self.model.joints[j] for j in self.model.supports[palm] if j]
        return np.array([joint.idx_v for joint in joints if joint.nv], dtype=int)

    @property
    def effort(self) -> Array:
        """Effort limits (n,) [N m or N]; 0 if there is none. For a joint that moves several jaws: of all of them."""
        return read_only(self.model.effortLimit)

    @property
    def effort_or_infinity(self) -> Array:
        """Effort limits (n,) [N m or N]; infinity if the description has none."""
        return read_only(np.where(self.effort > 0, self.effort, np.inf))

    @property
    def couplings(self) -> dict[str, Coupling]:
        """For each coupled joint, the actuated joint that moves it, and how."""
        model, names, couplings = self.model, self.joint_names, {}
        for j in range(1, model.njoints):
            if not model.joints[j].nv:
                mimic = model.joints[j].extract()
                couplings[model.names[j]] = Coupling(
                    followed=names[mimic.idx_v], factor=float(mimic.scaling), offset=float(mimic.offset)
                )
        return couplings

    @property
    def transmission(self) -> Array:
        """Arms (m, n) of the drives: joint torques (n,) are its transpose times the drives' efforts (m,)."""
        return transmission(self.joint_names, self.drives)

    @property
    def passive_joints(self) -> tuple[str, ...]:
        """Independent joints that no drive moves."""
        moved = {joint for drive in self.drives for joint in drive.joints}
        return tuple(joint for joint in self.joint_names if joint not in moved)

    @property
    def direct_drive(self) -> bool:
        """Whether each independent joint has one motor of its own, so that its torque can be chosen separately."""
        single = all(len(drive.joints) == 1 for drive in self.drives)
        return single and len(self.drives) == self.n and not self.passive_joints

    @property
    def ratios(self) -> tuple[Ratio, ...]:
        """Combinations of the joint torques that the drives cannot choose; empty if each joint has its own drive."""
        return () if self.direct_drive else ratios_of(self.joint_names, self.drives)

    def finger(self, name: str) -> Finger:
        """Return the finger called ``name``; an unknown name raises :class:`InvalidInput`, which lists the names."""
        names = [finger.name for finger in self.fingers]
        one_of(f"finger of hand '{self.name}'", name, names)
        return self.fingers[names.index(name)]

    @property
    def velocity(self) -> Array:
        """Velocity limits (n,) [rad/s or m/s]; 0 if the description has none."""
        return read_only(self.model.velocityLimit)

    @property
    def speed_limits(self) -> Array:
        """Those speeds (n,); infinity: none is given [rad/s or m/s]."""
        return read_only(np.where(self.velocity > 0, self.velocity, np.inf))

    @property
    def mass(self) -> float:
        """Mass of palm and fingers [kg]; the palm counts only if the description has its mass."""
        return float(sum(inertia.mass for inertia in self.model.inertias))

    def finger_mass(self, name: str) -> float:
        """Mass of a finger's moving links [kg]."""
        return float(sum(self.model.inertias[j].mass for j in self.finger(name).joint_ids))

    def configuration(self, angles: Mapping[str, ArrayLike]) -> Array:
        """q (n,) [rad] with the given fingers at the given joint angles and every other joint at ``resting``."""
        q = np.array(self.resting)
        for name, values in mapping_of("angles", angles, "{finger: joint angles}").items():
            finger = self.finger(name)
            q[finger.dofs] = array_of(f"joint angles of '{name}'", values, (finger.n,))
        return q

    def is_prismatic(self, joint_id: int) -> bool:
        """Whether a joint slides (its q in m, its effort in N) rather than turns."""
        joint = self._joint(joint_id)
        kind: str = joint.shortname()
        if kind == "JointModelMimic":  # only its text names its own type
            return "Mimicking joint type: JointModelP" in str(joint.extract())
        return kind.startswith("JointModelP")

    @property
    def slides(self) -> BoolArray:
        """Which actuated joints slide rather than turn (n,), in the order of q."""
        return np.array([self.is_prismatic(self.model.getJointId(name)) for name in self.joint_names], dtype=bool)

    def ratio(self, joint_id: int) -> float:
        """Motion of a joint per unit of the actuated joint that it follows; 1 for an actuated joint."""
        joint = self._joint(joint_id)
        return float(joint.extract().scaling) if joint.shortname() == "JointModelMimic" else 1.0

    def _joint(self, joint_id: int) -> pin.JointModel:
        return self.model.joints[integer("joint", joint_id, at_least=0, at_most=self.model.njoints - 1)]

    def joint_inertia(self, q: ArrayLike) -> Array:
        """Inertia of the joints in a posture q (n,), including the motors (n, n) [kg m^2 or kg]."""
        upper = np.triu(pin.crba(self.model, self.model.createData(), array_of("q", q, (self.n,))))
        whole: Array = upper + np.triu(upper, 1).T
        return whole

    def frame_placements(self, q: ArrayLike, names: Iterable[str]) -> Array:
        """Placements oMf (..., len(names), 4, 4) of the named frames at ``q`` (n,) or an array (f, n) [rad]."""
        many = isinstance(q, np.ndarray) and q.ndim == 2
        rows = array_of("q", q, (None, self.n)) if many else array_of("q", q, (self.n,))[None]
        data, ids = self.model.createData(), [self.frame_id(name) for name in items_of("frames", names, str)]
        found = np.empty((len(rows), len(ids), 4, 4))
        for row, placements in zip(rows, found):
            pin.framesForwardKinematics(self.model, data, row)
            for i, frame in enumerate(ids):
                placements[i] = data.oMf[frame].homogeneous
        return found if many else found[0]

    def frame_id(self, name: str) -> int:
        """Pinocchio's index of a frame (the link's, if a joint has the same name); an unknown name raises
        :class:`InvalidInput`.
        """
        text_of(f"frame of hand '{self.name}'", name)
        kinds = (pin.FrameType.BODY, pin.FrameType.JOINT, pin.FrameType.FIXED_JOINT)
        if (kind := next((kind for kind in kinds if self.model.existFrame(name, kind)), None)) is not None:
            return int(self.model.getFrameId(name, kind))
        one_of(f"frame of hand '{self.name}'", name, [frame.name for frame in self.model.frames])
        return int(self.model.getFrameId(name))

    def placed(self, pose: ArrayLike) -> HandModel:
        """Return the same hand with its root frame at ``pose`` = oMh (4, 4)."""
        pose = placement_of("hand pose", pose)
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-12:
            U, _, V = np.linalg.svd(pose[:3, :3])  # given with few digits: the nearest rotation
            pose = read_only(pose_of(pose[:3, 3], U @ V))
        move = pin.SE3(pose) * pin.SE3(self.pose).inverse()
        model, geometry = self.model.copy(), self.geometry.copy()
        for j in range(1, model.njoints):
            if model.parents[j] == 0:
                model.jointPlacements[j] = move * model.jointPlacements[j]
        model.inertias[0] = move.act(model.inertias[0])
        for frame in list(model.frames)[1:]:
            if frame.parentJoint == 0:
                frame.placement = move * frame.placement
        for one in geometry.geometryObjects:
            if one.parentJoint == 0:
                one.placement = move * one.placement
        return replace(self, model=model, geometry=geometry, pose=pose)

    def with_limits(self, limits: Mapping[str, tuple[float, float]]) -> HandModel:
        """Return the same hand with other position limits of some joints [rad or m]; each change is noted."""
        model, notes = self.model.copy(), [note for note in self.notes if not note.startswith(ON_LIMITS)]
        lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
        for joint, bounds in mapping_of("limits", limits, "{joint: (lower, upper)}").items():
            one_of(f"joint of hand '{self.name}'", joint, self.joint_names)
            low, high = array_of(f"limits of '{joint}'", bounds, (2,))
            if not low < high:
                raise InvalidInput(f"limits of '{joint}': expected lower < upper, got {low:g} and {high:g}")
            i = self.joint_names.index(joint)
            slides = self.is_prismatic(model.getJointId(joint))
            new, old = (
                f"{ends[0]:g}..{ends[1]:g} m" if slides else f"{np.degrees(ends[0]):g}..{np.degrees(ends[1]):g} deg"
                for ends in ((low, high), (lower[i], upper[i]))
            )
            notes.append(f"limits of {joint} set to {new} (the hand's own: {old})")
            lower[i], upper[i] = low, high
        model.lowerPositionLimit, model.upperPositionLimit = lower, upper
        notes += limit_notes(self.joint_names, self.slides.tolist(), lower, upper)
        continuous = tuple(joint for joint in self.continuous if joint not in limits)
        return replace(self, model=model, notes=tuple(notes), continuous=continuous)

    def with_posture(self, posture: Mapping[str, float]) -> HandModel:
        """Return the same hand with fixed positions of joints of no finger, such as an arm's: ``{joint: position}``.

        Searches, closings, plans and simulations keep these joints there. Joints that are not named stay at 0, or at
        the limit next to it.

        Raises:
            InvalidInput: the joint does not exist, belongs to a finger or follows another, or a position [rad or m] is
                beyond its limits.
        """
        wanted, of_fingers = {}, {name for finger in self.fingers for name in finger.actuated}
        free = [joint for joint in self.joint_names if joint not in of_fingers]
        for joint, value in mapping_of("posture", posture, "{joint: position}").items():
            if joint in of_fingers:
                known = ", ".join(free) or "there are none"
                raise InvalidInput(
                    f"posture: expected joints of no finger ({known}), got '{joint}': give those of fingers to "
                    "close_hand as start="
                )
            i = self.joint_names.index(one_of(f"posture: joint of hand '{self.name}'", joint, free))
            low, high = float(self.lower[i]) - 1e-9, float(self.upper[i]) + 1e-9
            wanted[joint] = number(f"posture of '{joint}'", value, at_least=low, at_most=high)
        return replace(self, posture=wanted)

    @property
    def servo_stiffness(self) -> Array:
        """Stiffness of the joints' own position servos (n,) [N m/rad or N/m]; NaN if none is known, or if a drive moves
        several joints.
        """
        known = np.full(self.n, np.nan)
        for drive in self.drives:
            if drive.stiffness is not None and len(drive.joints) == 1:
                known[self.joint_names.index(drive.joints[0])] = drive.arms[0] ** 2 * drive.stiffness
        return known

    def with_drives(self, drives: Iterable[Drive], springs: Iterable[Spring] | None = None) -> HandModel:
        """Return the same hand with these motors and springs (None: keep its springs); notes say what they leave open.

        Raises:
            InvalidInput: the hand does not have a joint, a joint follows another, or a name is given twice.
        """
        joints, couplings = self.joint_names, self.couplings
        drives = checked_drives(self.name, joints, couplings, drives)
        notes = list(self.notes)
        if drives != self.drives and self.drives:
            notes = [note for note in notes if not note.startswith(ON_DRIVES)]
        hand = replace(self, drives=drives)
        if hand.passive_joints:
            notes.append(f"{ON_DRIVES}no motor moves the joints {', '.join(hand.passive_joints)}")
        beyond = beyond_effort(joints, self.effort_or_infinity, self.slides.tolist(), drives)
        notes += [f"{ON_DRIVES}{text}" for text in beyond]
        if springs is not None:
            springs = checked_springs(self.name, joints, couplings, springs)
            notes = [note for note in notes if not note.startswith(ON_SPRINGS)]
            if springs:
                notes.append(f"{ON_SPRINGS}torques are without those at {', '.join(one.joint for one in springs)}")
            hand = replace(hand, springs=springs)
        return replace(hand, notes=tuple(dict.fromkeys(notes)))

    def describe(self) -> str:
        """Describe fingers, joints, links, limits, masses and drives as readable text."""
        return "\n".join(describe_hand(self))


def _unpickle(*values: Any) -> HandModel:
    known = {field.name: value for field, value in zip(fields(HandModel), values)}
    hand = HandModel(**known | {"own_shapes": unpack_shapes(known["own_shapes"])})
    joints = hand.model.joints
    coupled = [j for j in range(1, hand.model.njoints) if not joints[j].nv]
    if coupled:  # mimic joints lose their size on the way (Pinocchio 4.1), and crash when they are used
        built = pin.buildModelFromXML(hand.description, True).joints
        for j in coupled:
            joints[j] = built[j]
    return hand
