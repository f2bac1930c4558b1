"""One squeeze that withstands many loads, for many grasps at once: each a force problem of one load, solved in a batch.

The contacts give way as equally stiff springs, along the normals and along the surfaces: a wrench dw that is added to
the load changes their forces by df = -G^+ dw. Contact i then stays within its friction limit under all loads l if

    |f_t,i| <= mu (F_i - a_i),    a_i = max over l of (|df_t,il| / mu - dF_il),

since |f_t + df_t| <= |f_t| + |df_t|. Friction may as well react in the ratio of what the contacts bear. With
g = f - a n this is a force problem for the load w + G (a n), which any method for a single load solves. What it finds
withstands all loads; it may press harder than the least squeeze that does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pinograsp.contacts import Friction
from pinograsp.spatial import Array, BoolArray, IntArray, cross

_RANK = 1e-6  # of the grasp map's singular values, squared ones below its square count as zero
_REACHED = 1e-6  # share of a wrench that springs may leave unbalanced


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reactions:
    """How the contacts of N grasps react, as springs, to m wrenches that are added to their loads.

    Attributes:
        normal: change of F_n (N, k, m) [N].
        tangential: change of the other components in contact axes (N, k, d - 1, m) [N, N m].
        borne: whether the contacts can balance the wrench at all (N, m).
    """

    normal: Array
    tangential: Array
    borne: BoolArray

    def of(self, which: IntArray) -> Reactions:
        """Of some of the grasps."""
        return Reactions(normal=self.normal[which], tangential=self.tangential[which], borne=self.borne[which])

    def times(self, shares: Array | float) -> Reactions:
        """To ``shares`` (N,) of the wrenches."""
        own = np.reshape(shares, (-1, 1, 1))
        return Reactions(normal=own * self.normal, tangential=own[..., None] * self.tangential, borne=self.borne)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Springs:
    """Contacts of N grasps, k each, as springs: columns of their grasp maps, moments as forces at their mean distance.

    Attributes:
        columns: wrench per unit of each component (N, k, d, 6) [-], zeros where there is no contact.
        wrenches: that are added to the load, scaled likewise (N, 6, m) [N].
        torsion: [m], the unit of the component that turns.
    """

    columns: Array
    wrenches: Array
    torsion: float

    def of(self, which: IntArray) -> Springs:
        """Those of some of the grasps."""
        return Springs(columns=self.columns[which], wrenches=self.wrenches[which], torsion=self.torsion)

    def times(self, shares: Array | float) -> Springs:
        """With ``shares`` (N,) of the wrenches."""
        return Springs(
            columns=self.columns, wrenches=np.reshape(shares, (-1, 1, 1)) * self.wrenches, torsion=self.torsion
        )

    def reactions(self) -> Reactions:
        """Of equal springs, along the normals and along the surfaces."""
        change, lost = _balance(self.columns, self.wrenches)
        return self._record(change, lost)

    def spread(self, reacted: Reactions, capacities: Array) -> Reactions:
        """The same normal forces; tangential ones in the ratio of what the contacts can bear (N, k) [N].

        Friction may react so: tangential forces of least sum of squares, each over its capacity.
        """
        left = self.wrenches + np.einsum("nki,nkm->nim", self.columns[:, :, -1], reacted.normal)
        weights = np.maximum(capacities, 1e-3 * capacities.max(axis=1, keepdims=True, initial=1e-12))
        change, lost = _balance(self.columns[:, :, :-1] * weights[..., None, None], left)
        full = np.concatenate([change * weights[..., None, None], reacted.normal[:, :, None]], axis=2)
        return self._record(full, np.maximum(lost, 1.0 * ~reacted.borne))

    def _record(self, change: Array, lost: Array) -> Reactions:
        if change.shape[2] == 4:
            change[:, :, 2] *= self.torsion
        return Reactions(normal=change[:, :, -1], tangential=change[:, :, :-1], borne=lost <= _REACHED)


def _balance(columns: Array, wrenches: Array) -> tuple[Array, Array]:
    """Least components (N, k, d, m) of columns (N, k, d, 6) that balance wrenches (N, 6, m), and shares lost (N, m)."""
    n, k, d = columns.shape[:3]
    flat = columns.reshape(n, k * d, 6)
    values, vectors = np.linalg.eigh(np.swapaxes(flat, 1, 2) @ flat)
    kept = values > _RANK**2 * np.maximum(values[:, -1:], 1e-300)
    along = np.swapaxes(vectors, 1, 2) @ wrenches
    rest = np.where(kept[..., None], 0.0, along)
    lost = np.linalg.norm(rest, axis=1) / np.maximum(np.linalg.norm(along, axis=1), 1e-300)
    solved = vectors @ ((along - rest) / np.where(kept, values, 1.0)[..., None])
    return -(flat @ solved).reshape(n, k, d, -1), lost


def make_springs(points: Array, rotations: Array, used: BoolArray, friction: Friction, wrenches: Array) -> Springs:
    """The springs of contacts.

    Args:
        points: from the centre of mass (N, k, 3) [m].
        rotations: contact frames (N, k, 3, 3).
        used: which contacts there are (N, k).
        friction: the model; with torsion contacts resist turning, too.
        wrenches: (m, 6), linear first, about the centre of mass [N, N m].
    """
    n, k, d = len(points), points.shape[1], friction.d
    forces = np.zeros((n, k, d, 6))
    forces[:, :, :2, :3] = np.swapaxes(rotations, 2, 3)[:, :, :2]
    forces[:, :, -1, :3] = rotations[..., 2]
    if d == 4:
        forces[:, :, 2, 3:] = friction.torsion * rotations[..., 2]
    forces[..., 3:] += cross(points[:, :, None], forces[..., :3])
    forces *= used[:, :, None, None]
    # Moments as forces at the contacts' mean distance, so that both count alike.
    arms = np.where(used, np.linalg.norm(points, axis=2), 0.0).sum(axis=1) / np.maximum(used.sum(axis=1), 1)
    scale = np.ones((n, 6))
    scale[:, 3:] = 1.0 / np.where(arms > 0, arms, 1.0)[:, None]
    scaled = np.swapaxes(wrenches[None] * scale[:, None], 1, 2)
    return Springs(columns=forces * scale[:, None, None], wrenches=scaled, torsion=friction.torsion)


def find_offsets(reacted: Reactions, friction: Friction, mu: float, local: Array | None = None) -> Array:
    """a (N, k) [N]: by how much F_n is to exceed what friction needs, so that all added wrenches are borne.

    With forces ``local`` (N, k, d) in contact axes: exactly, for tangential forces as theirs; without: for any.
    """
    limits = limits_of(friction, mu)
    changes = np.swapaxes(reacted.tangential, 2, 3) / limits
    before: Array | float = 0.0
    if local is not None:
        own = local[..., :-1] / limits
        changes, before = changes + own[:, :, None], friction.gauge(own)
    needed = (friction.gauge(changes) - reacted.normal).max(axis=2, initial=0.0)
    found: Array = np.maximum(needed - before, 0.0)
    return found


def limits_of(friction: Friction, mu: float) -> Array:
    """Friction's limits per newton of F_n (d - 1,): mu twice [-], and the torsion [m], over the safety factor."""
    limits: Array = np.maximum(friction.scale(np.array([mu]))[0], 1e-12)
    return limits


