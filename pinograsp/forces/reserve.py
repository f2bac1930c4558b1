"""What a grasp is to hold besides the weight of its object: the reserve of a plan."""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, instance_of, number, share_of
from pinograsp.contacts import Compliance, Friction
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.load_set import LoadSet
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.program import Objective
from pinograsp.forces.robust import optimize_robust, robust_at, robust_weights
from pinograsp.forces.robust_forces import RobustForces, StiffnessScenario
from pinograsp.forces.solution import ConvexSolution
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

# An icosahedron contains the ball that touches its faces; its vertices are that much further out than the ball's
# radius: sqrt(15 - 6 sqrt(5)) = 1.2584. An octahedron would go 1.73 times as far, a cube too.
CIRCUMSCRIBED = float(np.sqrt(15 - 6 * np.sqrt(5)))
LEAST_FORCE = 0.05  # [N] below, the friction of drives and joints decides, not the plan
# A search over t_I ends at that share of the range, or after so many programs of some 10 ms each.
_NARROW, _MOST_TRIED = 5e-3, 16
# Rounds of linearised depths, the share of the largest force at which they are linearised at least, and what is left.
_MADE_ROUNDS, _LITTLE, _MADE, _OTHER_TIMES = 12, 1e-3, 1e-7, 4
# Share of the largest force by which forces may still change from one round to the next: what is linearised about them
# is off by the square of it.
_AGAIN = 1e-2
_FARTHEST_OFF = 1e3  # [-] of contact stiffness
_GOLDEN = (3 - np.sqrt(5)) / 2


@dataclass(frozen=True, slots=True, kw_only=True)
class Reserve:
    """What a squeeze bears besides the weight that it is planned for. All shares may be 0.

    Attributes:
        disturbance: force in any direction, as share of the weight [-]; and moment about any axis, this force times
            ``moment_arm``. Either of the two, or a mixture of shares of both that add up to one.
        moment_arm: arm of the moments [m]; None: the object's largest radius of gyration about its centre of mass, the
            arm at which its mass resists turning. 0: forces alone.
        mass: the object may be lighter or heavier by this share [-].
        friction: share of every friction coefficient (and of torsion) that is not relied on [-].
        normal_force: least normal force of each contact, as share of the weight [-]; where it is not 0, at least
            :data:`LEAST_FORCE`.
        torque: share of each torque limit that is kept free [-].
        softer: the contacts may be softer than assumed by this factor, and all of the above is borne there, too [-]; 1:
            as assumed. What a squeeze becomes there depends on the stiffness of the hand's servos.
        stiffer: or stiffer by this factor [-].
    """

    disturbance: float = 0.5
    moment_arm: float | None = None
    mass: float = 0.2
    friction: float = 0.2
    normal_force: float = 0.05
    torque: float = 0.1
    softer: float = 1.0
    stiffer: float = 1.0

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
        put("softer", number("reserve: softer", self.softer, at_least=1, at_most=_FARTHEST_OFF))
        put("stiffer", number("reserve: stiffer", self.stiffer, at_least=1, at_most=_FARTHEST_OFF))

    @classmethod
    def none(cls) -> Reserve:
        """No reserve: the weight alone, all of the friction and of the torques."""
        return cls(disturbance=0.0, moment_arm=0.0, mass=0.0, friction=0.0, normal_force=0.0, torque=0.0)

    @property
    def stiffness_factors(self) -> tuple[float, ...]:
        """Real over assumed stiffness of the contacts at both ends of what is borne, without 1 [-]."""
        return tuple(factor for factor in (1.0 / self.softer, self.stiffer) if factor != 1)

    def arm(self, body: Body) -> float:
        """The arm of the moments for a body [m]."""
        instance_of("body", body, Body)
        if self.moment_arm is not None:
            return self.moment_arm
        return float(np.sqrt(np.linalg.eigvalsh(body.inertia_b)[-1] / body.mass))

    def load_set(self, body: Body, gravity_o: ArrayLike = (0.0, 0.0, -9.81)) -> LoadSet:
        """The loads that a body brings: weights of the least and the largest mass, each with every disturbance.

        The disturbances are the convex hull of a ball of forces (radius ``disturbance`` times the weight) and a ball of
        moments (that times the arm). Both balls lie inside icosahedra with vertices :data:`CIRCUMSCRIBED` = 1.26 times
        as far out, one vertex along the weight and the others turned with the body, so that nothing depends on the
        world's axes; forces change by a percent where the file has other axes. Loads that lie between others are left
        out.

        Args:
            body: what is held.
            gravity_o: gravity (3,) [m/s^2].
        """
        weight_o = instance_of("body", body, Body).mass * array_of("gravity", gravity_o, (3,))
        weight = float(np.linalg.norm(weight_o))
        multiples = (1.0 - self.mass, 1.0 + self.mass) if self.mass else (1.0,)
        masses = np.zeros((len(multiples), 6))
        masses[:, :3] = np.outer(multiples, weight_o)
        size = CIRCUMSCRIBED * self.disturbance * weight
        if size == 0:
            return LoadSet(loads=np.unique(masses, axis=0))
        directions = _icosahedron(weight_o / weight, body.shape_pose[:3, :3])
        forces = np.zeros((12, 6))
        forces[:, :3] = size * directions
        # Of the loads along the weight the least and the largest are enough: the others lie between them.
        along, against, around = forces[:1], forces[1:2], forces[2:]
        loads = [masses[:1] + against, masses[-1:] + along, *(mass + around for mass in masses)]
        if arm := self.arm(body):
            moments = np.zeros((12, 6))
            moments[:, 3:] = size * arm * directions
            loads += [mass + moments for mass in masses]
        return LoadSet(loads=np.concatenate(loads))

    def kept_friction(self, friction: Friction) -> Friction:
        """The friction that is relied on."""
        instance_of("friction", friction, Friction)
        return replace(friction, safety=friction.safety / (1.0 - self.friction)) if self.friction else friction

    def least_force(self, weight: float) -> float:
        """The least normal force of each contact [N] under a weight [N]."""
        weight = number("weight", weight, at_least=0, unit="N")
        return max(LEAST_FORCE, self.normal_force * weight) if self.normal_force else 0.0

    def problem(self, problem: ForceProblem) -> ForceProblem:
        """A problem with what the reserve keeps back: friction, torque limits, and a least normal force per contact.

        Friction is kept back by the friction model's safety factor, torques by ``TorqueLimits.reserve``, so that the
        problem still has its own mu and limits, and margins are those of all of it.
        """
        body = _held(instance_of("problem", problem, ForceProblem))
        friction, torques, floor = problem.friction, problem.torques, problem.min_normal_force
        friction = self.kept_friction(friction)
        if self.torque and torques is not None:
            torques = replace(torques, headroom=1.0 - (1.0 - torques.headroom) * (1.0 - self.torque))
        if self.normal_force:
            least = self.least_force(body.mass * float(np.linalg.norm(problem.gravity_o)))
            floor = np.maximum(least, np.zeros(problem.k) if floor is None else floor)
        return replace(problem, friction=friction, torques=torques, min_normal_force=floor)

    def summary(self) -> dict[str, float | None]:
        """As plain JSON values."""
        return {
            "disturbance": self.disturbance,
            "moment_arm_m": self.moment_arm,
            "mass": self.mass,
            "friction": self.friction,
            "normal_force": self.normal_force,
            "torque": self.torque,
            "softer": self.softer,
            "stiffer": self.stiffer,
        }


