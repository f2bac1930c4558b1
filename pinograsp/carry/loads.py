"""What carrying asks for along a path: the object's wrench and the joints' torques, linear in acceleration and squared
speed of the path parameter.

With q(s) and b = s_dot^2, a = s_ddot: dq = q' s_dot and ddq = q' a + q'' b, so that every inertial wrench and torque is
``along_a`` a + ``along_b`` b + ``still`` (Verscheure et al. 2009). The wrench is that of the contacts on the object,
about its centre of mass, in axes that turn with the palm: those that the grasp was planned in.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.carry.path import ArmPath
from pinograsp.checks import array_of, brief, number
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.plan import PlanRecord
from pinograsp.spatial import Array, IntArray, multiply_rows


class Linear(NamedTuple):
    """``along_a`` a + ``along_b`` b + ``still``, each (m, r)."""

    along_a: Array
    along_b: Array
    still: Array

    def follow(self, a: Array, b: Array) -> Linear:
        """The same of a known timing (m,), as a function of its speed: ``along_b`` times that squared."""
        moving = self.along_a * a[:, None] + self.along_b * b[:, None]
        return Linear(np.zeros_like(moving), moving, self.still)

    def at_square(self, y: float) -> Array:
        """Of a known timing, the values (m, r) at the square of a factor on its speed."""
        return np.asarray(self.along_b * y + self.still)

    def pairs(self, step: float) -> Array:
        """Its slopes (m, r, 2) over the squared speeds at both ends of intervals of this length, at their middles."""
        rise, mean = self.along_a / step, self.along_b / 2.0
        return np.stack([mean - rise / 2.0, mean + rise / 2.0], axis=2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarryLoads:
    """Along m values of the path parameter.

    Attributes:
        wrench: on the object (6,), linear first [N, N m].
        torque: of all joints (n,), without contact forces on the fingers; the arm bears the object [N m or N].
        speed: derivative of q by s (n,), and nothing besides.
        object_speed: how far the object's centre of mass goes by s (m,), likewise.
        acceleration: ddq (n,): its ``still`` is zero.
        q: positions (m, n).
    """

    wrench: Linear
    torque: Linear
    speed: Array
    object_speed: Array
    acceleration: Linear
    q: Array

    __repr__ = brief()

    def follow(self, a: Array, b: Array) -> CarryLoads:
        """Those of a known timing: accelerations and squared speeds (m,) of the path parameter."""
        return CarryLoads(
            wrench=self.wrench.follow(a, b),
            torque=self.torque.follow(a, b),
            speed=self.speed * np.sqrt(b)[:, None],
            object_speed=self.object_speed * np.sqrt(b),
            acceleration=self.acceleration.follow(a, b),
            q=self.q,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CarryScenario:
    """Possible differences from the plan.

    Attributes:
        mass: of the object, over its planned one [-].
        mu: friction coefficients, over the planned ones [-].
        com: displacement of the centre of mass from its planned place (3,) [m], in the object's own axes.

    Raises:
        InvalidInput: no positive mass, negative friction.
    """

    mass: float = 1.0
    mu: float = 1.0
    com: ArrayLike = (0.0, 0.0, 0.0)

    __repr__ = brief()

    def __post_init__(self) -> None:
        object.__setattr__(self, "mass", number("mass of a scenario, over the planned one", self.mass, above=0))
        object.__setattr__(self, "mu", number("mu of a scenario, over the planned one", self.mu, at_least=0))
        object.__setattr__(self, "com", array_of("centre of mass of a scenario [m]", self.com, (3,)))


AS_PLANNED = CarryScenario()
_SUGGESTED, _LONGEST = 7, 100  # joints that a refusal suggests others for, and characters of a name


class LoadedRobot:
    """A robot with an object in its hand.

    Args:
        robot: arm and hand.
        hand: the hand that the grasp was planned with, where it was then; may be the robot.
        body: the object, where it was then.
        posture: of that hand (n_h,) [rad or m].
        scenario: how the object differs from the planned one.
    """

    def __init__(
        self, robot: HandModel, hand: HandModel, body: Body, posture: Array, scenario: CarryScenario = AS_PLANNED
    ):
        self.robot, self.hand, self.body = robot, hand, body
        palm = hand.palm
        if not robot.model.existFrame(palm):
            raise InvalidInput(f"robot '{robot.name}': expected the grasp's hand in it, with its link '{palm}'")
        names = list(robot.joint_names)
        if missing := [joint for joint in hand.joint_names if joint not in names]:
            raise InvalidInput(
                f"robot '{robot.name}': expected the grasp's hand in it; it has no joint {', '.join(missing[:5])}"
            )
        self.of_hand: IntArray = np.array([names.index(joint) for joint in hand.joint_names])
        self.posture = np.array(robot.resting)
        self.posture[self.of_hand] = posture
        # The fingers' joints, among those of the hand and of the robot.
        self.finger_dofs: IntArray = np.unique(np.concatenate([finger.dofs for finger in hand.fingers]))
        self.fingers: IntArray = self.of_hand[self.finger_dofs]
        self.arm: IntArray = np.setdiff1d(np.arange(robot.n), self.fingers)
        # Where the object's axes of then are in the joint that carries the palm.
        frame = robot.model.frames[robot.model.getFrameId(palm)]
        self.joint: int = frame.parentJoint
        oMpalm = pin.SE3(hand.frame_placements(posture, [palm])[0])
        self.jMo = frame.placement * oMpalm.inverse()
        self.model = robot.model.copy()
        turn = body.pose[:3, :3]
        centre = body.com_o + turn @ np.asarray(scenario.com)
        self.inertia = pin.Inertia(scenario.mass * body.mass, centre, scenario.mass * turn @ body.inertia_b @ turn.T)
        if self.joint:
            self.model.inertias[self.joint] = self.model.inertias[self.joint] + self.jMo.act(self.inertia)

    @classmethod
    def carry(cls, robot: HandModel, grasp: PlanRecord, scenario: CarryScenario = AS_PLANNED) -> LoadedRobot:
        """What a grasp holds, in a robot's hand.

        Raises:
            InvalidInput: the grasp's object is not known, or the robot has not its hand.
        """
        if grasp.body is None:
            raise InvalidInput("grasp: expected one of a known object, whose mass and inertia are to be carried")
        return cls(robot, grasp.require_hand(), grasp.body, np.array(grasp.motion.q[-1]), scenario)

    def axes(self, q: Array) -> Array:
        """Where the axes in which the grasp was planned are at joint positions (m, n), as placements (m, 4, 4)."""
        model, data = self.robot.model, self.robot.model.createData()
        found = np.empty((len(q), 4, 4))
        for i, one in enumerate(q):
            pin.forwardKinematics(model, data, one)
            found[i] = (data.oMi[self.joint] * self.jMo).homogeneous
        return found

    def along(self, path: ArmPath, s: Array, gravity_o: Array) -> CarryLoads:
        """Loads at path parameters (m,); gravity (3,) [m/s^2] in the robot's world."""
        q, slope, bend = self._move(path, s)
        model, data, rest = self.model, self.model.createData(), np.zeros(self.robot.n)
        model.gravity.linear = np.array(gravity_o)
        weightless = self.model.copy()
        weightless.gravity.linear = np.zeros(3)
        torque, motion = np.empty((3, *q.shape)), np.zeros((2, 3, len(s), 6))
        for i in range(len(s)):
            for part, (own, dq, ddq) in enumerate(
                ((weightless, rest, slope[i]), (weightless, slope[i], bend[i]), (model, rest, rest))
            ):
                torque[part, i] = pin.rnea(own, data, q[i], dq, ddq)
                motion[:, part, i] = data.a_gf[self.joint].vector, data.v[self.joint].vector
        wrench = self._measure_wrench(*motion)
        return CarryLoads(
            wrench=Linear(*wrench),
            torque=Linear(torque[0], torque[1], torque[2]),
            speed=slope,
            object_speed=self._measure_speed(motion[1, 1]),
            acceleration=Linear(slope, bend, np.zeros_like(slope)),
            q=q,
        )

    def slopes(self, path: ArmPath, s: Array) -> tuple[Array, Array]:
        """By the path parameters s (m,): derivatives of all joints' positions (m, n), and how far the centre of
        mass of the object goes (m,).
        """
        q, slope, _ = self._move(path, s)
        data, twists = self.model.createData(), np.zeros((len(s), 6))
        for i in range(len(s)):
            pin.forwardKinematics(self.model, data, q[i], slope[i])
            twists[i] = data.v[self.joint].vector
        return slope, self._measure_speed(twists)

    def _measure_speed(self, twists: Array) -> Array:
        """Of the object's centre of mass (m,), by how the joint that carries it moves (m, 6)."""
        centre = self.jMo.act(self.inertia).lever
        return np.asarray(np.linalg.norm(twists[:, :3] + np.cross(twists[:, 3:], centre), axis=1))

    def _move(self, path: ArmPath, s: Array) -> tuple[Array, Array, Array]:
        """Positions of all joints and their derivatives by s, each (m, n)."""
        moving = self.find_joints(path)
        q = np.tile(self.posture, (len(s), 1))
        slope, bend = np.zeros_like(q), np.zeros_like(q)
        q[:, moving], slope[:, moving], bend[:, moving], _ = path.at(s)
        self._check_limits(path, moving, q)
        return q, slope, bend

    def _measure_wrench(self, acceleration: Array, v: Array) -> Array:
        """On the object (..., 6), about its planned centre of mass, by how the joint that carries it moves (..., 6)."""
        inertia = self.jMo.act(self.inertia).matrix()
        momentum, force = multiply_rows(v, inertia), multiply_rows(acceleration, inertia)
        force[..., :3] += np.cross(v[..., 3:], momentum[..., :3])
        force[..., 3:] += np.cross(v[..., 3:], momentum[..., 3:]) + np.cross(v[..., :3], momentum[..., :3])
        found = multiply_rows(force, self.jMo.inverse().toDualActionMatrix().T)
        found[..., 3:] -= np.cross(self.body.com_o, found[..., :3])
        return found

    def keep_arm_joints(self, path: ArmPath) -> ArmPath:
        """A path without the columns of the fingers, which hold, and of coupled joints, which follow."""
        fingers = [joint for j, joint in enumerate(self.robot.joint_names) if j not in self.arm]
        kept = [joint for joint in path.joints if joint not in (*fingers, *self.robot.couplings)]
        return path.only(kept) if 0 < len(kept) < len(path.joints) else path

    def find_joints(self, path: ArmPath) -> IntArray:
        """Where the path's joints are among the robot's."""
        names = list(self.robot.joint_names)
        arm = [names[j] for j in self.arm.tolist()]
        if wrong := [joint for joint in path.joints if joint not in arm]:
            remedy = ": the robot must be arm and hand (robot=, --robot with --root, its first link)"
            raise InvalidInput(
                f"path: expected joints of the arm, {', '.join(arm) or 'of which there are none'}; got "
                f"{', '.join(wrong[:_SUGGESTED])}{_suggest_joints(wrong, arm) if arm else remedy}"
            )
        return np.array([names.index(joint) for joint in path.joints])

    def _check_limits(self, path: ArmPath, moving: IntArray, q: Array) -> None:
        low, high = self.robot.travel
        over = np.maximum(low - q, q - high)[:, moving]
        at, joint = np.unravel_index(int(over.argmax()), over.shape)
        if over[at, joint] > 1e-6:
            j = moving[joint]
            unit = "m" if self.robot.slides[j] else "rad"
            raise InvalidInput(
                f"path: joint '{path.joints[joint]}' goes {over[at, joint]:.3g} {unit} beyond its limits, {low[j]:.4g} "
                f"to {high[j]:.4g} {unit}, to {q[at, j]:.4g}: angles are in radians; splines may swing out between "
                "waypoints; load_hand(limits=) gives the arm other limits"
            )


def _suggest_joints(wrong: list[str], known: list[str]) -> str:
    """The known joint that each wrong one may mean: one with a prefix more or less, or the nearest spelling."""
    found = []
    for name in wrong[:_SUGGESTED]:
        same = [one for one in known if name.endswith(one) or one.endswith(name)]
        if near := same or difflib.get_close_matches(name[:_LONGEST], known, n=1):
            found.append(f"'{max(near, key=len)}' for '{name[:_LONGEST]}'")
    return f"; did you mean {', '.join(found)}?" if found else ""
