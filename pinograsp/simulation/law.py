"""The contact law, written independently of the planner: normal force by Marhefka and Orin, friction by a spring that
slips (Cundall and Strack).

One part of the hand touches the object at points i, with normals n_i into the object, depths delta_i and velocities v_i
of the hand's surface relative to the object's. The normal force at point i is

    F_i = w_i max(0, (lambda v_i . n_i + K) delta_i^rho).

The weights w_i divide the plan's contacts among the points that the physics engine finds; they sum to the number of the
part's planned contacts. Where one contact is planned they are those of the deepest points: the law of a contact means
its largest depth, however many shallower points an engine finds around it. Where several are, each counts at the points
around its own place on the object, the deepest of them first. The part's tangential spring has a displacement z and a
rotation phi about the normal, and is divided among the points by their shares g_i of the pressure, which sum to the
same number; c is their centre by these. The friction force at point i is kt g_i (z + phi n x (p_i - c)), limited to mu
F_i. Where the limit acts, the point slips, and z and phi are reset to match the remaining forces. The moment of a soft
finger about the normal uses the same phi and is limited to e F.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from scipy.interpolate import PchipInterpolator

from pinograsp.plan import ContactLaw
from pinograsp.spatial import Array, BoolArray, IntArray, cross

_LINES = 2000  # that stand for the curve of a measured law
_GRAZING = 0.1  # share of the part's largest depth, below which a point counts less
_POINTED = 16  # power of that share by which a point counts where one contact is planned, or around its place
_LEAST = 1e-300  # divides what is zero anyway
_SUM = np.ones(3)
_REACH, _LEAST_REACH = 0.125, 1e-4  # of such a place, as share of the distance to the next one; [m]


@dataclass(frozen=True, slots=True)
class Touches:
    """The c points at which the hand overlaps the object at one instant.

    Attributes:
        part: index of the part of the hand (c,).
        geometry: index of the engine's collision geometry (c,).
        point_o: on the object's surface, world (c, 3) [m].
        normal_o: into the object (c, 3).
        depth: (c,) [m].
        velocity_o: of the hand's surface relative to the object's (c, 3) [m/s].
        spin: relative angular velocity about the normal (c,) [rad/s].
    """

    part: IntArray
    geometry: IntArray
    point_o: Array
    normal_o: Array
    depth: Array
    velocity_o: Array
    spin: Array


class Displacements:
    """How points of bodies move from one step to the next, by where the bodies are.

    Speeds times the step are not how far points on an arm that swings have come: what it carries would seem to creep.
    """

    def __init__(self, time_step: float):
        self.dt = time_step
        self.before: tuple[Array, Array] | None = None
        self.now: tuple[Array, Array] | None = None

    def put(self, rotations: Array, positions: Array) -> None:
        """Where m bodies are at a step (m, 3, 3), (m, 3) [m]."""
        self.before, self.now = self.now, (rotations, positions)

    def velocity(self, body: IntArray, other: int, points: Array) -> Array | None:
        """Of points (c, 3) of bodies (c,) against those of another body (c, 3) [m/s]; None at the first step."""
        if self.before is None:
            return None
        return (self._since(body, points) - self._since(np.full(len(body), other), points)) / self.dt

    def _since(self, which: IntArray, points: Array) -> Array:
        """How far points of bodies have come since the step before (c, 3) [m]."""
        assert self.before is not None and self.now is not None
        rotations, positions = self.now
        local = np.einsum("cji,cj->ci", rotations[which], points - positions[which])
        rotations, positions = self.before
        return np.asarray(points - positions[which] - np.einsum("cij,cj->ci", rotations[which], local))


_NO_INDICES, _NO_VALUES, _NO_VECTORS = np.zeros(0, dtype=int), np.zeros(0), np.zeros((0, 3))
NO_TOUCHES = Touches(_NO_INDICES, _NO_INDICES, _NO_VECTORS, _NO_VECTORS, _NO_VALUES, _NO_VECTORS, _NO_VALUES)


@dataclass(frozen=True, slots=True)
class Pressing:
    """Forces on the object at the points of :class:`Touches`.

    Attributes:
        force_o: (c, 3) [N].
        moment_o: about the normals (c, 3) [N m].
        normal: F_n (c,) [N].
    """

    force_o: Array
    moment_o: Array
    normal: Array


class _Places(NamedTuple):
    """Where several contacts of one part are planned: points (q, 3) in the object's frame [m], and half of their
    inverse squared reach (q,) [1/m^2].
    """

    points: Array
    sharpness: Array

    @classmethod
    def of(cls, points: Array) -> _Places:
        apart = np.linalg.norm(points[:, None] - points, axis=2)
        np.fill_diagonal(apart, np.inf)
        return cls(np.array(points), 0.5 / np.maximum(_REACH * apart.min(axis=1), _LEAST_REACH) ** 2)

    def weights(self, points: Array, depth: Array) -> Array:
        """Weights (c,), which sum to one, of points (c, 3) in the object's frame with relative depths (c,)."""
        away = points - self.points[:, None]
        off = self.sharpness[:, None] * (away * away).sum(axis=2)
        near = np.exp(off.min(axis=1)[:, None] - off) * depth**_POINTED
        found: Array = (near / near.sum(axis=1)[:, None]).mean(axis=0)
        return found