def optimize_reserve(
    problem: ForceProblem,
    reserve: Reserve,
    impact_time: float,
    *,
    objective: Objective | None = None,
) -> RobustForces:
    """The least-cost normal forces that hold a problem's object with a reserve, for an impact at one t_I.

    The loads are those of the weight, :meth:`Reserve.load_set`. The normal forces are those under the problem's
    own load, the weight; they change with a load as contacts on equal springs would.

    Args:
        problem: of holding an object (``ForceProblem.holding``), without the reserve.
        reserve: what to bear besides.
        impact_time: t_I [s].
        objective: as for :func:`~pinograsp.forces.optimize_robust`.

    Raises:
        InvalidInput: a problem without an object, or another objective.
    """
    instance_of("problem", problem, ForceProblem)
    instance_of("reserve", reserve, Reserve)
    loads, kept = _kept_back(problem, reserve)
    return optimize_robust(kept, loads, impact_time, objective=objective, reaction="elastic")


def search_reserve(
    problem: ForceProblem,
    reserve: Reserve,
    *,
    objective: Objective | None = None,
    start: float | None = None,
) -> RobustForces:
    """The least-cost squeeze that a search over the impact times finds: a certified program at each that it tries.

    Late impacts cost less, but leave less time to press; between the two the search narrows an interval around the best
    impact time so far. Its squeeze is the proven optimum of its own impact time; that no other one is cheaper is not
    proven.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to bear besides.
        objective: as for :func:`~pinograsp.forces.optimize_robust`.
        start: impact time of an earlier squeeze [s]: if it does and no torque limit is met, there is no search.

    Returns:
        The squeeze; ``INFEASIBLE``: no impact time admits any (proven), ``INACCURATE``: none was found.

    Raises:
        InvalidInput: a problem without an object, or another objective.
    """
    instance_of("problem", problem, ForceProblem)
    instance_of("reserve", reserve, Reserve)
    started, weights = time.perf_counter(), robust_weights(objective, problem)
    loads, kept = _kept_back(problem, reserve)
    early, late = problem.impact_time_range
    tried: dict[float, RobustForces] = {}

    def cost(t: float) -> float:
        if t not in tried:
            tried[t] = robust_at(kept, loads, t, weights, reaction="elastic", proven=False)
        certificate = tried[t].certificate
        return np.inf if tried[t].status is not Status.OK or certificate is None else certificate.objective

    if start is not None and cost(start) < np.inf:
        found = tried[start]
        if found.certificate is not None and not found.certificate.at_torque:
            return found
    first = np.linspace(early, late, 4).tolist() if late > early else [early]
    if min([cost(t) for t in first]) == np.inf:
        bounds = widest_range(kept)
        none = robust_at(kept, loads, early, weights, reaction="elastic", bounds=bounds)
        if none.status is Status.OK:
            none = replace(tried[early], status=Status.INACCURATE)
        return replace(none, tried=len(tried), elapsed=time.perf_counter() - started)
    while len(tried) < _MOST_TRIED:
        times = sorted(tried)
        best = min(range(len(times)), key=lambda i: cost(times[i]))
        before, after = times[max(best - 1, 0)], times[min(best + 1, len(times) - 1)]
        if after - before <= _NARROW * (late - early):
            break
        # The larger of the two parts beside the best, at the golden section.
        at = times[best]
        cost(at + _GOLDEN * (after - at) if after - at > at - before else at - _GOLDEN * (at - before))
    best_time = min(tried, key=cost)
    return replace(tried[best_time], tried=len(tried), elapsed=time.perf_counter() - started)


