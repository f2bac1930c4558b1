"""Friction models: what a contact can give tangentially, and about its normal, per newton of normal force.

Every model is a convex set U of scaled tangential forces u = (u_x, u_y[, u_t]): a contact with normal force F_n gives
f_x = mu u_x, f_y = mu u_y and the torsional moment m = torsion u_t with u in F_n U.

- ``"pyramid"``: U is the regular polygon with ``edges`` vertices on the unit circle, the first at 45 deg, so the
  pyramid is inscribed in the cone and contains the one of half the edges. Four edges are the paper's pyramid,
  |f_x|, |f_y| <= mu F_n / sqrt(2) (Eq. 16).
- ``"cone"``: U is the unit disc, Coulomb's exact second-order cone.
- ``"soft"``: U is the unit ball: soft finger with the elliptic limit (f_x^2 + f_y^2) / mu^2 + m^2 / torsion^2 <= F_n^2
  (Howe and Cutkosky, 1996). With ``torsion > 0`` the other two models get the plain limit |m| <= torsion F_n.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from functools import lru_cache
from typing import get_args

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, finite_of, integer, number, one_of, read_only
from pinograsp.errors import InvalidInput
from pinograsp.plan.parts import FRICTION_TRAITS, FrictionModel
from pinograsp.spatial import Array

FRICTION_MODELS: tuple[FrictionModel, ...] = get_args(FrictionModel)
LARGEST_MU = 1e6  # above that of any pair of materials; its square is still exact enough to compute with
_MOST_EDGES = 1024  # hardly different from the cone


@dataclass(frozen=True, slots=True, kw_only=True)
class Friction:
    """A friction model; the coefficient mu belongs to each contact of the problem.

    Attributes:
        model: ``"pyramid"``, ``"cone"`` or ``"soft"``.
        edges: edges of the pyramid, even, at least 4; it is inscribed in the cone.
        torsion: largest torsional moment per newton of normal force [m]; 0: none.
        safety: friction is used up to mu / safety and torsion / safety [-].

    Example:
        >>> import pinograsp as pg
        >>> fingertips = pg.Friction(model="soft", torsion=0.005, safety=1.2)
        >>> print(pg.GraspConditions(mu=0.6, friction=fingertips).friction.model)
        soft

    See Also:
        :class:`~pinograsp.forces.GraspConditions`, :class:`~pinograsp.forces.ForceProblem`.
    """

    model: FrictionModel = "pyramid"
    edges: int = 4
    torsion: float = 0.0
    safety: float = 1.0

    def __post_init__(self) -> None:
        one_of("friction model", self.model, FRICTION_MODELS)
        edges = integer("friction edges", self.edges, at_least=4, at_most=_MOST_EDGES)
        if edges % 2:
            raise InvalidInput(f"friction edges: expected an even integer >= 4, got {edges}")
        object.__setattr__(self, "edges", edges)
        torsion = number("friction torsion", self.torsion, at_least=0, at_most=LARGEST_MU, unit="m")
        object.__setattr__(self, "torsion", torsion)
        object.__setattr__(self, "safety", number("friction safety factor", self.safety, at_least=1))
        if self.elliptic and self.torsion == 0:
            raise InvalidInput(f"friction model '{self.model}': expected torsion > 0 [m] (moment per newton), got 0")

    @classmethod
    def standard(cls, model: FrictionModel, *, safety: float = 1.0) -> Friction:
        """Return a model by its name alone: four edges for a pyramid, and 5 mm of torsion for soft fingers, as for a
        rubber pad of 1 cm.
        """
        elliptic = FRICTION_TRAITS[one_of("friction model", model, FRICTION_MODELS)].elliptic
        return cls(model=model, torsion=5e-3 if elliptic else 0.0, safety=safety)

    @property
    def is_paper(self) -> bool:
        """Whether this is the paper's pyramid without torsion: the only model with multipliers (k1, k2)."""
        return self.polyhedral and self.edges == 4 and self.torsion == 0

    @property
    def polyhedral(self) -> bool:
        """Whether U is a polytope, so that the limits are linear rows."""
        return FRICTION_TRAITS[self.model].polygon

    @property
    def elliptic(self) -> bool:
        """Whether one limit bounds tangential forces and torsion together: a soft finger's."""
        return FRICTION_TRAITS[self.model].elliptic

    @property
    def round_dimensions(self) -> int:
        """Number of components of u that a second-order cone |u| <= F_n bounds: 0 (pyramid), 2 or 3 (soft finger)."""
        return 0 if self.polyhedral else 3 if self.elliptic else 2

    @property
    def separates(self) -> bool:
        """Whether U is a product of balls and intervals: a cone, a soft finger, or the pyramid of 4 edges (seen along
        its edges).
        """
        return not self.polyhedral or self.edges == 4

    @property
    def radii(self) -> Array:
        """Half-widths (d - 1,) of those balls and intervals."""
        radii = np.ones(self.d - 1)
        if self.polyhedral:
            radii[:2] = np.sqrt(0.5)
        return radii

    @property
    def d(self) -> int:
        """Numbers per contact: 3 (f_x, f_y, F_n) or 4 with torsion (f_x, f_y, m, F_n)."""
        return 4 if self.torsion > 0 else 3

    def scale(self, mu: ArrayLike) -> Array:
        """Force [N] or moment [N m] per unit of u and newton of F_n: (k, d - 1) from mu (k,)."""
        mu = array_of("mu", mu, (None,))
        scale = np.empty((len(mu), self.d - 1))
        scale[:, :2] = (mu / self.safety)[:, None]
        scale[:, 2:] = self.torsion / self.safety
        return scale

    @property
    def facets(self) -> Array:
        """Rows D (r, d - 1), u in F_n U if and only if D u <= F_n; of the polygon and of a plain torsional limit."""
        return _facets(self.edges if self.polyhedral else 0, self.d, self._plain_torsion)

    @property
    def vertices(self) -> Array:
        """Vertices (e, 2) of the polygon of tangential forces; only a pyramid has any."""
        if not self.polyhedral:
            raise InvalidInput(f"friction model '{self.model}' has no vertices: use a pyramid with more edges")
        return _vertices(self.edges)

    def support(self, a: ArrayLike) -> Array:
        """max of a . u over U (...,) for directions a (..., d - 1)."""
        a = self._tangential("direction", a)
        along: Array
        if not self.polyhedral:
            along = _length(a[..., : self.round_dimensions])
        elif self.edges == 4:
            along = (np.abs(a[..., 0]) + np.abs(a[..., 1])) * np.sqrt(0.5)
        else:
            along = (a[..., :2] @ self.vertices.T).max(axis=-1)
        return along + np.abs(a[..., 2]) if self._plain_torsion else along

    def support_point(self, a: ArrayLike) -> Array:
        """A maximiser u (..., d - 1) of a . u over U."""
        a = self._tangential("direction", a)
        u = np.empty_like(a)
        if self.polyhedral:
            u[..., :2] = self.vertices[np.argmax(a[..., :2] @ self.vertices.T, axis=-1)]
        else:
            within = a[..., : self.round_dimensions]
            u[..., : self.round_dimensions] = within / np.maximum(_length(within), 1e-300)[..., None]
        if self._plain_torsion:
            u[..., 2] = np.sign(a[..., 2])
        return u

    def gauge(self, u: ArrayLike) -> Array:
        """Least normal force (...,) that allows u (..., d - 1): the utilisation times F_n."""
        u = self._tangential("tangential force", u)
        if self.polyhedral:
            least: Array = (u @ self.facets.T).max(axis=-1)
            return least
        least = _length(u[..., : self.round_dimensions])
        return np.maximum(least, np.abs(u[..., 2])) if self._plain_torsion else least

    @property
    def _plain_torsion(self) -> bool:
        """Whether torsion has a limit of its own, |m| <= torsion F_n."""
        return self.d == 4 and not self.elliptic

    def _tangential(self, name: str, value: ArrayLike) -> Array:
        array = finite_of(name, value)
        if array.shape[-1:] != (self.d - 1,):
            raise InvalidInput(f"{name}: expected {self.d - 1} components, got shape {array.shape}")
        return array


