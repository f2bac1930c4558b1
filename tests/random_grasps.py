"""Seeded random grasps, and an oracle for them: the force problem written again in CVXPY, from its definition.

The oracle shares nothing with the package but the inputs (contact points and frames, and the documented values of
``ForceProblem``): contact forces are world vectors, polygons are combinations of their vertices, the integrals of the
grasp energy are summed numerically. ECOS solves it, which the package does not use.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

import cvxpy as cp
import numpy as np
from conftest import make_contacts
from scipy.integrate import cumulative_simpson, simpson

from pinograsp.contacts import ContactSet, DecelerationShape, Friction, MarhefkaOrin
from pinograsp.forces import ForceProblem, TorqueLimits
from pinograsp.spatial import rotation_rpy, tangent_frame

FAMILIES = ("pyramid", "fine pyramid", "cone", "soft")
DEGENERATE = (
    "no friction",
    "some without friction",
    "duplicates",
    "collinear",
    "parallel normals",
    "zero load",
    "pinch",
)
OBJECTIVES = ("impulse", "work", "least_squares", "peak", "motor_heat")


@dataclass(frozen=True)
class Grasp:
    """One random case.

    ``degenerate``: what is special about it, "" as a rule. ``factor``: load over the largest that can be held, or None.
    """

    seed: int
    problem: ForceProblem
    impact_time: float
    objective: str | dict[str, float]
    body: str
    degenerate: str
    factor: float | None

    def __str__(self) -> str:
        p = self.problem
        torques = "with" if p.torques is not None else "without"
        return (
            f"seed {self.seed}: {p.k} contacts on a {self.body}{f' ({self.degenerate})' * bool(self.degenerate)}, "
            f"{p.balance} balance, {p.friction}, {torques} torques, t_I = {self.impact_time:.4f}, {self.objective}, "
            f"load factor {self.factor}"
        )


# -- the generator -----------------------------------------------------------------------------------------------------


def random_grasp(
    seed: int,
    *,
    family: str | None = None,
    k: int | None = None,
    torques: bool | None = None,
    degenerate: str | None = None,
    load: str | None = None,
) -> Grasp:
    """The grasp of a seed; every argument that is None is drawn too.

    ``load``: "plain", "limit" (0.3 to 3 times the largest that can be held) or "edge" (that one but for 1e-8 to 1e-4).
    """
    rng = np.random.default_rng([2718, seed])
    drawn = str(rng.choice(FAMILIES)), int(rng.integers(3, 21)), rng.random() < 0.5, rng.random() < 0.12
    family, k, torques = family or drawn[0], k or drawn[1], drawn[2] if torques is None else torques
    if degenerate is None:
        degenerate = str(rng.choice(DEGENERATE)) if drawn[3] else ""
    body, points, normals, com, size = _on_a_body(rng, k, degenerate)
    gravity = -9.81 * (np.array([0.0, 0, 1]) if rng.random() < 0.7 else unit(rng))
    mu = np.full(k, rng.uniform(0.3, 0.9)) if rng.random() < 0.5 else rng.uniform(0.3, 0.9, k)
    if degenerate == "no friction":
        mu = np.zeros(k)
    elif degenerate == "some without friction":
        mu = np.where(rng.random(k) < 0.5, 0.0, mu)
    wrench = np.zeros(6)
    if degenerate != "zero load":
        weight = rng.uniform(0.5, 3) if rng.random() < 0.7 else rng.uniform(3, 20)
        wrench[:3] = weight * (gravity / 9.81 if rng.random() < 0.6 else unit(rng))
        if rng.random() < 0.6:
            wrench[3:] = weight * size * rng.uniform(0, 0.6) * unit(rng)
    exponent = float(rng.choice([1.5, 1.5, 1.5, 1.0, 2.0]))
    problem = ForceProblem(
        contacts=contact_set_of(points, normals, com, gravity),
        load=wrench,
        gravity_o=gravity,
        mu=mu,
        compliance=MarhefkaOrin(
            stiffness={1.0: 4e3, 1.5: 5e4, 2.0: 7e5}[exponent] * rng.choice([1.0, rng.uniform(0.5, 2)]),
            damping=float(rng.choice([100.0, 100.0, 0.0, 400.0])),
            exponent=exponent,
        ),
        balance=str(rng.choice(["wrench", "wrench", "force"])),
        measure=str(rng.choice(["impulse", "work"])),
        friction=_friction(rng, family),
        shape=DecelerationShape.constant() if rng.random() < 0.7 else DecelerationShape.linear(*rng.uniform(0.1, 1, 2)),
        max_depth=5e-3,
        acceleration_range=(0.01, 1.0),
    )
    impact_time = float(rng.uniform(0.80, 0.95))
    low, high = normal_force_range(problem, impact_time)
    if rng.random() < 0.3:
        caps = np.maximum(rng.uniform(0.05, 1.2, k) * high, 1.01 * low)
        if rng.random() < 0.03:
            caps[rng.integers(k)] = 0.9 * low[0]  # excluded by the least normal force
        problem = replace(problem, max_normal_force=caps if rng.random() < 0.5 else float(caps.max()))
    if torques:
        problem = replace(problem, torques=_torque_limits(rng, k, float(high[0])))
    objective = _objective(rng, torques)
    if load is None:
        load = "limit" if rng.random() < 0.75 else "plain"
    factor = None
    if load != "plain" and degenerate != "zero load":
        largest = load_factor(problem, impact_time)
        if largest is not None and 1e-3 < largest < 1e4:
            near = float(10 ** (rng.uniform(-4, -2) if load == "limit" else rng.uniform(-9, -4)))
            factor = 1 + near * float(rng.choice([-1.0, 1.0]))
            if load == "limit" and rng.random() < 0.85:
                factor = float(np.exp(rng.uniform(np.log(0.3), np.log(3))))
            problem = replace(problem, load=largest * factor * problem.load)
    return Grasp(seed, problem, impact_time, objective, body, degenerate, factor)


def unit(rng: np.random.Generator) -> np.ndarray:
    """A direction (3,), uniformly distributed."""
    v = rng.normal(size=3)
    return v / np.linalg.norm(v)


def contact_set_of(points, normals, com=(0.0, 0.0, 0.0), gravity=(0.0, 0.0, -9.81)) -> ContactSet:
    """Contacts at points (k, 3) with inward normals (k, 3), of no hand."""
    return make_contacts(points, [tangent_frame(normal, gravity) for normal in normals], com)


def _on_a_body(rng, k, degenerate):
    """Body, points (k, 3), inward normals (k, 3), centre of mass, size [m]; half of them with opposed contacts."""
    body = str(rng.choice(["cylinder", "sphere", "box"]))
    opposed = rng.random() < 0.5
    if degenerate in ("collinear", "parallel normals"):
        body = "box"
    if degenerate == "pinch":
        body = "sphere"
    signs = np.where(np.arange(k) % 2, -1.0, 1.0)
    if body == "sphere":
        size = rng.uniform(0.015, 0.06)
        outward = np.array([unit(rng) for _ in range(k)])
        if opposed or degenerate == "pinch":  # a pinch: all contacts at two opposite points
            outward = signs[:, None] * unit(rng) + (0.0 if degenerate == "pinch" else 0.4) * outward
            outward /= np.linalg.norm(outward, axis=1)[:, None]
        points = size * outward
    elif body == "cylinder":
        size, height = rng.uniform(0.01, 0.05), rng.uniform(0.05, 0.2)
        angles = rng.uniform(0, 2 * np.pi, k)
        if opposed:
            angles = angles[0] + np.pi * (np.arange(k) % 2) + rng.uniform(-0.5, 0.5, k)
        outward = np.column_stack([np.cos(angles), np.sin(angles), np.zeros(k)])
        points = size * outward + np.outer(rng.uniform(-0.5, 0.5, k) * min(height, 4 * size), [0, 0, 1])
        ends = rng.random(k) < (0.0 if opposed else 0.2)
        outward[ends] = np.outer(rng.choice([-1.0, 1.0], ends.sum()), [0, 0, 1])
        points[ends] = points[ends] * [0.5, 0.5, 0] + outward[ends] * height / 2
    else:
        half = rng.uniform(0.01, 0.05, 3)
        size = float(half.mean())
        axis, sign = rng.integers(0, 3, k), rng.choice([-1.0, 1.0], k)
        if opposed or degenerate in ("collinear", "parallel normals"):
            axis[:], sign = axis[0], signs
        if degenerate == "parallel normals" and rng.random() < 0.5:
            sign[:] = 1.0  # all on one face
        points = rng.uniform(-0.9, 0.9, (k, 3)) * half
        if degenerate == "collinear":
            points = np.outer(rng.uniform(-0.9, 0.9, k), half * unit(rng))
            if rng.random() < 0.5:
                points[:] = points[0]  # on a line through both faces, else on a line in each
        outward = np.zeros((k, 3))
        outward[np.arange(k), axis] = sign
        points[np.arange(k), axis] = sign * half[axis]
    if degenerate == "duplicates":
        source = rng.integers(0, max(1, k // 2), k)
        points, outward = points[source], outward[source]
    pose, com = rotation_rpy(*rng.uniform(-np.pi, np.pi, 3)), rng.uniform(-0.1, 0.1, 3)
    if rng.random() < 0.4:
        pose = np.eye(3)
    return body, com + points @ pose.T, -outward @ pose.T, com, float(size)


def _friction(rng, family) -> Friction:
    safety = float(rng.choice([1.0, 1.0, rng.uniform(1, 2)]))
    torsion = float(rng.choice([0.0, 0.0, rng.uniform(1e-3, 1e-2)]))
    if family == "soft":
        torsion = float(rng.uniform(1e-3, 1e-2))
    edges = int(rng.choice([8, 16])) if family == "fine pyramid" else 4
    return Friction(model=family.removeprefix("fine "), edges=edges, torsion=torsion, safety=safety)


def _torque_limits(rng, k, force) -> TorqueLimits:
    """Fingers of three to four joints that share the contacts out, or a random Jacobian; limits of the order of use."""
    joints = int(rng.integers(3, 5))
    n = joints * int(rng.integers(1, min(k, 5) + 1))
    jacobian = np.concatenate([rng.uniform(-0.08, 0.08, (k, 3, n)), rng.normal(size=(k, 3, n))], axis=1)
    if rng.random() < 0.7:
        owner = rng.integers(0, n // joints, k)
        jacobian *= (np.arange(n) // joints == owner[:, None])[:, None, :]
    limit = 0.05 * force * rng.uniform(0.2, 3, n)
    bias = limit * rng.uniform(-0.5, 0.5, n) * rng.choice([0.0, 1.0])
    if rng.random() < 0.05:
        bias[0] = 1.1 * limit[0]  # too much already without contact: the contacts must unload the joint
    limit[rng.random(n) < 0.2] = np.inf
    return TorqueLimits(jacobian=jacobian, bias=bias, limit=limit)


def _objective(rng, torques) -> str | dict[str, float]:
    names = OBJECTIVES if torques else OBJECTIVES[:-1]
    if rng.random() < 0.75:
        return str(rng.choice(names))
    typical = {"impulse": 1.0, "work": 20.0, "least_squares": 1e-2, "peak": 0.2, "motor_heat": 10.0}
    chosen = rng.choice(names, int(rng.integers(2, len(names) + 1)), replace=False)
    return {str(name): float(typical[name] * 10 ** rng.uniform(-1, 1)) for name in chosen}


# -- the oracle --------------------------------------------------------------------------------------------------------


@lru_cache(maxsize=4096)
def _integrals(shape: DecelerationShape, rho: float) -> tuple[float, float, float, float]:
    """Impact speed / (A tau), depth / (A tau^2), and the integrals of sigma^rho and sigma^rho sigma'^2 over u."""
    w = np.linspace(0, 1, 2001)  # u = w^2 takes the root out of sigma^rho at u = 0
    u, du = w**2, 2 * w
    lost = cumulative_simpson(shape.acceleration(u) * du, x=w, initial=0)
    rate = lost[-1] - lost
    depth = cumulative_simpson(rate * du, x=w, initial=0)
    sigma, slope = np.maximum(depth / depth[-1], 0), rate / depth[-1]
    return lost[-1], depth[-1], simpson(sigma**rho * du, x=w), simpson(sigma**rho * slope**2 * du, x=w)


