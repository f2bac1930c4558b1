"""The contact law, written down again: normal force by Marhefka and Orin, friction by a spring that slips (Cundall and
Strack).

For one part of the hand on the object, at points i with normals n_i into the object, depths delta_i and velocities v_i
of the hand's relative to the object's surface,

    F_i = w_i max(0, (lambda v_i . n_i + K) delta_i^rho),

where the weights w_i share among the points that a physics engine finds what the plan counts as one contact or more.
The part's tangential spring has a displacement z and a turn phi about the normal; each point is held by kt w_i (z + phi
n x (p_i - c)), no more than mu F_i, and what is beyond has slipped: z and phi are those of the forces that are left. A
soft finger's moment about the normal has the same turn for its spring, and the limit e F.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np

_GRAZING = 0.1  # of the depth of the part's deepest point


@dataclass(frozen=True, slots=True)
class Touches:
    """Where parts of the hand are in the object at an instant, c points.

    Attributes:
        part: which part of the hand (c,).
        geometry: which of its bodies (c,).
        point_o: on the object's surface, world (c, 3) [m].
        normal_o: into the object (c, 3).
        depth: (c,) [m].
        velocity_o: of the hand's surface relative to the object's (c, 3) [m/s].
        spin: relative angular velocity about the normal (c,) [rad/s].
    """

    part: np.ndarray
    geometry: np.ndarray
    point_o: np.ndarray
    normal_o: np.ndarray
    depth: np.ndarray
    velocity_o: np.ndarray
    spin: np.ndarray


_NOBODY, _NOTHING, _NOWHERE = np.zeros(0, dtype=int), np.zeros(0), np.zeros((0, 3))
NO_TOUCHES = Touches(_NOBODY, _NOBODY, _NOWHERE, _NOWHERE, _NOTHING, _NOWHERE, _NOTHING)


@dataclass(frozen=True, slots=True)
class Pressing:
    """Forces on the object at the points of :class:`Touches`.

    Attributes:
        force_o: (c, 3) [N].
        moment_o: about the normals (c, 3) [N m].
        normal: F_n (c,) [N].
    """

    force_o: np.ndarray
    moment_o: np.ndarray
    normal: np.ndarray


class ContactLaw:
    """Normal and tangential forces, with the tangential springs' state and the energy they hold or have lost.

    Attributes:
        elastic: energy held by the normal and tangential springs [J]. damped: lost in lambda [J]. slipped: lost in
            slip [J].
        normal_work: integral of F_n over the depth [J]. slip: path of slip by part (p,) [m].
    """

    def __init__(self, stiffness, damping, exponent, mu, torsion, tangential, counts):
        """K [N/m^rho], lambda, rho; mu (p,), torsion [m], kt [N/m] and the number of planned contacts (p,), by part."""
        self.K, self.lam, self.rho = stiffness, damping, exponent
        self.mu, self.torsion, self.kt = np.asarray(mu, dtype=float), torsion, tangential
        self.single = np.asarray(counts) == 1
        self.counts = np.maximum(np.asarray(counts, dtype=float), 1.0)
        p = len(self.counts)
        self.z, self.phi = np.zeros((p, 3)), np.zeros(p)
        self.elastic = self.damped = self.slipped = self.normal_work = 0.0
        self.slip = np.zeros(p)
        self._held = 0.0  # in the tangential springs
        # At the last step, by part: F_n, its damping part, tangential forces, moments about the normal.
        self._before = np.zeros(p), np.zeros(p), np.zeros((p, 3)), np.zeros(p)

    def counted(self, touches: Touches) -> Touches:
        """Of parts with one planned contact the points of their deepest body alone: others would press beside it."""
        part = touches.part
        if len(set(touches.geometry.tolist())) == len(set(part.tolist())) or not self.single[part].any():
            return touches
        keep = ~self.single[part]
        for one in set(part[~keep].tolist()):
            own = np.flatnonzero(part == one)
            keep[own] = touches.geometry[own] == touches.geometry[own[touches.depth[own].argmax()]]
        return Touches(*(getattr(touches, field.name)[keep] for field in fields(Touches)))

    def press(self, touches: Touches, dt: float) -> Pressing:
        """Forces now, the springs having followed the surfaces for ``dt`` [s]."""
        if not touches.part.size:
            if self.elastic:
                self.z[:], self.phi[:] = 0.0, 0.0
                for forces in self._before:
                    forces[:] = 0.0
                self.slipped += self._held
                self.elastic = self._held = 0.0
            none = np.zeros((0, 3))
            return Pressing(none, none, np.zeros(0))
        part, n, depth = touches.part, touches.normal_o, touches.depth
        here = np.flatnonzero(np.bincount(part, minlength=len(self.counts)))
        of = part == here[:, None]  # (h, c): which points are a part's
        which = of.argmax(axis=0)
        counts = self.counts[here]
        # A point that only grazes counts little, so that the forces of the others do not jump when it comes and goes.
        deepest = np.where(of, depth, 0.0).max(axis=1)
        counted = np.minimum(1.0, depth / (_GRAZING * deepest[which]))
        weights = of * (counted * (1.0 / (of @ counted))[which])  # (h, c): they add up to one for each part
        share = counts[which] * weights.sum(axis=0)

        rate = _dot(touches.velocity_o, n)
        raised = depth**self.rho
        normal = share * np.maximum((self.lam * rate + self.K) * raised, 0.0)

        # The springs of parts that touch follow; of those that do not, they are gone.
        axis = weights @ n
        axis /= np.sqrt(_dot(axis, axis))[:, None]
        across, spin = weights @ (touches.velocity_o - rate[:, None] * n), weights @ touches.spin
        z = self.z[here] + dt * across
        z -= _dot(z, axis)[:, None] * axis
        phi = self.phi[here] + dt * spin
        arm = cross(axis[which], touches.point_o - (weights @ touches.point_o)[which])
        stretched = z[which] + phi[which][:, None] * arm
        stretched -= _dot(stretched, n)[:, None] * n
        tangential = (self.kt * share)[:, None] * stretched
        length = np.sqrt(_dot(tangential, tangential))
        held = np.minimum(1.0, self.mu[part] * normal / np.maximum(length, 1e-300))
        tangential *= held[:, None]
        twisting, normal_of = self.kt * self.torsion**2 * counts, of @ normal
        twist = np.clip(twisting * phi, -self.torsion * normal_of, self.torsion * normal_of)

        # What the springs hold now; the rest has slipped away.
        pulled = of @ tangential
        left = pulled / (self.kt * counts)[:, None]
        stiff = self.kt * (of @ (share * _dot(arm, arm))) + twisting
        around = of @ _dot(tangential, arm) + twist
        turned = np.divide(around, stiff, out=np.zeros(len(here)), where=stiff > 1e-12)
        if held.min() < 1.0:
            gone = z - left
            self.slip[here] += np.sqrt(_dot(gone, gone)) * ((of * held).sum(axis=1) < of.sum(axis=1))
        self.z[:], self.phi[:] = 0.0, 0.0
        self.z[here], self.phi[here] = left, turned

        pressed = share * self.K * raised
        springs = 0.5 * float(self.kt * counts @ _dot(left, left) + stiff @ (turned * turned))
        self._account(
            here, (normal_of, normal_of - of @ pressed, pulled, around), (weights @ rate, across, spin), springs, dt
        )
        self.elastic = float(pressed @ depth) / (self.rho + 1) + springs
        moment = (twist[which] * normal / np.maximum(normal_of[which], 1e-300))[:, None] * n
        return Pressing(normal[:, None] * n + tangential, moment, normal)

    def _account(self, here, forces, speeds, springs: float, dt: float) -> None:
        """Add the work of a step: the mean of the forces at its ends, times the way that the last speeds have led."""
        means = []
        for now, before in zip(forces, self._before):
            means.append(0.5 * (now + before[here]))
            before[:] = 0.0
            before[here] = now
        normal, damping, tangential, moment = means
        rate, across, spin = speeds
        self.normal_work += dt * float(normal @ rate)
        self.damped += dt * float(damping @ rate)
        self.slipped += dt * float(_dot(tangential, across).sum() + moment @ spin) - (springs - self._held)
        self._held = springs


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Cross products (c, 3) of rows: for few rows several times quicker than NumPy's."""
    out = np.empty_like(b)
    out[:, 0] = a[:, 1] * b[:, 2] - a[:, 2] * b[:, 1]
    out[:, 1] = a[:, 2] * b[:, 0] - a[:, 0] * b[:, 2]
    out[:, 2] = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
    return out


def _dot(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return (a * b).sum(axis=1)