CONE, SOFT = Friction.standard("cone"), Friction.standard("soft")


def default_friction(fingers: Iterable[str]) -> Friction:
    """The model where none is given, for contacts of these fingers: cones, and soft fingers where no more than two
    fingers touch, which would hold nothing against turning about their line otherwise.
    """
    return SOFT if len(set(fingers)) <= 2 else CONE


def _length(u: Array) -> Array:
    length: Array = np.hypot(u[..., 0], u[..., 1]) if u.shape[-1] == 2 else np.sqrt(np.einsum("...j,...j->...", u, u))
    return length


@lru_cache(maxsize=64)
def _facets(edges: int, d: int, plain_torsion: bool) -> Array:
    rows = np.zeros((edges, d - 1))
    if edges:
        angles = np.pi / 4 + np.pi / edges + 2 * np.pi * np.arange(edges) / edges
        rows[:, :2] = np.column_stack([np.cos(angles), np.sin(angles)]) / np.cos(np.pi / edges)
        rows[np.abs(rows) < 1e-15] = 0.0
    if plain_torsion:
        rows = np.vstack([rows, [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    return read_only(rows)


@lru_cache(maxsize=64)
def _vertices(edges: int) -> Array:
    # The paper's four are among them whenever edges is a multiple of four, so doubling the edges never takes force
    # away.
    angles = np.pi / 4 + 2 * np.pi * np.arange(edges) / edges
    return read_only(np.column_stack([np.cos(angles), np.sin(angles)]))