class ContactForces:
    """Normal and tangential forces, the state of the tangential springs, and the energies.

    Attributes:
        elastic: energy held by the normal and tangential springs [J].
        damped: energy lost in damping [J].
        slipped: energy lost in slip [J].
        normal_work: integral of F_n over the depth [J].
        slip: path of slip by part (p,) [m].
    """

    def __init__(
        self,
        law: ContactLaw,
        mu: Array,
        torsion: float,
        tangential: float,
        counts: IntArray,
        places: Sequence[Array] = (),
    ):
        """The forces of p parts.

        Args:
            law: the contact law, by its numbers.
            mu: friction coefficients (p,).
            torsion: largest moment about a normal per newton [m].
            tangential: stiffness kt of the tangential springs [N/m].
            counts: planned contacts of each part (p,).
            places: of these on the object, in its frame (counts[i], 3) [m]; none: all points of a part count alike.
        """
        self.K, self.lam, self.rho = law.stiffness, law.damping, law.exponent
        self.table = _refine(law.table) if len(law.table) else None
        self.mu, self.torsion, self.kt = np.asarray(mu, dtype=float), torsion, tangential
        self.single: BoolArray = np.asarray(counts) == 1
        self.counts: Array = np.maximum(np.asarray(counts, dtype=float), 1.0)
        self.places = {i: _Places.of(own) for i, own in enumerate(places) if len(own) > 1}
        p = len(self.counts)
        self.parts = np.arange(p)[:, None]
        self.shearing, self.twisting = tangential * self.counts, tangential * torsion**2 * self.counts
        self.z, self.phi = np.zeros((p, 3)), np.zeros(p)
        self.elastic = self.damped = self.slipped = self.normal_work = 0.0
        self.slip = np.zeros(p)
        self._stored = 0.0  # energy in the tangential springs
        self._turned: Array | None = None  # the object's rotation at the last step
        self._before: Array = np.zeros((p, 6))  # forces at the last step, see _account

    def drop_shallower(self, touches: Touches) -> Touches:
        """Keep only the deepest geometry of parts with one planned contact: the others would add forces."""
        part = touches.part
        if len(set(touches.geometry.tolist())) == len(set(part.tolist())) or not self.single[part].any():
            return touches
        keep = ~self.single[part]
        for one in set(part[~keep].tolist()):
            own = np.flatnonzero(part == one)
            keep[own] = touches.geometry[own] == touches.geometry[own[touches.depth[own].argmax()]]
        return Touches(*(getattr(touches, field.name)[keep] for field in fields(Touches)))

    def press(self, touches: Touches, dt: float, pose: Array | None = None) -> Pressing:
        """Forces after the springs have followed the surfaces for ``dt`` [s]; ``pose`` (4, 4) of the object, where the
        places of contacts are known.
        """
        if pose is not None:
            self._turn_along(pose[:3, :3])
        if not touches.part.size:
            self._release()
            return Pressing(_NO_VECTORS, _NO_VECTORS, _NO_VALUES)
        part, n, depth = touches.part, touches.normal_o, touches.depth
        of = (self.parts == part).astype(float)  # (p, c): which points belong to which part
        weights, counts = self._weigh(touches, pose, of), self.counts.take(part)
        share = counts * weights

        rate = dot(touches.velocity_o, n)
        raised = depth**self.rho if self.table is None else _interpolate(self.table, 1, depth)
        pressed = share * raised * self.K
        normal = np.maximum(share * raised * self.lam * rate + pressed, 0.0)

        # The springs of parts that touch follow the surfaces. A point's share of them is that of its pressure: they
        # would creep if those that hardly press slipped again and again, while others can hold.
        pressure = weights * raised
        grip = pressure / np.maximum((of @ pressure).take(part), _LEAST)
        gripping, sliding = self.kt * counts * grip, touches.velocity_o - rate[:, None] * n
        means = (of * grip) @ _put_together(rate, rate, sliding, touches.spin, n, touches.point_o)
        speeds, axis, centre = means[:, :6], means[:, 6:9], means[:, 9:]
        axis /= np.sqrt(np.maximum(dot(axis, axis), _LEAST))[:, None]
        z = self.z + dt * speeds[:, 2:5]
        z -= dot(z, axis)[:, None] * axis
        phi = self.phi + dt * speeds[:, 5]
        arm = cross(axis.take(part, 0), touches.point_o - centre.take(part, 0))
        stretched = z.take(part, 0) + phi.take(part)[:, None] * arm
        stretched -= dot(stretched, n)[:, None] * n
        tangential = gripping[:, None] * stretched
        length = np.sqrt(dot(tangential, tangential))
        ratio = np.minimum(1.0, self.mu.take(part) * normal / np.maximum(length, _LEAST))
        tangential *= ratio[:, None]
        sums = of @ _put_together(normal, normal - pressed, tangential, dot(tangential, arm), gripping * dot(arm, arm))
        forces, most = sums[:, :6], self.torsion * sums[:, 0]
        twist = np.minimum(np.maximum(self.twisting * phi, -most), most)
        forces[:, 5] += twist

        # The springs' new state, by the forces that friction allows; the difference has slipped. Parts that do not
        # touch have no spring.
        left, stiff = forces[:, 2:5] / self.shearing[:, None], sums[:, 6] + self.twisting
        turned = np.divide(forces[:, 5], stiff, out=np.zeros(len(stiff)), where=stiff > 1e-12)
        if ratio.min() < 1.0:
            gone = z - left
            self.slip += np.sqrt(dot(gone, gone)) * (of @ (ratio < 1.0) > 0.0)
        self.z, self.phi = left, turned

        springs = 0.5 * float(self.shearing @ dot(left, left) + stiff @ (turned * turned))
        self._account(forces, speeds, springs, dt)
        self.elastic = self._compress(pressed, share, depth) + springs
        moment = (twist.take(part) * normal / np.maximum(sums[:, 0].take(part), _LEAST))[:, None] * n
        return Pressing(normal[:, None] * n + tangential, moment, normal)

    def _weigh(self, touches: Touches, pose: Array | None, of: Array) -> Array:
        """Weights (c,) of the points, see :meth:`press`; those of a part sum to one."""
        # A grazing point has little weight, so that the forces at the others do not jump when it appears or vanishes.
        part = touches.part
        relative = touches.depth / (of * touches.depth).max(axis=1).take(part)
        near = np.where(self.single.take(part), relative**_POINTED, np.minimum(1.0, relative / _GRAZING))
        weights: Array = near / (of @ near).take(part)
        if pose is not None and self.places:
            points = (touches.point_o - pose[:3, 3]) @ pose[:3, :3]
            for one, places in self.places.items():
                if (mine := (part == one).nonzero()[0]).size > 1:
                    weights[mine] = places.weights(points[mine], relative[mine])
        return weights

    def _compress(self, pressed: Array, share: Array, depth: Array) -> float:
        """Energy in the normal springs of points (c,) [J]."""
        if self.table is None:
            return float(pressed @ depth) / (self.rho + 1)
        return self.K * float(share @ _interpolate(self.table, 2, depth))

    def _turn_along(self, rotation: Array) -> None:
        """Turn the tangential springs with the object: a hand that turns takes them along."""
        if self._turned is not None:
            self.z = self.z @ (self._turned @ rotation.T)
        self._turned = rotation.copy()

    def _release(self) -> None:
        """Relax all springs; the energy in the tangential ones counts as slipped."""
        if self.elastic:
            self.z, self.phi, self._before = 0.0 * self.z, 0.0 * self.phi, 0.0 * self._before
            self.slipped += self._stored
            self.elastic = self._stored = 0.0

    def _account(self, forces: Array, speeds: Array, springs: float, dt: float) -> None:
        """Add the work of a step: the mean of the forces at its two ends, times the distance at these speeds.

        Args:
            forces: of the parts (p, 6): F_n, the share of it that comes from lambda, friction, and moment about the
                normal [N, N m].
            speeds: of the parts, against the object, alike: of the depth (twice), tangential, and about the normal.
            springs: energy in the tangential springs now [J].
            dt: of the step [s].
        """
        work = 0.5 * dt * ((forces + self._before) * speeds).sum(axis=0)
        pressed, damped, *rubbed = work.tolist()
        self.normal_work += pressed
        self.damped += damped
        self.slipped += sum(rubbed) - (springs - self._stored)
        self._before, self._stored = forces, springs