def normal_force_range(problem: ForceProblem, impact_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest F_n (k,) [N]: Eqs. (13) for a deceleration of peak A, and the caps."""
    tau = problem.final_time - impact_time
    v, m, _, _ = _integrals(problem.shape, problem.compliance.exponent)
    A_low, A_high = problem.acceleration_range
    A_high = min(A_high, problem.max_speed / (v * tau), problem.max_depth / (m * tau**2))
    law = problem.compliance
    low, high = (law.stiffness * (m * A * tau**2) ** law.exponent for A in (A_low, A_high))
    caps = np.inf if problem.max_normal_force is None else problem.max_normal_force
    return np.full(problem.k, low), np.minimum(np.full(problem.k, high), caps)


def force_scale(problem: ForceProblem, impact_time: float) -> float:
    """The load [N], moments over the moment length; without a load the least normal force."""
    load = np.linalg.norm([*problem.load[:3], *problem.load[3:] / problem.moment_length][: problem.rows])
    return float(load) or float(normal_force_range(problem, impact_time)[0].max())


class Model:
    """The constraints of a force problem in CVXPY; forces in contact axes, over ``scale`` [N].

    ``load``: a factor on the load, which may be a variable.
    """

    def __init__(self, problem: ForceProblem, impact_time: float, *, load=1.0):
        k, friction = problem.k, problem.friction
        self.problem, self.impact_time = problem, impact_time
        self.scale = S = force_scale(problem, impact_time)
        self.low, self.high = normal_force_range(problem, impact_time)
        self.F, self.t = cp.Variable(k), cp.Variable((k, 2))
        self.m = cp.Variable(k) if friction.torsion > 0 else None  # torsional moments over S torsion
        mu, torsion = np.tile(problem.mu[:, None] / friction.safety, (1, 2)), friction.torsion
        if friction.model == "pyramid":
            share = cp.Variable((k, friction.edges), nonneg=True)  # of the polygon's corners
            self.friction = [self.t == cp.multiply(mu, share @ friction.vertices), cp.sum(share, axis=1) == self.F]
        elif friction.model == "cone":
            self.friction = [cp.SOC(cp.multiply(mu[:, 0], self.F), self.t, axis=1)]
        else:
            u = cp.Variable((k, 2))  # t = mu u does without dividing by mu = 0
            ball = cp.hstack([u, self.m[:, None] * friction.safety])
            self.friction = [self.t == cp.multiply(mu, u), cp.SOC(self.F, ball, axis=1)]
        if self.m is not None and friction.model != "soft":
            self.friction.append(cp.abs(self.m) <= self.F / friction.safety)
        self.bounds = [self.F - self.low / S >= 0, self.high / S - self.F >= 0]
        # Net wrench over S, moments over S and the moment length.
        R, points = problem.contacts.rotations_oc, problem.contacts.points_o - problem.contacts.com_o
        world = cp.multiply(self.F[:, None], R[:, :, 2])
        world += cp.multiply(self.t[:, 0:1], R[:, :, 0]) + cp.multiply(self.t[:, 1:2], R[:, :, 1])
        x, y, z = (world[:, i] for i in range(3))
        px, py, pz = points.T / problem.moment_length
        moments = [
            cp.multiply(py, z) - cp.multiply(pz, y),
            cp.multiply(pz, x) - cp.multiply(px, z),
            cp.multiply(px, y) - cp.multiply(py, x),
        ]
        if self.m is not None:
            spin = self.m * (torsion / problem.moment_length)
            moments = [moment + cp.multiply(spin, R[:, i, 2]) for i, moment in enumerate(moments)]
        given = problem.load / S
        given[3:] /= problem.moment_length
        net = cp.hstack([cp.sum(part) for part in (x, y, z, *moments)]) + load * given
        self.net = net[: problem.rows]
        self.torque, self.torque_share = None, None
        if problem.torques is not None:
            J, limit = problem.torques.jacobian, problem.torques.limit
            tau = sum(J[:, i].T @ world[:, i] for i in range(3))
            if self.m is not None:
                tau = tau + np.einsum("kxn,kx->nk", J[:, 3:], R[:, :, 2]) @ (self.m * torsion)
            self.torque = tau * S + problem.torques.bias  # [N m]
            finite = np.isfinite(limit)
            if finite.any():
                self.torque_share = cp.multiply(self.torque[finite], 1 / limit[finite])

    @property
    def constraints(self) -> list:
        limits = [] if self.torque_share is None else [self.torque_share <= 1, self.torque_share >= -1]
        return [*self.friction, *self.bounds, *limits, self.net == 0]

    def cost(self, objective) -> tuple[cp.Expression, float]:
        """The objective over a unit, and the unit."""
        p, S = self.problem, self.scale
        weights = _weights(objective)
        tau, law = p.final_time - self.impact_time, p.compliance
        K, damping, rho = law.stiffness, law.damping, law.exponent
        _, _, mean, damped = _integrals(p.shape, rho)
        # delta = (F / K)^(1/rho); (rho + 1) times the integral of (damping ddelta + K) delta^rho over time or depth.
        scale = {n: (S / K) ** ((rho + n) / rho) for n in (1, 2)}
        exact = Fraction(rho).limit_denominator(100)

        def power(n):
            return cp.sum(cp.power(self.F, (exact + n) / exact))

        parts: list[tuple[float, cp.Expression]] = []
        for name, weight in weights.items():
            if name == "impulse":
                parts.append((weight * (rho + 1) * mean * tau * S, cp.sum(self.F)))
                if damping:
                    parts.append((weight * damping * scale[1], power(1)))
            elif name == "work":
                parts.append((weight * K * scale[1], power(1)))
                if damping:
                    parts.append((weight * (rho + 1) * damped * damping / tau * scale[2], power(2)))
            elif name == "least_squares":
                parts.append((weight * S**2, cp.sum_squares(self.t) + cp.sum_squares(self.F)))
                if self.m is not None:
                    length = p.friction.torsion / p.moment_length
                    parts.append((weight * (S * length) ** 2, cp.sum_squares(self.m)))
            elif name == "peak":
                parts.append((weight * S, cp.max(self.F)))
            else:
                size = float(np.linalg.norm(p.torques.jacobian[:, :3], axis=(0, 1)).max() * S)
                parts.append((weight * size**2, cp.sum_squares(self.torque / size)))
        whole = max(size for size, _ in parts)
        return sum((size / whole) * term for size, term in parts), whole


def _weights(objective) -> dict[str, float]:
    return dict(objective) if isinstance(objective, Mapping) else {objective: 1.0}


# In this order until one of them solves the problem well; ECOS is not among the package's solvers.
ATTEMPTS = [
    *((cp.ECOS, {"abstol": tol, "reltol": tol, "feastol": tol, "max_iters": 200}) for tol in (1e-10, 1e-9)),
    *((cp.CLARABEL, {"tol_gap_abs": tol, "tol_gap_rel": tol, "tol_feas": tol}) for tol in (1e-10, 1e-9)),
    (cp.ECOS, {"abstol": 1e-8, "reltol": 1e-8, "feastol": 1e-8, "max_iters": 200}),
]
GOOD = 1e-8


def solve(objective, constraints) -> tuple[str, float, str]:
    """Status ("optimal", "infeasible" or "?"), value, and who said so: ECOS, or where it stops short another solver."""
    task = cp.Problem(objective, constraints)
    best = ("?", np.nan, "", np.inf)
    for solver, options in ATTEMPTS:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                task.solve(solver=solver, **options)
        except (cp.SolverError, ValueError, ArithmeticError):
            continue
        if task.status == cp.INFEASIBLE and best[0] == "?":
            return "infeasible", np.inf, solver
        if task.status == cp.OPTIMAL and (doubt := _doubt(task)) < best[3]:
            best = ("optimal", float(task.value), solver, doubt)
        if best[3] <= GOOD * max(abs(best[1]), 1e-2):
            break
    return best[:3]


def _doubt(task) -> float:
    """How far the value may be off, to first order: what constraints are missed by, times their multipliers.

    Near the limit of feasibility multipliers are large: a solver's tolerance on the constraints is none on the value.
    """
    total = 0.0
    for constraint in task.constraints:
        dual = constraint.dual_value
        if isinstance(constraint, cp.SOC):
            bound, vectors = (arg.value for arg in constraint.args)
            dual, missed = dual[0], np.maximum(0, np.linalg.norm(vectors, axis=1) - bound)
        else:
            missed = constraint.violation()
        total += float(np.sum(np.abs(np.ravel(dual) * np.ravel(missed))))
    return total


def optimum(grasp: Grasp) -> tuple[str, float, str]:
    """Status, least objective, and who said so."""
    model = Model(grasp.problem, grasp.impact_time)
    if np.any(model.low > model.high):
        return "infeasible", np.inf, "bounds"
    cost, whole = model.cost(grasp.objective)
    status, value, solver = solve(cp.Minimize(cost), model.constraints)
    if status == "?" and least_residual(grasp.problem, grasp.impact_time) > 1e-6:
        return "infeasible", np.inf, "least residual"
    return status, value * whole, solver


def size_of(problem: ForceProblem, impact_time: float, objective, value: float) -> float:
    """What differences of an objective are relative to: its ``value``, as a rule.

    Motor heat can vanish: below 1e-4 of the heat of forces like the load (without one: the largest F_n) or of gravity,
    they are relative to 1 % of that heat.
    """
    weights = _weights(objective)
    if weights.keys() != {"motor_heat"}:
        return value
    model = Model(problem, impact_time)
    _, heat = model.cost("motor_heat")
    if not np.any(problem.load[: problem.rows]):
        heat *= (model.high.max() / model.scale) ** 2
    heat = weights["motor_heat"] * max(heat, float((problem.torques.bias**2).sum()))
    return value if value > 1e-4 * heat else 1e-2 * heat


def load_factor(problem: ForceProblem, impact_time: float, largest=True) -> float | None:
    """Largest (or least) multiple of the load that can be held; None where there is none, or no finite one."""
    s = cp.Variable(nonneg=True)
    model = Model(problem, impact_time, load=s)
    if np.any(model.low > model.high):
        return None
    status, value, _ = solve(cp.Maximize(s) if largest else cp.Minimize(s), model.constraints)
    return value if status == "optimal" else None


def least_residual(problem: ForceProblem, impact_time: float) -> float:
    """Least norm of net wrench over the load and torque excess over its limit that admissible forces leave."""
    model = Model(problem, impact_time)
    parts, limits = [model.net], []
    if model.torque_share is not None:
        parts.append(cp.Variable(model.torque_share.shape, nonneg=True))
        limits = [cp.abs(model.torque_share) <= 1 + parts[1]]
    return solve(cp.Minimize(cp.norm(cp.hstack(parts))), [*model.friction, *model.bounds, *limits])[1]


# -- checks of answers, in newtons -------------------------------------------------------------------------------------


def joint_torques(problem: ForceProblem, forces_c, torsion) -> np.ndarray:
    """Bias + J^T f (n,) [N m], contact by contact."""
    tau = problem.torques.bias.copy()
    for J, contact, force, moment in zip(problem.torques.jacobian, problem.contacts, forces_c, torsion):
        tau += J.T @ np.concatenate([contact.rotation_oc @ force, moment * contact.rotation_oc[:, 2]])
    return tau


def violations(problem: ForceProblem, impact_time: float, forces_c, torsion) -> dict[str, float]:
    """How far forces (k, 3) [N] and torsional moments (k,) [N m] miss each constraint, relative to the load.

    Without a load: relative to the largest force.
    """
    F, t = forces_c[:, 2], np.hypot(forces_c[:, 0], forces_c[:, 1])
    size = force_scale(problem, impact_time) if np.any(problem.load[: problem.rows]) else F.max()
    low, high = normal_force_range(problem, impact_time)
    net = problem.load.copy()
    for contact, force, moment in zip(problem.contacts, forces_c, torsion):
        h = contact.rotation_oc @ force
        net[:3] += h
        net[3:] += np.cross(contact.point_o - problem.contacts.com_o, h) + moment * contact.rotation_oc[:, 2]
    friction, limit = problem.friction, problem.mu / problem.friction.safety
    spin = np.abs(torsion) * friction.safety / friction.torsion if friction.torsion else np.zeros(problem.k)
    if friction.model == "soft":
        # |(t / mu, m / torsion)| <= F; without friction t must vanish.
        share = np.divide(t, limit, out=np.where(t > 0, np.inf, 0.0), where=limit > 0)
        beyond = np.hypot(share, spin) - F
    else:
        if friction.model == "pyramid":
            # Along a side of the polygon the radius is that of its middle over the cosine of the angle to there.
            step = 2 * np.pi / friction.edges
            corner = np.arctan2(*friction.vertices[0][::-1])
            angle = (np.arctan2(forces_c[:, 1], forces_c[:, 0]) - corner) % step - step / 2
            t = t * np.cos(angle) / np.cos(step / 2)
        beyond = np.maximum(t - limit * F, spin - F if friction.torsion else 0.0)
    found = {
        "force": np.linalg.norm(net[:3]) / size,
        "friction": beyond.max() / size,
        "bounds": max((low - F).max(), (F - high).max()) / size,
    }
    if problem.rows == 6:
        found["moment"] = np.linalg.norm(net[3:]) / problem.moment_length / size
    if problem.torques is not None:
        found["torque"] = (np.abs(joint_torques(problem, forces_c, torsion)) / problem.torques.limit - 1).max()
    if not friction.torsion:
        found["torsion"] = np.abs(torsion).max()
    return {name: float(value) for name, value in found.items()}


def objective_value(problem: ForceProblem, impact_time: float, objective, forces_c, torsion) -> float:
    """The objective at given forces, from its definition."""
    law, tau = problem.compliance, problem.final_time - impact_time
    rho = law.exponent
    depth = (forces_c[:, 2] / law.stiffness) ** (1 / rho)
    _, _, mean, damped = _integrals(problem.shape, rho)
    value = {
        "impulse": lambda: law.damping * depth ** (rho + 1) + (rho + 1) * mean * tau * law.stiffness * depth**rho,
        "work": lambda: (law.stiffness + (rho + 1) * damped * law.damping / tau * depth) * depth ** (rho + 1),
        "least_squares": lambda: (forces_c**2).sum(axis=1) + (torsion / problem.moment_length) ** 2,
        "peak": lambda: forces_c[:, 2].max(),
        "motor_heat": lambda: joint_torques(problem, forces_c, torsion) ** 2,
    }
    return float(sum(weight * np.sum(value[name]()) for name, weight in _weights(objective).items()))


def least_along(problem: ForceProblem, impact_time: float, direction, joint_weights) -> float:
    """Least value [N] of direction . net wrench + joint_weights . torque beyond its limits, over friction and bounds.

    The moments of the net wrench over the moment length, joint weights (n,) in 1/m. In closed form, contact by contact.
    Forces that hold the load make it 0 or less: where it is positive there are none.
    """
    low, high = normal_force_range(problem, impact_time)
    y = np.asarray(direction, dtype=float).copy()
    y[3:] /= problem.moment_length
    total = float(y @ problem.load)
    by_force = y[:3] + np.cross(y[3:], problem.contacts.points_o - problem.contacts.com_o)
    by_moment = np.tile(y[3:], (problem.k, 1))
    if problem.torques is not None:
        limited = np.isfinite(problem.torques.limit)
        assert not np.any(joint_weights[~limited])
        total += float(joint_weights @ problem.torques.bias)
        total -= float(np.abs(joint_weights[limited]) @ problem.torques.limit[limited])
        J = problem.torques.jacobian @ joint_weights
        by_force, by_moment = by_force + J[:, :3], by_moment + J[:, 3:]
    friction = problem.friction
    for i, contact in enumerate(problem.contacts):
        c, spin = contact.rotation_oc.T @ by_force[i], contact.rotation_oc[:, 2] @ by_moment[i]
        mu, torsion = problem.mu[i] / friction.safety, friction.torsion / friction.safety
        if friction.model == "soft":
            pull = np.sqrt((mu * c[0]) ** 2 + (mu * c[1]) ** 2 + (torsion * spin) ** 2)
        elif friction.model == "cone":
            pull = mu * np.hypot(c[0], c[1]) + torsion * abs(spin)
        else:
            pull = mu * max(v @ c[:2] for v in friction.vertices) + torsion * abs(spin)
        per_newton = c[2] - pull
        total += per_newton * (low[i] if per_newton > 0 else high[i])
    return total


def least_along_by_solver(problem: ForceProblem, impact_time: float, direction, joint_weights) -> float:
    """The same as a linear or second-order cone program over all forces within friction and bounds."""
    model = Model(problem, impact_time)
    value = model.net @ direction[: problem.rows]
    if model.torque_share is not None:
        limited = np.isfinite(problem.torques.limit)
        weights = joint_weights[limited] * problem.torques.limit[limited] / model.scale
        value += model.torque_share @ weights - np.abs(weights).sum()
    return solve(cp.Minimize(value), [*model.friction, *model.bounds])[1] * model.scale
