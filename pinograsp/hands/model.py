"""A hand as the other rooms see it: a Pinocchio model placed in the world, and its fingers."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from pinograsp.checks import array_of, one_of, read_only
from pinograsp.errors import InvalidInput


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Finger:
    """A serial chain from the palm to a fingertip.

    Attributes:
        name: finger name.
        joints: moving joints, base to tip, coupled ones included. links: the link each joint moves.
        tip: frame at the fingertip (the outermost link fixed beyond the last joint).
        joint_ids: Pinocchio joint indices, one per joint.
        dofs: positions (n,) in q and v of the actuated joints that move the finger; fingers of coupled hands share them.
        actuated: the names of those joints.
    """

    name: str
    joints: tuple[str, ...]
    links: tuple[str, ...]
    tip: str
    joint_ids: tuple[int, ...]
    dofs: np.ndarray
    actuated: tuple[str, ...]

    @property
    def n(self) -> int:
        """Number of actuated joints."""
        return len(self.dofs)

    @property
    def coupled(self) -> bool:
        """Whether joints of the finger move together."""
        return self.n < len(self.joints)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandModel:
    """A hand placed in the world.

    Attributes:
        name: hand name. source: the file it came from.
        model: Pinocchio model; its universe frame is the world o, the palm is fixed in it. q and v are those of the
            actuated joints: joints that follow others are Pinocchio's mimic joints.
        geometry: collision geometry of palm and links.
        palm: link the fingers start from. fingers: in the order of the description.
        pose: oMh (4, 4), the hand's root frame in the world.
        notes: what the caller should know (widened limits, coupled joints, missing meshes...).
    """

    name: str
    source: str
    model: pin.Model
    geometry: pin.GeometryModel
    palm: str
    fingers: tuple[Finger, ...]
    pose: np.ndarray
    notes: tuple[str, ...] = ()

    @property
    def n(self) -> int:
        """Number of actuated joints of the whole model."""
        return self.model.nv

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the actuated joints in the order of q."""
        model = self.model
        return tuple(model.names[j] for j in range(1, model.njoints) if model.joints[j].nv)

    @property
    def lower(self) -> np.ndarray:
        """Lower joint limits (n,) [rad or m]."""
        return read_only(self.model.lowerPositionLimit)

    @property
    def upper(self) -> np.ndarray:
        """Upper joint limits (n,) [rad or m]."""
        return read_only(self.model.upperPositionLimit)

    @property
    def effort(self) -> np.ndarray:
        """Effort limits (n,) [N m or N]; 0 where the description has none."""
        return read_only(self.model.effortLimit)

    def finger(self, name: str) -> Finger:
        """The finger called ``name``; :class:`InvalidInput` lists the names there are."""
        names = [finger.name for finger in self.fingers]
        one_of(f"finger of hand '{self.name}'", name, names)
        return self.fingers[names.index(name)]

    @property
    def velocity(self) -> np.ndarray:
        """Velocity limits (n,) [rad/s or m/s]; 0 where the description has none."""
        return read_only(self.model.velocityLimit)

    @property
    def mass(self) -> float:
        """Mass of palm and fingers [kg]; of the palm only what the description gives."""
        return float(sum(inertia.mass for inertia in self.model.inertias))

    def finger_mass(self, name: str) -> float:
        """Mass of a finger's moving links [kg]."""
        return float(sum(self.model.inertias[j].mass for j in self.finger(name).joint_ids))

    def configuration(self, angles: dict[str, np.ndarray]) -> np.ndarray:
        """q (n,) [rad] with the given fingers at the given joint angles and every other joint at 0."""
        q = np.zeros(self.n)
        for name, values in angles.items():
            finger = self.finger(name)
            q[finger.dofs] = array_of(f"joint angles of '{name}'", values, (finger.n,))
        return q

    def is_prismatic(self, joint_id: int) -> bool:
        """Whether a joint slides (its q in m, its effort in N) rather than turns."""
        return self.model.joints[joint_id].shortname().startswith("JointModelP")

    def frame_placements(self, q, names) -> np.ndarray:
        """Placements oMf (len(names), 4, 4) of the named frames at ``q`` (n,) [rad]."""
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, array_of("q", q, (self.n,)))
        return np.array([data.oMf[self.frame_id(name)].homogeneous for name in names])

    def frame_id(self, name: str) -> int:
        """Pinocchio's index of a frame; unlike ``getFrameId`` it refuses names that do not exist."""
        if not self.model.existFrame(name):
            one_of(f"frame of hand '{self.name}'", name, [frame.name for frame in self.model.frames])
        return self.model.getFrameId(name)

    def placed(self, pose) -> HandModel:
        """The same hand with its root frame at ``pose`` = oMh (4, 4)."""
        pose = array_of("hand pose", pose, (4, 4))
        if np.abs(pose[:3, :3] @ pose[:3, :3].T - np.eye(3)).max() > 1e-6 or np.linalg.det(pose[:3, :3]) < 0:
            raise InvalidInput("hand pose: expected a homogeneous placement with an orthonormal right-handed rotation")
        move = pin.SE3(pose) * pin.SE3(self.pose).inverse()
        model, geometry = self.model.copy(), self.geometry.copy()
        for j in range(1, model.njoints):
            if model.parents[j] == 0:
                model.jointPlacements[j] = move * model.jointPlacements[j]
        for frame in list(model.frames)[1:]:
            if frame.parentJoint == 0:
                frame.placement = move * frame.placement
        for one in geometry.geometryObjects:
            if one.parentJoint == 0:
                one.placement = move * one.placement
        return replace(self, model=model, geometry=geometry, pose=pose)

    def with_limits(self, limits: dict[str, tuple[float, float]]) -> HandModel:
        """The same hand with the position limits of some joints replaced [rad]; each change is noted."""
        model, notes = self.model.copy(), list(self.notes)
        lower, upper = model.lowerPositionLimit.copy(), model.upperPositionLimit.copy()
        for joint, bounds in limits.items():
            one_of(f"joint of hand '{self.name}'", joint, self.joint_names)
            low, high = array_of(f"limits of '{joint}'", bounds, (2,))
            if not low < high:
                raise InvalidInput(f"limits of '{joint}': expected lower < upper, got {low:g} and {high:g}")
            i = self.joint_names.index(joint)
            notes.append(
                f"limits of {joint} set to {np.degrees(low):g}..{np.degrees(high):g} deg "
                f"(the hand's own: {np.degrees(lower[i]):g}..{np.degrees(upper[i]):g} deg)"
            )
            lower[i], upper[i] = low, high
        model.lowerPositionLimit, model.upperPositionLimit = lower, upper
        return replace(self, model=model, notes=tuple(notes))

    def describe(self) -> str:
        """What was found: fingers, joints, links, limits, masses, as readable text."""
        model = self.model
        lines = [
            f"hand {self.name}: {self.n} joints, {len(self.fingers)} fingers on '{self.palm}', {self.mass:.3f} kg "
            f"({self.source})"
        ]
        for finger in self.fingers:
            lines.append(f"  {finger.name}: {1e3 * self.finger_mass(finger.name):.1f} g, tip '{finger.tip}'")
            for joint, link, j in zip(finger.joints, finger.links, finger.joint_ids):
                i = model.joints[j].idx_v
                if not model.joints[j].nv:
                    lines.append(f"    {joint} -> {link}: follows {self.joint_names[i]}")
                    continue
                length, force = ("m", "N") if self.is_prismatic(j) else ("rad", "N m")
                effort = f"{model.effortLimit[i]:g} {force}" if model.effortLimit[i] else "not given"
                low, high = model.lowerPositionLimit[i], model.upperPositionLimit[i]
                lines.append(f"    {joint} -> {link}: {low:+.3f} .. {high:+.3f} {length}, effort {effort}")
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])