def _refine(table: Array) -> Array:
    """Depths [m], forces [N] and stored energies [J] (3, n) of a table, close enough to each other for straight lines.

    Monotone cubics join its points (Fritsch and Carlson); beyond the last one they go on straight.
    """
    curve = PchipInterpolator(table[:, 0], table[:, 1])
    at = np.unique(np.concatenate([np.linspace(0.0, table[-1, 0], _LINES), table[:, 0]]))
    far = np.array([table[-1, 0], 2 * table[-1, 0]])
    last = curve(far[0]) + float(curve.derivative()(far[0])) * (far - far[0])
    depths, forces = np.append(at, far[1]), np.append(curve(at), last[1])
    steps = np.diff(depths) * (forces[1:] + forces[:-1]) / 2
    return np.array([depths, forces, np.append(0.0, np.cumsum(steps))])


def _interpolate(table: Array, row: int, depth: Array) -> Array:
    return np.asarray(np.interp(depth, table[0], table[row]))


def dot(a: Array, b: Array) -> Array:
    """Scalar products of rows (c, 3)."""
    products: Array = (a * b) @ _SUM
    return products


def _put_together(*columns: Array) -> Array:
    """Columns (c,) and (c, 3) side by side."""
    return np.concatenate([one if one.ndim == 2 else one[:, None] for one in columns], axis=1)