def least_squeeze(problem: ForceProblem, reserve: Reserve, *, rows: ArrayLike | None = None) -> Array | None:
    """Normal forces (k,) [N] of a squeeze that bears the reserve, within all that any impact time allows.

    That of least largest force; None: there is none. One program, for searches.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to bear besides the weight.
        rows: combinations (p, k) of the depths that the hand cannot change [-], as for :func:`producible_reserve`, here
            linearised at even forces alone.
    """
    instance_of("problem", problem, ForceProblem)
    instance_of("reserve", reserve, Reserve)
    loads, kept = _kept_back(problem, reserve)
    made = np.zeros((0, problem.k)) if rows is None else array_of("rows", rows, (None, problem.k))
    # About even forces F the depths are (1 + (f / F - 1) / rho) times the same: only the ratios of the forces count,
    # where rho, the law's own or that of its slope at the load's share of a contact, does not depend on the depth.
    share = _power_at(problem.compliance, problem.scaled_norm(problem.load) / problem.k)
    fixed = np.asarray(made @ (share * np.eye(problem.k) + (1.0 - share) / problem.k)), np.zeros(len(made))
    weights = robust_weights("peak", problem)
    early, bounds = problem.impact_time_range[0], widest_range(kept)
    found = robust_at(kept, loads, early, weights, reaction="elastic", bounds=bounds, fixed=fixed, proven=False)
    return found.normal_forces if found.status is Status.OK else None


def producible_reserve(
    problem: ForceProblem,
    reserve: Reserve,
    squeeze: RobustForces,
    rows: ArrayLike,
    *,
    objective: Objective | None = None,
    scenarios: Callable[[ConvexSolution], Sequence[StiffnessScenario]] | None = None,
) -> RobustForces:
    """The least-cost squeeze with depths that the hand can press to, at or near the impact time of ``squeeze``.

    ``rows`` times the depths are zero. As F_n = K delta^rho is not linear, these equations are linearised, at even
    forces first and then at the forces found, until these keep to them. So is what the squeeze becomes on contacts of
    another stiffness.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to bear besides the weight.
        squeeze: :func:`search_reserve`'s, with any depths.
        rows: combinations (p, k) of the depths that the hand cannot change [-].
        objective: as for :func:`~pinograsp.forces.optimize_robust`.
        scenarios: what the forces under the problem's load become on contacts of another stiffness, to first order
            about them; None: contacts are as stiff as assumed.

    Returns:
        The squeeze; ``INACCURATE``: none was found.

    Raises:
        InvalidInput: a problem without an object, a squeeze without forces, or another objective.
    """
    instance_of("problem", problem, ForceProblem)
    instance_of("reserve", reserve, Reserve)
    rows = array_of("rows", rows, (None, problem.k))
    if not len(squeeze.normal_forces):
        raise InvalidInput(f"squeeze: expected one with forces, got status '{squeeze.status}'")
    if not len(rows) and scenarios is None:
        return squeeze
    started, weights = time.perf_counter(), robust_weights(objective, problem)
    loads, kept = _kept_back(problem, reserve)
    law, tried = problem.compliance, 0
    times = [squeeze.impact_time, *np.linspace(*problem.impact_time_range, _OTHER_TIMES)[::-1].tolist()]
    found = replace(squeeze, status=Status.INACCURATE)
    for t in times:
        F = np.full(problem.k, squeeze.normal_forces.mean()) if len(rows) else squeeze.normal_forces
        last = squeeze
        for _ in range(_MADE_ROUNDS):
            least = np.maximum(F, _LITTLE * F.max())
            depths = law.depth(least)
            slopes = 1.0 / law.slope(depths)
            size = float(slopes.max())
            equations = rows * slopes / size, rows @ (slopes * F - depths) / size
            others = () if scenarios is None else scenarios(last.under(problem.load))
            found = robust_at(
                kept, loads, t, weights, reaction="elastic", fixed=equations, scenarios=others, proven=False
            )
            tried += 1
            if found.status is not Status.OK:
                break
            before, F = F, found.normal_forces
            depths = law.depth(F)
            made = np.abs(rows @ depths).max(initial=0.0) <= _MADE * depths.max()
            if made and (scenarios is None or np.abs(F - before).max() <= _AGAIN * F.max()):
                return replace(found, tried=tried, elapsed=time.perf_counter() - started)
            last = found
    return replace(found, status=Status.INACCURATE, tried=tried, elapsed=time.perf_counter() - started)


