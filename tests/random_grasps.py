"""Seeded random grasps, and an oracle for them: the force problem written again in CVXPY, in newtons, from its definition.

The oracle shares nothing with the package but the inputs (contact points and frames, and the documented values of
``ForceProblem``): contact forces are world vectors, polygons are combinations of their vertices, the integrals of the
grasp energy are summed numerically. ECOS solves it, which the package does not use.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

import cvxpy as cp
import numpy as np
from scipy.integrate import cumulative_simpson, simpson

from pinograsp.contacts import Compliance, Contact, ContactSet, DecelerationShape, Friction
from pinograsp.forces import ForceProblem, TorqueLimits
from pinograsp.spatial import rotation_rpy, tangent_frame

FAMILIES = ("pyramid", "cone", "soft")
DEGENERATE = (
    "no friction", "some without friction", "duplicates", "collinear", "parallel normals", "zero load", "pinch",
)  # fmt: skip
OBJECTIVES = ("impulse", "work", "least_squares", "peak", "motor_heat")


@dataclass(frozen=True)
class Grasp:
    """One random case. ``degenerate``: what is special about it, "" as a rule. ``factor``: load / largest load, or None."""

    seed: int
    problem: ForceProblem
    impact_time: float
    objective: str | dict[str, float]
    body: str
    degenerate: str
    factor: float | None


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

    ``load``: "plain", "limit" (0.3 to 3 times the largest that can be held) or "edge" (that one but for 1e-9 to 1e-4).
    """
    rng = np.random.default_rng([2718, seed])
    drawn = rng.choice(FAMILIES), int(rng.integers(3, 21)), rng.random() < 0.5, rng.random() < 0.12
    family, k, torques = family or str(drawn[0]), k or drawn[1], drawn[2] if torques is None else torques
    if degenerate is None:
        degenerate = str(rng.choice(DEGENERATE)) if drawn[3] else ""
    body, points, normals, com, size = _on_a_body(rng, k, degenerate)
    gravity = -9.81 * (np.array([0.0, 0, 1]) if rng.random() < 0.7 else _unit(rng))
    contacts = ContactSet(
        contacts=tuple(
            Contact(
                finger=f"finger {i + 1}",
                link="",
                point_o=point,
                rotation_oc=tangent_frame(normal, gravity),
                length=None,
                distance=0.0,
            )
            for i, (point, normal) in enumerate(zip(points, normals))
        ),
        com_o=com,
    )
    mu = np.full(k, rng.uniform(0.3, 0.9)) if rng.random() < 0.5 else rng.uniform(0.3, 0.9, k)
    if degenerate == "no friction":
        mu = np.zeros(k)
    elif degenerate == "some without friction":
        mu = np.where(rng.random(k) < 0.5, 0.0, mu)
    wrench = np.zeros(6)
    if degenerate != "zero load":
        weight = rng.uniform(0.5, 3) if rng.random() < 0.7 else rng.uniform(3, 20)
        wrench[:3] = weight * (gravity / 9.81 if rng.random() < 0.6 else _unit(rng))
        if rng.random() < 0.6:
            wrench[3:] = weight * size * rng.uniform(0, 0.6) * _unit(rng)
    exponent = float(rng.choice([1.5, 1.5, 1.5, 1.0, 2.0]))
    problem = ForceProblem(
        contacts=contacts,
        load=wrench,
        gravity_o=gravity,
        mu=mu,
        compliance=Compliance(
            stiffness={1.0: 4e3, 1.5: 5e4, 2.0: 7e5}[exponent] * rng.choice([1.0, rng.uniform(0.5, 2)]),
            damping=float(rng.choice([100.0, 100.0, 0.0, 400.0])),
            exponent=exponent,
        ),
        balance=str(rng.choice(["wrench", "wrench", "force"])),
        measure=str(rng.choice(["impulse", "work"])),
        friction=_friction(rng, family),
        shape=_shape(rng),
    )
    impact_time = float(rng.uniform(0.80, 0.95))
    low, high = normal_force_range(problem, impact_time)
    if rng.random() < 0.3:
        caps = np.maximum(rng.uniform(0.05, 1.2, k) * high, 1.01 * low)
        if rng.random() < 0.03:
            caps[rng.integers(k)] = 0.9 * low[0]  # excluded by the least normal force
        problem = replace(problem, max_normal_force=caps if rng.random() < 0.5 else float(caps.max()))
    if torques:
        problem = replace(problem, torques=_torque_limits(rng, k, size, float(high[0])))
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