def find_multiples(local: Array, reacted: Reactions, used: BoolArray, friction: Friction, mu: float) -> Array:
    """Multiples s (N, m) of each wrench that forces withstand before the first contact slips or opens.

    The least s > 0 that takes some contact to the edge of its friction limit: the roots of a square for balls, of a
    line for facets.

    Args:
        local: forces in contact axes, the normal last (N, k, d), within their limits.
        reacted: to the wrenches.
        used: which contacts there are (N, k).
        friction: the model.
        mu: friction coefficient.
    """
    limits = limits_of(friction, mu)
    t, dt = (local[..., :-1] / limits)[..., None], reacted.tangential / limits[:, None]
    F, dF = local[..., -1:], reacted.normal
    least = np.full(dF.shape, np.inf)
    if len(friction.facets):
        room = F[..., None] - friction.facets @ t
        rate = friction.facets @ dt - dF[:, :, None]
        least = np.where(rate > 0, np.maximum(room, 0.0) / np.maximum(rate, 1e-300), np.inf).min(axis=2)
    if r := friction.round_dimensions:
        least = np.minimum(least, _leaves(t[:, :, :r], dt[:, :, :r], F, dF))
    found: Array = np.where(used[:, :, None], least, np.inf).min(axis=1)
    return np.where(reacted.borne, found, 0.0)


def _leaves(t: Array, dt: Array, F: Array, dF: Array) -> Array:
    """The least s > 0 with |t + s dt| = F + s dF, infinity where there is none; |t| <= F up to rounding.

    t (N, k, r, 1), dt (N, k, r, m), F (N, k, 1), dF (N, k, m).
    """
    a = (dt * dt).sum(axis=2) - dF**2
    b = (t * dt).sum(axis=2) - F * dF
    c = np.minimum((t * t).sum(axis=2) - F**2, 0.0)
    inner = b**2 - a * c
    slope = b + np.sqrt(np.maximum(inner, 0.0))
    return np.where((inner >= 0) & (slope > 0), -c / np.maximum(slope, 1e-300), np.inf)
