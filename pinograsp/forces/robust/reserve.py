"""What a grasp is to hold besides the weight of its object: the reserve of a plan."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, instance_of, items_of, number, share_of
from pinograsp.contacts import Friction
from pinograsp.errors import InvalidInput
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.load_set import LoadSet
from pinograsp.forces.robust.task import CIRCUMSCRIBED, Task, icosahedron
from pinograsp.hands import HandModel
from pinograsp.hands.drives import FARTHEST_OFF
from pinograsp.objects.body import Body

LEAST_FORCE = 0.05  # [N] below, the friction of drives and joints decides, not the plan


@dataclass(frozen=True, slots=True, kw_only=True)
class Reserve:
    """What a squeeze withstands besides the weight for which it is planned. All shares may be 0.

    Attributes:
        disturbance: force in any direction, as share of the weight [-]; and moment about any axis, this force times
            ``moment_arm``. Either of the two, or a mixture whose shares add up to one.
        moment_arm: arm of the moments [m]; None: the object's largest radius of gyration about its centre of mass, the
            arm at which its mass resists turning. 0: only forces.
        mass: the object may be lighter or heavier by this share [-].
        friction: share of every friction coefficient (and of torsion) on which the plan does not rely [-].
        normal_force: least normal force of each contact, as share of the weight [-]; where it is not 0, at least
            :data:`LEAST_FORCE`.
        torque: share of each torque limit that is kept free [-].
        softer: the contacts may be softer than assumed by this factor, and the squeeze withstands all of the above
            then, too [-]; 1: as assumed. How the squeeze changes depends on the stiffness of the hand's servos.
            ``"sheet"``: the factor of the drives' ``contact_stiffness`` (:meth:`of_hand`).
        stiffer: or stiffer by this factor [-], or ``"sheet"``.
        drive: share by which the drives' efforts may differ from the commands, all of them together or each alone; the
            squeeze withstands all of the above then, too [-]. How the squeeze changes depends on the servos as well.
            ``"sheet"``: each drive's own share, from the interval of its ``effort_step``, 0.3 if none is known
            (:func:`~pinograsp.hands.efforts.effort_shares`).
        tasks: what is done with the object: additional loads that the squeeze withstands, each without the disturbance.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, up = pg.load_hand("panda"), pg.spatial.pose_of([0, 0, 0.1034], np.eye(3))
        >>> ball = pg.Sphere(radius=0.02, mass=0.1).placed(up)
        >>> for reserve in (pg.Reserve(), pg.Reserve(disturbance=1.0)):
        ...     plan = pg.plan_grasp_on(hand, ball, pg.GraspConditions(mu=0.6, reserve=reserve))
        ...     print(f"{plan.forces.normal_forces.sum():.1f} N")
        3.7 N
        5.0 N

    See Also:
        :class:`~pinograsp.forces.Task`, :class:`~pinograsp.forces.GraspConditions`.
    """

    disturbance: float = 0.5
    moment_arm: float | None = None
    mass: float = 0.2
    friction: float = 0.2
    normal_force: float = 0.05
    torque: float = 0.1
    softer: float | Literal["sheet"] = 1.0
    stiffer: float | Literal["sheet"] = 1.0
    drive: float | Literal["sheet"] = 0.0
    tasks: tuple[Task, ...] = ()

    __repr__ = brief()

    def __post_init__(self) -> None:
        def put(name: str, value: float | None) -> None:
            object.__setattr__(self, name, value)

        put("disturbance", number("reserve: disturbance", self.disturbance, at_least=0))
        if self.moment_arm is not None:
            put("moment_arm", number("reserve: moment arm", self.moment_arm, at_least=0, unit="m"))
        put("mass", share_of("reserve: mass", self.mass))
        put("friction", share_of("reserve: friction", self.friction))
        put("normal_force", number("reserve: normal force", self.normal_force, at_least=0))
        put("torque", share_of("reserve: torque", self.torque))
        for name in ("softer", "stiffer"):
            if (value := getattr(self, name)) != "sheet":
                put(name, number(f"reserve: {name} (a factor, or 'sheet')", value, at_least=1, at_most=FARTHEST_OFF))
        if self.drive != "sheet":
            put("drive", share_of("reserve: drive (a share, or 'sheet')", self.drive))
        object.__setattr__(self, "tasks", items_of("reserve: tasks", self.tasks, Task))

    @classmethod
    def none(cls) -> Reserve:
        """Return no reserve: the weight alone, with all of the friction and of the torques."""
        return cls(disturbance=0.0, moment_arm=0.0, mass=0.0, friction=0.0, normal_force=0.0, torque=0.0)

    @property
    def stiffness_range(self) -> tuple[float, float]:
        """Least and largest stiffness of the contacts over the assumed one [-].

        Raises:
            InvalidInput: ``"sheet"``, for which only :meth:`of_hand` has the numbers.
        """
        if self.softer == "sheet" or self.stiffer == "sheet":
            raise InvalidInput(
                "reserve: expected factors for softer and stiffer, got 'sheet': take those of reserve.of_hand(hand)"
            )
        return 1.0 / self.softer, self.stiffer

    @property
    def stiffness_factors(self) -> tuple[float, ...]:
        """Both ends of :attr:`stiffness_range`, without 1 [-]."""
        return tuple(factor for factor in self.stiffness_range if factor != 1)

    def of_hand(self, hand: HandModel) -> Reserve:
        """Return the reserve with ``softer`` and ``stiffer`` from a hand's data sheet: the widest range of its drives.

        Raises:
            InvalidInput: ``contact_stiffness`` is known for no drive.
        """
        if "sheet" not in (self.softer, self.stiffer):
            return self
        known = [drive.contact_stiffness for drive in hand.drives if drive.contact_stiffness is not None]
        if not known:
            raise InvalidInput(
                f"reserve: expected a drive of {hand.name} whose contact_stiffness is known, for softer or stiffer "
                "'sheet', got none: identify it from closings, write it into the data sheet, or give factors"
            )
        softer, stiffer = 1.0 / min(low for low, _ in known), max(high for _, high in known)
        return replace(
            self,
            softer=softer if self.softer == "sheet" else self.softer,
            stiffer=stiffer if self.stiffer == "sheet" else self.stiffer,
        )

    @property
    def has_scenarios(self) -> bool:
        """Whether the squeeze has to withstand all of it with other contacts, or other drives, as well."""
        return bool(self.stiffness_factors) or self.drive != 0

    def arm(self, body: Body) -> float:
        """The arm of the moments for a body [m]."""
        instance_of("body", body, Body)
        if self.moment_arm is not None:
            return self.moment_arm
        return float(np.sqrt(np.linalg.eigvalsh(body.inertia_b)[-1] / body.mass))

    def load_set(self, body: Body, gravity_o: ArrayLike = (0.0, 0.0, -9.81)) -> LoadSet:
        """Return the loads of a body: weights of the least and the largest mass, each with every disturbance.

        The disturbances are the convex hull of a ball of forces (radius ``disturbance`` times the weight) and a ball of
        moments (that times the arm). Both balls lie inside icosahedra with vertices :data:`CIRCUMSCRIBED` = 1.26 times
        as far out, one vertex along the weight and the others turned with the body, so that nothing depends on the
        world's axes; if the file has other axes, forces change by a percent. Loads that lie between others are left
        out.

        Args:
            body: the held object.
            gravity_o: gravity (3,) [m/s^2].
        """
        gravity = array_of("gravity", gravity_o, (3,))
        weight_o = instance_of("body", body, Body).mass * gravity
        weight = float(np.linalg.norm(weight_o))
        multiples = (1.0 - self.mass, 1.0 + self.mass) if self.mass else (1.0,)
        masses = np.zeros((len(multiples), 6))
        masses[:, :3] = np.outer(multiples, weight_o)
        size = CIRCUMSCRIBED * self.disturbance * weight
        done = [task.find_loads(body, times * body.mass, gravity) for task in self.tasks for times in multiples]
        if size == 0:
            return LoadSet(loads=np.unique(np.concatenate([masses, *done]), axis=0))
        directions = icosahedron(weight_o / weight, body.shape_pose[:3, :3])
        forces = np.zeros((12, 6))
        forces[:, :3] = size * directions
        # Of the loads along the weight the least and the largest are enough: the others lie between them.
        along, against, around = forces[:1], forces[1:2], forces[2:]
        loads = [masses[:1] + against, masses[-1:] + along, *(mass + around for mass in masses)]
        if arm := self.arm(body):
            moments = np.zeros((12, 6))
            moments[:, 3:] = size * arm * directions
            loads += [mass + moments for mass in masses]
        return LoadSet(loads=np.concatenate([*loads, *done]))

    def kept_friction(self, friction: Friction) -> Friction:
        """The friction on which the plan relies."""
        instance_of("friction", friction, Friction)
        return replace(friction, safety=friction.safety / (1.0 - self.friction)) if self.friction else friction

    def least_force(self, weight: float) -> float:
        """The least normal force of each contact [N] under a weight [N]."""
        weight = number("weight", weight, at_least=0, unit="N")
        return max(LEAST_FORCE, self.normal_force * weight) if self.normal_force else 0.0

    def problem(self, problem: ForceProblem) -> ForceProblem:
        """Return a problem with the reserve in friction, torque limits, and a least normal force per contact.

        The reserve enters by the friction model's safety factor and by ``TorqueLimits.headroom``, so that the problem
        still has its own mu and limits, and margins refer to these.
        """
        body = held_body(instance_of("problem", problem, ForceProblem))
        friction, torques, floor = problem.friction, problem.torques, problem.min_normal_force
        friction = self.kept_friction(friction)
        if self.torque and torques is not None:
            torques = replace(torques, headroom=1.0 - (1.0 - torques.headroom) * (1.0 - self.torque))
        if self.normal_force:
            least = self.least_force(body.mass * float(np.linalg.norm(problem.gravity_o)))
            floor = np.maximum(least, np.zeros(problem.k) if floor is None else floor)
        return replace(problem, friction=friction, torques=torques, min_normal_force=floor)

    def summary(self) -> dict[str, object]:
        """As plain JSON values."""
        values = asdict(self) | {"tasks": [task.describe() for task in self.tasks]}
        return {"moment_arm_m" if name == "moment_arm" else name: value for name, value in values.items()}


def held_body(problem: ForceProblem) -> Body:
    """The object that a problem holds, or :class:`InvalidInput` where there is none."""
    if problem.object is None:
        raise InvalidInput("reserve: expected the problem of holding an object, got one without: ForceProblem.holding")
    return problem.object