def _unit(rng, n=3) -> np.ndarray:
    v = rng.normal(size=n)
    return v / np.linalg.norm(v)


def _on_a_body(rng, k, degenerate):
    """Body, points (k, 3), inward normals (k, 3), centre of mass, and a size [m]; half of them with opposed contacts."""
    body = str(rng.choice(["cylinder", "sphere", "box"]))
    opposed = rng.random() < 0.5
    if degenerate in ("collinear", "parallel normals"):
        body = "box"
    if degenerate == "pinch":
        body = "sphere"
    if body == "sphere":
        size = rng.uniform(0.015, 0.06)
        outward = np.array([_unit(rng) for _ in range(k)])
        if opposed or degenerate == "pinch":
            spread = 0.0 if degenerate == "pinch" else 0.4
            axis, signs = _unit(rng), np.where(np.arange(k) % 2, -1.0, 1.0)
            outward = signs[:, None] * axis + spread * outward
            outward /= np.linalg.norm(outward, axis=1)[:, None]
        points = size * outward
    elif body == "cylinder":
        size, height = rng.uniform(0.01, 0.05), rng.uniform(0.05, 0.2)
        a = rng.uniform(0, 2 * np.pi, k)
        if opposed:
            a = a[0] + np.pi * (np.arange(k) % 2) + rng.uniform(-0.5, 0.5, k)
        outward = np.column_stack([np.cos(a), np.sin(a), np.zeros(k)])
        points = size * outward + np.outer(rng.uniform(-0.5, 0.5, k) * min(height, 4 * size), [0, 0, 1])
        caps = rng.random(k) < (0.0 if opposed else 0.2)
        outward[caps] = np.outer(rng.choice([-1.0, 1.0], caps.sum()), [0, 0, 1])
        points[caps] = points[caps] * [0.5, 0.5, 0] + outward[caps] * height / 2
    else:
        half = rng.uniform(0.01, 0.05, 3)
        size = float(half.mean())
        axis = rng.integers(0, 3, k)
        sign = rng.choice([-1.0, 1.0], k)
        if opposed or degenerate in ("collinear", "parallel normals"):
            axis[:], sign = axis[0], np.where(np.arange(k) % 2, -1.0, 1.0)
        if degenerate == "parallel normals" and rng.random() < 0.5:
            sign[:] = 1.0
        outward = np.zeros((k, 3))
        outward[np.arange(k), axis] = sign
        points = rng.uniform(-0.9, 0.9, (k, 3)) * half
        if degenerate == "collinear":
            # All contacts on one line through two opposite faces or along an edge of one face.
            points = np.outer(rng.uniform(-0.9, 0.9, k), half * _unit(rng))
            if rng.random() < 0.5:
                points[:] = points[0]
        points[np.arange(k), axis] = sign * half[axis]
        if degenerate == "collinear" and rng.random() < 0.5:
            points = points[0] + np.outer(rng.uniform(-1, 1, k), half * np.array([0, 0, 1.0]))
            outward[:] = outward[0]
            outward[1::2] *= -1
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
        torsion = rng.uniform(1e-3, 1e-2)
    edges = int(rng.choice([4, 4, 8, 16])) if family == "pyramid" else 4
    return Friction(model=family, edges=edges, torsion=torsion, safety=safety)


def _shape(rng) -> DecelerationShape:
    return DecelerationShape.constant() if rng.random() < 0.7 else DecelerationShape.linear(*rng.uniform(0.1, 1, 2))


