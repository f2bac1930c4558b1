"""One squeeze that withstands many loads, for many grasps at once: each a force problem of one load, solved in a batch.

The contacts give way as equally stiff springs, along the normals and along the surfaces: a wrench dw that is added to
the load changes their forces by df = -G^+ dw. Contact i then stays within its friction limit under all loads l if

    |f_t,i| <= mu (F_i - a_i),    a_i = max over l of (|df_t,il| / mu - dF_il),

since |f_t + df_t| <= |f_t| + |df_t|. Friction may as well react in the ratio of what the contacts bear. With
g = f - a n this is a force problem for the load w + G (a n), which any method for a single load solves. What it finds
withstands all loads; it may press harder than the least squeeze that does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from pinograsp.contacts import Friction
from pinograsp.core.threads import call_in_parts
from pinograsp.spatial import Array, BoolArray, IntArray

_LANES = 8  # the most that any processor computes at once: the core takes multiples of it


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Grips:
    """Contacts of N grasps, up to k each.

    Attributes:
        points: from the centre of mass (N, k, 3) [m].
        rotations: contact frames (N, k, 3, 3).
        counts: contacts (N,), at least one.
        least: F_n that each has at least (N, k) [N]; None: 0.
    """

    points: Array
    rotations: Array
    counts: IntArray
    least: Array | None = None

    @property
    def used(self) -> BoolArray:
        """Which contacts there are (N, k)."""
        used: BoolArray = np.arange(self.points.shape[1]) < self.counts[:, None]
        return used

    @property
    def arms(self) -> Array:
        """Mean distances of the contacts from the centre of mass (N,) [m], 1 where they are all in it."""
        distances = np.sqrt(np.einsum("nkx,nkx->nk", self.points, self.points))
        mean = np.where(self.used, distances, 0.0).sum(axis=1) / np.maximum(self.counts, 1)
        return np.where(mean > 0, mean, 1.0)

    def of(self, which: BoolArray | IntArray) -> Grips:
        """Some of them."""
        least = None if self.least is None else self.least[which]
        return Grips(points=self.points[which], rotations=self.rotations[which], counts=self.counts[which], least=least)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reactions:
    """How the contacts of N grasps react, as springs, to m wrenches that are added to their loads.

    They are ``rows`` (N,) of G grasps, whose arrays have a few wrenches more, zero ones.

    Attributes:
        change: of the forces in contact axes, the normal last (G, k, d, m + ...) [N, N m].
        balanced: whether the contacts can balance the wrenches at all (G, m + ...).
        counts: contacts (G,).
        rows: which grasps they are (N,).
        m: number of wrenches.
    """

    change: Array
    balanced: BoolArray
    counts: IntArray
    rows: IntArray
    m: int

    @property
    def normal(self) -> Array:
        """Change of F_n (N, k, m) [N]."""
        return self.change[self.rows, :, -1, : self.m]

    @property
    def tangential(self) -> Array:
        """Change of the other components in contact axes (N, k, d - 1, m) [N, N m]."""
        return self.change[self.rows, :, :-1, : self.m]

    @property
    def borne(self) -> BoolArray:
        """Whether the contacts can balance the wrench at all (N, m)."""
        return self.balanced[self.rows, : self.m]

    def of(self, which: IntArray) -> Reactions:
        """Of some of the grasps."""
        return replace(self, rows=self.rows[which])

    @property
    def _arrays(self) -> dict[str, object]:
        return {"change": self.change, "borne": self.balanced, "counts": self.counts, "rows": self.rows}


def react(grips: Grips, friction: Friction, wrenches: Array, threads: int | None = None) -> Reactions:
    """Reactions of equal springs, along the normals and along the surfaces.

    Moments count as forces at the contacts' mean distance.

    Args:
        grips: the contacts.
        friction: the model; with torsion contacts resist turning, too.
        wrenches: (m, 6), linear first, about the centre of mass [N, N m].
        threads: of the compiled code; None: one for each core.
    """
    return _react(grips, friction, wrenches, threads, {})


def spread(
    grips: Grips, friction: Friction, wrenches: Array, whole: Reactions, capacities: Array, threads: int | None = None
) -> Reactions:
    """The same normal forces as ``whole`` of these grips; tangential ones in the ratio of what the contacts can bear
    (N, k) [N].

    Friction may react so: tangential forces of least sum of squares, each over its capacity.
    """
    before = {"whole": whole.change, "whole_borne": whole.balanced, "capacities": capacities}
    return _react(grips, friction, wrenches, threads, before)


def _react(
    grips: Grips, friction: Friction, wrenches: Array, threads: int | None, before: Mapping[str, object]
) -> Reactions:
    (n, k), m = grips.points.shape[:2], len(wrenches)
    lanes = -(-m // _LANES) * _LANES
    found = Reactions(
        change=np.zeros((n, k, friction.d, lanes)),
        balanced=np.zeros((n, lanes), dtype=bool),
        counts=grips.counts,
        rows=np.arange(n),
        m=m,
    )
    given = {
        "torsion": friction.torsion,
        "points": grips.points,
        "rotations": grips.rotations,
        "counts": found.counts,
        "arms": grips.arms,
        "wrenches": np.pad(wrenches, ((0, lanes - m), (0, 0))).T,
        "change": found.change,
        "borne": found.balanced,
    }
    call_in_parts("react", n, threads, {**given, **before})
    return found


def find_offsets(
    reacted: Reactions,
    friction: Friction,
    mu: float,
    local: Array | None = None,
    *,
    shares: Array | float = 1.0,
    threads: int | None = None,
) -> Array:
    """a (N, k) [N]: by how much F_n is to exceed what friction needs, so that all added wrenches are borne.

    Of each ``shares`` (N,). With forces ``local`` (N, k, d) in contact axes: exactly, for tangential forces as theirs;
    without: for any.
    """
    n, k = len(reacted.rows), reacted.change.shape[1]
    found = np.zeros((n, k))
    given = {
        **reacted._arrays,
        **_limits(friction, mu),
        "local": local,
        "shares": np.array(np.broadcast_to(shares, n), dtype=float),
        "offsets": found,
    }
    call_in_parts("find_offsets", n, threads, given)
    return found


def find_multiples(
    local: Array, reacted: Reactions, friction: Friction, mu: float, *, threads: int | None = None
) -> Array:
    """Multiples s (N, m) of each wrench that forces withstand before the first contact slips or opens.

    The least s > 0 that takes some contact to the edge of its friction limit: the roots of a square for balls, of a
    line for facets.

    Args:
        local: forces in contact axes, the normal last (N, k, d), within their limits.
        reacted: to the wrenches.
        friction: the model.
        mu: friction coefficient.
        threads: of the compiled code; None: one for each core.
    """
    n = len(reacted.rows)
    found = np.zeros((n, reacted.change.shape[3]))
    given = {
        **reacted._arrays,
        **_limits(friction, mu),
        "local": local,
        "multiples": found,
    }
    call_in_parts("find_multiples", n, threads, given)
    return found[:, : reacted.m]


def find_efforts(
    jacobians: Array,
    rotations: Array,
    bias: Array,
    local: Array,
    reacted: Reactions,
    *,
    places: IntArray | None = None,
    threads: int | None = None,
) -> tuple[Array, Array]:
    """Holding torques of forces, and the largest sizes that the reactions bring them to, both (N, n) [N m or N].

    Args:
        jacobians: of the contacts (N, k, 6, n), or of those of more grasps.
        rotations: contact frames (N, k, 3, 3).
        bias: torques without contact (N, n).
        local: forces in contact axes, the normal last (N, k, d).
        reacted: to the wrenches that are added to the load.
        places: where the grasps are among the Jacobians (N,).
        threads: of the compiled code; None: one for each core.
    """
    tau, most = np.zeros(bias.shape), np.zeros(bias.shape)
    given = {
        **reacted._arrays,
        "jacobians": jacobians,
        "places": np.arange(len(bias)) if places is None else places,
        "rotations": rotations,
        "bias": bias,
        "local": local,
        "torques": tau,
        "most": most,
    }
    call_in_parts("find_efforts", len(bias), threads, given)
    return tau, most


def _limits(friction: Friction, mu: float) -> dict[str, object]:
    """Friction's limits per newton of F_n (d - 1,): mu twice [-], and the torsion [m], over the safety factor."""
    limits: Array = np.maximum(friction.scale(np.array([mu]))[0], 1e-12)
    return {"round": friction.round_dimensions, "limits": limits, "facets": friction.facets}
