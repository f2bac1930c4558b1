"""A robot of which the arm alone moves, among what stands around it."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import coal
import numpy as np
import pinocchio as pin

from pinograsp.contacts.self_collision import list_pairs
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.hands.geometry import solid_of
from pinograsp.objects import Mesh, Scene
from pinograsp.objects.body import Body
from pinograsp.simulation.geometry import convex_shapes
from pinograsp.spatial import Array

Object = Literal["free", "held"]  # it stays, or moves with the palm
OBJECT = "the object"
_MEETS = 1e-3  # [m] by which the held object may be in what it stands on, and _TOUCHES the open hand in the object:
_TOUCHES = 2e-4  # [m] of an arm's postures to 0.1 mm, and shapes that lie on each other
_LIMIT = 0.01  # [rad or m] that splines and rounding may take of a joint's way
_SELF = 0.0  # [m] between links of the robot
_SPARE = 5e-4  # [m] more than the clearance: between looks, and for what smoothing takes of a way


class Nearest(NamedTuple):
    """The pair that is nearest to what it must keep, or farthest beyond: by how much [m], and the names of both."""

    spare: float
    one: str
    other: str


class Arm:
    """A robot whose fingers stay, as those of a hand that is open, or that holds an object.

    Args:
        robot: arm and hand in one model.
        q: of the robot (n,), where all but the arm's joints stay.
        scene: what stands around.
        body: the object, in the world; held: at q.
        kind: whether the object stays or moves with the palm.
        supports: names of obstacles that the object stands on, here or where it is put.

    Attributes:
        model: of the arm's joints alone, in their order in the robot's.
        dofs: these, among the robot's (a,).
    """

    def __init__(self, robot: HandModel, q: Array, scene: Scene, body: Body, kind: Object, supports: set[str]):
        self.robot, self.scene, self.body, self.kind, self.supports = robot, scene, body, kind, supports
        self.dofs = robot.arm
        if not len(self.dofs):
            raise InvalidInput(f"robot '{robot.name}': expected an arm that carries the palm, got a hand alone")
        self.resting = np.array(q)
        joints = robot.model.joints
        moving = {
            j for j in range(1, robot.model.njoints) if joints[j].nv and joints[j].idx_v in set(self.dofs.tolist())
        }
        locked = [j for j in range(1, robot.model.njoints) if j not in moving]
        self.model, (self.geometry,) = pin.buildReducedModel(robot.model, [robot.geometry], locked, self.resting)
        self.data = self.model.createData()
        self.palm_frame = self.model.getFrameId(robot.palm, pin.FrameType.BODY)
        self.palm_joint = int(self.model.frames[self.palm_frame].parentJoint)
        # Where the arm is may be nearer to a limit than it is to go.
        x = self.resting[self.dofs]
        lower, upper = self.model.lowerPositionLimit, self.model.upperPositionLimit
        room = np.minimum(_LIMIT, (upper - lower) / 4.0)
        self.lower, self.upper = np.minimum(lower + room, x), np.maximum(upper - room, x)
        self.model.lowerPositionLimit, self.model.upperPositionLimit = self.lower, self.upper
        own = [self.robot.model.frames[one.parentFrame].name for one in robot.geometry.geometryObjects]
        self.names = [*own, *self._add_obstacles(), *self._add_object()]
        self.margins = {near: self._margins(near) for near in (False, True)}
        for a, b in self._pairs:
            self.geometry.addCollisionPair(pin.CollisionPair(a, b))
        self.near, self.far = self._request(True), self._request(False)
        self._quick: pin.BroadPhaseManager_DynamicAABBTreeCollisionManager | None = None

    # -- the geometry --------------------------------------------------------------------------------------------------

    def _add(self, name: str, joint: int, placement: pin.SE3, shapes: Sequence[coal.ShapeBase]) -> list[str]:
        for i, shape in enumerate(shapes):
            self.geometry.addGeometryObject(pin.GeometryObject(f"{name}/{i}", joint, placement, shape))
        return [name] * len(shapes)

    def _add_obstacles(self) -> list[str]:
        names = list[str]()
        for name, body in self.scene.obstacles.items():
            names += self._add(name, 0, pin.SE3(body.shape_pose), convex_shapes(body, []))
        return names

    def _add_object(self) -> list[str]:
        at, shapes = pin.SE3(self.body.shape_pose), [solid_of(self.body.collision_geometry)]
        if self.kind == "free":
            return self._add(OBJECT, 0, at, shapes)
        pin.forwardKinematics(self.model, self.data, self.resting[self.dofs])
        return self._add(OBJECT, self.palm_joint, self.data.oMi[self.palm_joint].inverse() * at, shapes)

    def _margins(self, near: bool) -> Array:
        """What each pair keeps [m]; lists the pairs."""
        own, joints = self.robot.geometry.ngeoms, [int(one.parentJoint) for one in self.geometry.geometryObjects]
        hand = [joint == self.palm_joint for joint in joints]
        hollow = isinstance(self.body, Mesh) and not self.body.convex
        pairs = [(int(a), int(b)) for a, b in list_pairs(self.robot).tolist() if joints[a] != joints[b]]
        margins = [_SELF] * len(pairs)
        for a in range(len(self.names)):
            for b in range(max(own, a + 1), len(self.names)):
                held = self.names[b] == OBJECT and self.kind == "held"
                if joints[a] == joints[b] or (a >= own and not held):
                    continue  # neither moves
                touches = near and hand[a] and not held and (self.names[b] == OBJECT or self.names[b] in self.supports)
                stands = near and held and self.names[a] in self.supports
                pairs.append((a, b))
                # A hand may reach into what is hollow, as into a mug, whose hull stands for it here.
                meets = -_MEETS if stands else -np.inf if hollow and self.names[b] == OBJECT else -_TOUCHES
                margins.append(meets if stands or touches else self.scene.clearance + _SPARE)
        self._pairs = pairs
        return np.array(margins)

    def _request(self, near: bool) -> pin.GeometryData:
        data = self.geometry.createData()
        for request, margin in zip(data.collisionRequests, self.margins[near].tolist()):
            request.security_margin = margin
        return data

    # -- where it is ---------------------------------------------------------------------------------------------------

    def palm(self, x: Array) -> Array:
        """The palm (4, 4) in the world at the arm's positions x (a,)."""
        pin.framesForwardKinematics(self.model, self.data, x)
        pose: Array = self.data.oMf[self.palm_frame].homogeneous.copy()
        return pose

    def hold(self, x: Array, mass: float, gravity_o: Array) -> Array:
        """Torques (a,) that hold the arm at x (a,), with a mass at its palm [N m or N]."""
        self.model.gravity.linear = gravity_o
        torques: Array = pin.computeGeneralizedGravity(self.model, self.data, x).copy()
        J = pin.computeFrameJacobian(self.model, self.data, x, self.palm_frame, pin.LOCAL_WORLD_ALIGNED)
        torques -= J[:3].T @ (mass * gravity_o)
        return torques

    def is_free(self, x: Array, *, near: bool = False) -> bool:
        """Whether all keep their distances at x (a,); ``near``: where a hand takes or puts down."""
        return not pin.computeCollisions(self.model, self.data, self.geometry, self.near if near else self.far, x, True)

    def seems_free(self, x: Array) -> bool:
        """As :meth:`is_free`, 3 to 15 times as quick; one of some thousand postures may lack a little of a distance."""
        if self._quick is None:
            self._quick = pin.BroadPhaseManager_DynamicAABBTreeCollisionManager(self.model, self.geometry, self.far)
        return not pin.computeCollisions(self.model, self.data, self._quick, x, True)

    def find_apart(self, x: Array) -> Nearest:
        """The least distance at x (a,) of what a hand is not to touch either where it takes or puts down."""
        pin.computeDistances(self.model, self.data, self.geometry, self.near, x)
        apart = np.array([one.min_distance for one in self.near.distanceResults])
        i = int(np.where(self.margins[True] >= 0.0, apart, np.inf).argmin())
        return Nearest(float(apart[i]), *(self.names[part] for part in self._pairs[i]))

    def find_nearest(self, x: Array, *, near: bool = False) -> Nearest:
        """What has least to spare at x (a,)."""
        seen = self.near if near else self.far
        pin.computeDistances(self.model, self.data, self.geometry, seen, x)
        spare = np.array([one.min_distance for one in seen.distanceResults]) - self.margins[near]
        i = int(spare.argmin())
        return Nearest(float(spare[i]), *(self.names[part] for part in self._pairs[i]))