def _torque_limits(rng, k, size, force) -> TorqueLimits:
    """Fingers of three to four joints that share the contacts out, or a random Jacobian; limits of the order of use."""
    n = int(rng.integers(3, 5)) * int(rng.integers(1, min(k, 5) + 1))
    jacobian = np.concatenate([rng.uniform(-0.08, 0.08, (k, 3, n)), rng.normal(size=(k, 3, n))], axis=1)
    if rng.random() < 0.7:
        per = 3 if n % 3 == 0 else 4
        owner = rng.integers(0, n // per, k)
        jacobian *= (np.arange(n) // per == owner[:, None])[:, None, :]
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
    """Of alpha over u: impact speed / (A tau), depth / (A tau^2), and the means of sigma^rho and sigma^rho sigma'^2."""
    w = np.linspace(0, 1, 2001)  # u = w^2 takes the root out of sigma^rho at u = 0
    u, du = w**2, 2 * w
    lost = cumulative_simpson(shape.acceleration(u) * du, x=w, initial=0)
    rate = lost[-1] - lost
    depth = cumulative_simpson(rate * du, x=w, initial=0)
    m = depth[-1]
    sigma, slope = np.maximum(depth / m, 0), rate / m
    return lost[-1], m, simpson(sigma**rho * du, x=w), simpson(sigma**rho * slope**2 * du, x=w)


def normal_force_range(problem: ForceProblem, impact_time: float) -> tuple[np.ndarray, np.ndarray]:
    """Least and largest F_n (k,) [N]: Eqs. (13) for a deceleration of peak A, and the caps."""
    tau = problem.final_time - impact_time
    v, m, _, _ = _integrals(problem.shape, problem.compliance.exponent)
    A_low, A_high = problem.acceleration_range
    A_high = min(A_high, problem.max_speed / (v * tau), problem.max_depth / (m * tau**2))
    low, high = (problem.compliance.stiffness * (m * A * tau**2) ** problem.compliance.exponent for A in (A_low, A_high))
    caps = np.inf if problem.max_normal_force is None else problem.max_normal_force
    return np.full(problem.k, low), np.minimum(np.full(problem.k, high), caps)


def force_scale(problem: ForceProblem, impact_time: float) -> float:
    """A force [N] of the order of the answer."""
    load = np.linalg.norm([*problem.load[:3], *problem.load[3:] / problem.moment_length][: problem.rows])
    return float(load) or float(normal_force_range(problem, impact_time)[0].max())


class Model:
    """The constraints of a force problem in CVXPY; forces in units of ``scale`` [N], in contact axes."""

    def __init__(self, problem: ForceProblem, impact_time: float, *, load=1.0, bounded=True, scale=None):
        k, friction = problem.k, problem.friction
        self.problem, self.impact_time = problem, impact_time
        self.scale = S = scale or force_scale(problem, impact_time)
        self.low, self.high = normal_force_range(problem, impact_time)
        self.F, self.t = cp.Variable(k), cp.Variable((k, 2))
        self.m = cp.Variable(k) if friction.torsion > 0 else None  # torsional moments over the largest: m / (S torsion)
        mu, torsion = problem.mu / friction.safety, friction.torsion / friction.safety
        self.friction = []
        if friction.model == "pyramid":
            share = cp.Variable((k, friction.edges), nonneg=True)  # of the polygon's corners
            self.friction += [
                self.t == cp.multiply(np.tile(mu[:, None], (1, 2)), share @ friction.vertices),
                cp.sum(share, axis=1) == self.F,
            ]
        elif friction.model == "cone":
            self.friction.append(cp.SOC(cp.multiply(mu, self.F), self.t, axis=1))
        else:
            u = cp.Variable((k, 2))  # t = mu u, which does without dividing by mu = 0
            self.friction += [
                self.t == cp.multiply(np.tile(mu[:, None], (1, 2)), u),
                cp.SOC(self.F, cp.hstack([u, self.m[:, None] * friction.safety]), axis=1),
            ]
        if self.m is not None and friction.model != "soft":
            self.friction.append(cp.abs(self.m) <= self.F / friction.safety)
        self.bounds = [self.F >= self.low / S] + ([self.F <= self.high / S] if bounded else [])
        # Net wrench over S, moments over S and the moment length.
        R, points = problem.contacts.rotations_oc, problem.contacts.points_o - problem.contacts.com_o
        world = cp.multiply(self.F[:, None], R[:, :, 2])
        world = world + cp.multiply(self.t[:, 0:1], R[:, :, 0]) + cp.multiply(self.t[:, 1:2], R[:, :, 1])
        x, y, z = (world[:, i] for i in range(3))
        px, py, pz = points.T / problem.moment_length
        moments = [
            cp.multiply(py, z) - cp.multiply(pz, y),
            cp.multiply(pz, x) - cp.multiply(px, z),
            cp.multiply(px, y) - cp.multiply(py, x),
        ]
        if self.m is not None:
            spin = self.m * (friction.torsion / problem.moment_length)
            moments = [moment + cp.multiply(spin, R[:, i, 2]) for i, moment in enumerate(moments)]
        force = [cp.sum(x), cp.sum(y), cp.sum(z)]
        moment = [cp.sum(m) for m in moments]
        given = problem.load / S
        given[3:] /= problem.moment_length
        self.net = cp.hstack([*force, *moment])[: problem.rows] + load * given[: problem.rows]
        self.torque, self.torque_limits, self.torque_share = None, [], None
        if problem.torques is not None:
            J, limit = problem.torques.jacobian, problem.torques.limit
            tau = sum(J[:, i].T @ world[:, i] for i in range(3))
            if self.m is not None:
                tau = tau + np.einsum("kxn,kx->nk", J[:, 3:], R[:, :, 2]) @ (self.m * friction.torsion)
            self.torque = tau * S + problem.torques.bias  # [N m]
            finite = np.isfinite(limit)
            if finite.any():
                self.torque_share = cp.multiply(self.torque[finite], 1 / limit[finite])
                self.torque_limits = [self.torque_share <= 1, self.torque_share >= -1]

    @property
    def constraints(self) -> list:
        return [*self.friction, *self.bounds, *self.torque_limits, self.net == 0]

    def cost(self, objective) -> tuple[cp.Expression, float]:
        """The objective over a unit, and the unit."""
        p, S = self.problem, self.scale
        weights = {objective: 1.0} if isinstance(objective, str) else dict(objective)
        tau, law = p.final_time - self.impact_time, p.compliance
        K, damping, rho = law.stiffness, law.damping, law.exponent
        _, _, mean, damped = _integrals(p.shape, rho)
        parts: list[tuple[float, cp.Expression]] = []
        # delta = (F / K)^(1/rho); (rho + 1) times the integral of (damping ddelta + K) delta^rho over time or depth.
        power = {n: (S / K) ** ((rho + n) / rho) for n in (1, 2)}
        exact = Fraction(rho).limit_denominator(100)
        raised = {n: lambda n=n: cp.sum(cp.power(self.F, (exact + n) / exact)) for n in (1, 2)}
        if weights.get("impulse"):
            parts.append((weights["impulse"] * (rho + 1) * mean * tau * S, cp.sum(self.F)))
            if damping:
                parts.append((weights["impulse"] * damping * power[1], raised[1]()))
        if weights.get("work"):
            parts.append((weights["work"] * K * power[1], raised[1]()))
            if damping:
                parts.append((weights["work"] * (rho + 1) * damped * damping / tau * power[2], raised[2]()))
        if weights.get("least_squares"):
            parts.append((weights["least_squares"] * S**2, cp.sum_squares(self.t) + cp.sum_squares(self.F)))
            if self.m is not None:
                length = p.friction.torsion / p.moment_length
                parts.append((weights["least_squares"] * S**2 * length**2, cp.sum_squares(self.m)))
        if weights.get("peak"):
            parts.append((weights["peak"] * S, cp.max(self.F)))
        if weights.get("motor_heat"):
            size = float(np.linalg.norm(p.torques.jacobian[:, :3], axis=(0, 1)).max() * S) or 1.0
            parts.append((weights["motor_heat"] * size**2, cp.sum_squares(self.torque / size)))
        unit = max(size for size, _ in parts)
        return sum((size / unit) * term for size, term in parts), unit


# In this order until one of them calls the problem solved; ECOS is not among the package's solvers.
ATTEMPTS = [
    *((cp.ECOS, {"abstol": tol, "reltol": tol, "feastol": tol, "max_iters": 200}) for tol in (1e-10, 1e-9)),
    *((cp.CLARABEL, {"tol_gap_abs": tol, "tol_gap_rel": tol, "tol_feas": tol}) for tol in (1e-10, 1e-9)),
    (cp.SCS, {"eps_abs": 1e-10, "eps_rel": 1e-10, "max_iters": 200_000}),
]


def solve(objective, constraints) -> tuple[str, float, str]:
    """Status ("optimal", "infeasible" or "?"), value, and who said so: ECOS, or where it stops short another solver."""
    task = cp.Problem(objective, constraints)
    for solver, options in ATTEMPTS:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                task.solve(solver=solver, **options)
        except (cp.SolverError, ValueError, ArithmeticError):
            continue
        if task.status in (cp.OPTIMAL, cp.INFEASIBLE):
            return task.status, float(task.value), solver
    return "?", np.nan, ""


def optimum(grasp: Grasp) -> tuple[str, float, str]:
    """Status and least objective of a grasp, and the solver that gave them."""
    model = Model(grasp.problem, grasp.impact_time)
    if np.any(model.low > model.high):
        return "infeasible", np.inf, "bounds"
    cost, unit = model.cost(grasp.objective)
    status, value, solver = solve(cp.Minimize(cost), model.constraints)
    return status, value * unit, solver


def load_factor(problem: ForceProblem, impact_time: float, largest=True) -> float | None:
    """Largest (or least) multiple of the load that can be held; None where there is none, or no finite one."""
    s = cp.Variable(nonneg=True)
    model = Model(problem, impact_time, load=s)
    if np.any(model.low > model.high):
        return None
    status, value, _ = solve(cp.Maximize(s) if largest else cp.Minimize(s), model.constraints)
    return value if status == "optimal" else None


def least_residual(problem: ForceProblem, impact_time: float) -> float:
    """Least norm of net wrench and torque excess [N] that admissible forces leave, relative to the force scale."""
    model = Model(problem, impact_time)
    parts, limits = [model.net], []
    if model.torque_share is not None:
        parts.append(cp.Variable(model.torque_share.shape, nonneg=True))
        limits = [cp.abs(model.torque_share) <= 1 + parts[1]]
    return solve(cp.Minimize(cp.norm(cp.hstack(parts))), [*model.friction, *model.bounds, *limits])[1]


# -- checks of answers, in newtons -------------------------------------------------------------------------------------


def violations(problem: ForceProblem, impact_time: float, forces_c, torsion) -> dict[str, float]:
    """How far forces (k, 3) [N] and torsional moments (k,) [N m] miss each constraint, relative to the load."""
    size = force_scale(problem, impact_time)
    low, high = normal_force_range(problem, impact_time)
    net, tau = problem.load.copy(), None
    if problem.torques is not None:
        tau = problem.torques.bias.copy()
    for i, contact in enumerate(problem.contacts):
        h = contact.rotation_oc @ forces_c[i]
        moment = torsion[i] * contact.rotation_oc[:, 2]
        net[:3] += h
        net[3:] += np.cross(contact.point_o - problem.contacts.com_o, h) + moment
        if tau is not None:
            tau += problem.torques.jacobian[i].T @ np.concatenate([h, moment])
    F, t = forces_c[:, 2], np.hypot(forces_c[:, 0], forces_c[:, 1])
    friction, limit = problem.friction, problem.mu / problem.friction.safety
    spin = np.abs(torsion) * problem.friction.safety / problem.friction.torsion if friction.torsion else np.abs(torsion)
    if friction.model == "pyramid":
        # The distance to a side of the polygon grows with the angle to its middle; half a side spans pi / edges.
        corner = np.arctan2(*friction.vertices[0][::-1])
        angle = np.arctan2(forces_c[:, 1], forces_c[:, 0]) - corner
        step = 2 * np.pi / friction.edges
        t = t * np.cos(angle % step - step / 2) / np.cos(step / 2)
    if friction.model == "soft":
        # In newtons of tangential force: |(t / mu, m / torsion)| <= F, times mu.
        scaled = np.where(limit > 0, t / np.where(limit > 0, limit, 1), t / 1e-9)
        beyond = float((np.hypot(scaled, spin) - F).max())
    else:
        beyond = float(max((t - limit * F).max(), (spin - F).max() if friction.torsion else 0))
    return {
        "force": float(np.linalg.norm(net[:3]) / size),
        "moment": float(np.linalg.norm(net[3:]) / problem.moment_length / size) if problem.rows == 6 else 0.0,
        "friction": beyond / size,
        "bounds": float(max((low - F).max(), (F - high).max()) / size),
        "torque": float((np.abs(tau) / problem.torques.limit - 1).max()) if tau is not None else 0.0,
        "no torsion": 0.0 if friction.torsion else float(np.abs(torsion).max()),
    }


def objective_value(problem: ForceProblem, impact_time: float, objective, forces_c, torsion) -> float:
    """The objective at given forces, from its definition."""
    weights = {objective: 1.0} if isinstance(objective, str) else dict(objective)
    law, tau = problem.compliance, problem.final_time - impact_time
    rho = law.exponent
    depth = (forces_c[:, 2] / law.stiffness) ** (1 / rho)
    _, _, mean, damped = _integrals(problem.shape, rho)
    joints = 0.0
    if problem.torques is not None:
        joints = problem.torques.bias.copy()
        for i, contact in enumerate(problem.contacts):
            wrench = [*(contact.rotation_oc @ forces_c[i]), *(torsion[i] * contact.rotation_oc[:, 2])]
            joints += problem.torques.jacobian[i].T @ wrench
    values = {
        "impulse": (law.damping * depth ** (rho + 1) + (rho + 1) * mean * tau * law.stiffness * depth**rho).sum(),
        "work": (law.stiffness * depth ** (rho + 1) + (rho + 1) * damped * law.damping / tau * depth ** (rho + 2)).sum(),
        "least_squares": (forces_c**2).sum() + ((torsion / problem.moment_length) ** 2).sum(),
        "peak": forces_c[:, 2].max(),
        "motor_heat": (joints * joints).sum() if problem.torques is not None else 0.0,
    }
    return float(sum(weight * values[name] for name, weight in weights.items()))


def least_along(problem: ForceProblem, impact_time: float, direction, joint_weights) -> float:
    """Least value [N] of direction . net wrench + weighted torque beyond the limits over friction and bounds, closed form.

    Whatever balances the load makes it 0 or less: positive, it proves that nothing does.
    """
    low, high = normal_force_range(problem, impact_time)
    y = np.asarray(direction, dtype=float).copy()
    y[3:] /= problem.moment_length
    total = float(y @ problem.load)
    by_force, by_moment = np.tile(y[:3], (problem.k, 1)), np.tile(y[3:], (problem.k, 1))
    by_force = by_force + np.cross(y[3:], problem.contacts.points_o - problem.contacts.com_o)
    if len(joint_weights):
        finite = np.isfinite(problem.torques.limit)
        w = np.asarray(joint_weights) * force_scale(problem, impact_time)
        per = w / problem.torques.limit[finite]
        total += float(per @ problem.torques.bias[finite] - np.abs(w).sum())
        J = problem.torques.jacobian[:, :, finite] @ per
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