def reserve_along(
    problem: ForceProblem,
    reserve: Reserve,
    squeeze: RobustForces,
    start: ArrayLike,
    direction: ArrayLike,
    *,
    objective: Objective | None = None,
) -> RobustForces:
    """The least-cost squeeze among those whose normal forces are ``start`` plus a multiple of ``direction``.

    Args:
        problem: of holding an object, without the reserve.
        reserve: what to bear besides the weight.
        squeeze: :func:`search_reserve`'s, at whose impact time or near it this one is.
        start: normal forces (k,) [N].
        direction: of their change (k,), not all 0.
        objective: as for :func:`~pinograsp.forces.optimize_robust`.

    Returns:
        The squeeze; ``INACCURATE``: none was found.

    Raises:
        InvalidInput: a problem without an object, forces that cannot be used, or another objective.
    """
    instance_of("problem", problem, ForceProblem)
    instance_of("reserve", reserve, Reserve)
    start, direction = array_of("start", start, (problem.k,)), array_of("direction", direction, (problem.k,))
    size = float(np.linalg.norm(direction))
    if not size > 0:
        raise InvalidInput("direction: expected one in which a normal force changes, got zeros")
    began, weights = time.perf_counter(), robust_weights(objective, problem)
    loads, kept = _kept_back(problem, reserve)
    across = np.eye(problem.k) - np.outer(direction, direction) / size**2
    found, tried = replace(squeeze, status=Status.INACCURATE), 0
    for t in [squeeze.impact_time, *np.linspace(*problem.impact_time_range, _OTHER_TIMES)[::-1].tolist()]:
        fixed = across, across @ start
        found = robust_at(kept, loads, t, weights, reaction="elastic", fixed=fixed, proven=False)
        tried += 1
        if found.status is Status.OK:
            break
    return replace(found, tried=tried, elapsed=time.perf_counter() - began)


def _kept_back(problem: ForceProblem, reserve: Reserve) -> tuple[LoadSet, ForceProblem]:
    """The loads of a reserve, and the problem with what it keeps back."""
    return reserve.load_set(_held(problem), problem.gravity_o), reserve.problem(problem)


def _power_at(law: Compliance, force: float) -> float:
    """1 / rho [-] of the power law that touches a law at a normal force [N]."""
    depth = law.depth(force or 1.0)
    return float((force or 1.0) / (depth * law.slope(depth)))


def widest_range(kept: ForceProblem) -> tuple[Array, Array]:
    """All that any impact time allows of F_n: the least lower bound, of the latest one, to the largest upper bound."""
    early, late = kept.impact_time_range
    return kept.normal_force_range(late)[0], kept.normal_force_range(early)[1]


def _held(problem: ForceProblem) -> Body:
    if problem.object is None:
        raise InvalidInput("reserve: expected the problem of holding an object, got one without: ForceProblem.holding")
    return problem.object


def _icosahedron(first: Array, axes: Array) -> Array:
    """Unit vectors (12, 3): ``first`` (3,), its opposite, and two rings of five around it.

    The rings are turned with that column of ``axes`` (3, 3) which is most across ``first``.
    """
    across = axes[:, np.argmin(np.abs(first @ axes))]
    across = across - first * (first @ across)
    across /= np.linalg.norm(across)
    third, height = np.cross(first, across), 1 / np.sqrt(5)
    turns = np.pi / 5 * np.arange(10)
    ring = np.sqrt(1 - height**2) * (np.outer(np.cos(turns), across) + np.outer(np.sin(turns), third))
    ring += np.outer(height * (-1.0) ** np.arange(10), first)
    return np.concatenate([[first, -first], ring])
