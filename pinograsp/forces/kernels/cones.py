"""Second-order cones of the interior-point method; their vectors are tuples (u, u, u or 0, head).

Scaled by Nesterov and Todd's point (1997); formulas as in Vandenberghe (2010).
"""

from __future__ import annotations

from typing import NamedTuple, TypeAlias

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import FLAGS
from pinograsp.spatial import Array

_ConeVector: TypeAlias = tuple[float, float, float, float]


class ConeState(NamedTuple):
    """Multipliers z of the cones (k, 4) and their steps dz, the centring term (k, 4), scalings: vectors (k, 4) and
    sizes (k,); k = 0 without cones.
    """

    z: Array
    dz: Array
    centring: Array
    bar: Array
    eta: Array


@jit(**FLAGS)
def _in_cone(v: Array, i: int, k: int, n_round: int) -> _ConeVector:
    """Contact i's components of v (1, d k) that a second-order cone bounds."""
    return v[0, i], v[0, k + i], v[0, 2 * k + i] if n_round == 3 else 0.0, v[0, v.shape[1] - k + i]


@jit(**FLAGS)
def _row(v: Array, i: int) -> _ConeVector:
    """Row i of v (k, 4)."""
    return v[i, 0], v[i, 1], v[i, 2], v[i, 3]


@jit(**FLAGS)
def _to_cone(v: _ConeVector, dv: _ConeVector, step: float) -> float:
    """The largest step up to ``step`` that keeps v + step dv in the cone."""
    a = dv[3] * dv[3] - dv[0] * dv[0] - dv[1] * dv[1] - dv[2] * dv[2]
    b = v[3] * dv[3] - v[0] * dv[0] - v[1] * dv[1] - v[2] * dv[2]
    c = v[3] * v[3] - v[0] * v[0] - v[1] * v[1] - v[2] * v[2]
    if v[3] + step * dv[3] > 0.0 and c + step * (2.0 * b + step * a) > 0.0:
        return step
    # Least positive root of a t^2 + 2 b t + c, c > 0.
    root = b * b - a * c
    if root >= 0.0 and (b < 0.0 or a < 0.0):
        root = np.sqrt(root) - b
        if root > 0.0:
            step = min(step, c / root)
    return min(step, -v[3] / dv[3]) if dv[3] < 0.0 else step


@jit(**FLAGS)
def _scaling(s: _ConeVector, z: _ConeVector) -> tuple[_ConeVector, float]:
    """Nesterov and Todd's scaling (vector, size) of a cone's vector and its multiplier."""
    ss = np.sqrt(max(s[3] * s[3] - s[0] * s[0] - s[1] * s[1] - s[2] * s[2], 1e-300))
    zz = np.sqrt(max(z[3] * z[3] - z[0] * z[0] - z[1] * z[1] - z[2] * z[2], 1e-300))
    sz = s[0] * z[0] + s[1] * z[1] + s[2] * z[2] + s[3] * z[3]
    half = 0.5 / np.sqrt(0.5 * (1.0 + sz / (ss * zz)))
    a, b = half / ss, half / zz
    return (a * s[0] - b * z[0], a * s[1] - b * z[1], a * s[2] - b * z[2], a * s[3] + b * z[3]), np.sqrt(ss / zz)


@jit(**FLAGS)
def _scaled(bar: _ConeVector, scale: float, v: _ConeVector, sign: float) -> _ConeVector:
    """W v for sign 1, W^-1 v for sign -1 and the inverse scale."""
    along = bar[0] * v[0] + bar[1] * v[1] + bar[2] * v[2]
    t = sign * v[3] + along / (1.0 + bar[3])
    head = scale * (bar[3] * v[3] + sign * along)
    return scale * (v[0] + t * bar[0]), scale * (v[1] + t * bar[1]), scale * (v[2] + t * bar[2]), head


@jit(**FLAGS)
def scale_cones(x: Array, n_round: int, cones: ConeState, H: Array) -> float:
    """Scalings of all cones and their Hessians, added to H; returns the sum of the complementarity."""
    d, _, k = H.shape
    zc, bar, eta = cones.z, cones.bar, cones.eta
    comp = 0.0
    for i in range(k):
        s, z = _in_cone(x, i, k, n_round), _row(zc, i)
        w, size = _scaling(s, z)
        bar[i, 0], bar[i, 1], bar[i, 2], bar[i, 3], eta[i] = w[0], w[1], w[2], w[3], size
        comp += s[0] * z[0] + s[1] * z[1] + s[2] * z[2] + s[3] * z[3]
        scale = 1.0 / (size * size)
        t = 2.0 * scale
        for a in range(n_round):
            for c in range(a, n_round):
                H[a, c, i] += t * w[a] * w[c]
            H[a, a, i] += scale
            H[a, d - 1, i] -= t * w[a] * w[3]
        H[d - 1, d - 1, i] += t * w[3] * w[3] - scale
    return comp


@jit(**FLAGS)
def step_cones(x: Array, dx: Array, n_round: int, cones: ConeState, corrector: bool, alpha: float) -> float:
    """Steps of the cones' multipliers for the step dx; returns the largest step up to alpha. The predictor leaves its
    Jordan products in ``centring``.
    """
    zc, dzc, centring, bar, eta = cones
    k = eta.shape[0]
    for i in range(k):
        w, v, z = _row(bar, i), _in_cone(dx, i, k, n_round), _row(zc, i)
        scale = 1.0 / eta[i]
        ds = _scaled(w, scale, v, -1.0)
        back = _scaled(w, scale, ds, -1.0)
        c = _row(centring, i)  # zero in the predictor
        dz = (c[0] - z[0] - back[0], c[1] - z[1] - back[1], c[2] - z[2] - back[2], c[3] - z[3] - back[3])
        if not corrector:
            t = _scaled(w, eta[i], dz, 1.0)
            for j in range(3):
                centring[i, j] = ds[3] * t[j] + t[3] * ds[j]
            centring[i, 3] = ds[0] * t[0] + ds[1] * t[1] + ds[2] * t[2] + ds[3] * t[3]
        dzc[i, 0], dzc[i, 1], dzc[i, 2], dzc[i, 3] = dz
        alpha = _to_cone(z, dz, _to_cone(_in_cone(x, i, k, n_round), v, alpha))
    return alpha


@jit(**FLAGS)
def centre_cones(cones: ConeState, centre: float) -> None:
    r"""Jordan products p in ``centring`` become W^-1 (lambda \ (centre e - p)), lambda = W z."""
    zc, _, centring, bar, eta = cones
    for i in range(eta.shape[0]):
        w, p = _row(bar, i), _row(centring, i)
        v = _scaled(w, eta[i], _row(zc, i), 1.0)
        det = v[3] * v[3] - v[0] * v[0] - v[1] * v[1] - v[2] * v[2]
        t = v[3] * (centre - p[3]) + v[0] * p[0] + v[1] * p[1] + v[2] * p[2]
        t /= max(det, 1e-300)
        c = ((-p[0] - t * v[0]) / v[3], (-p[1] - t * v[1]) / v[3], (-p[2] - t * v[2]) / v[3], t)
        c = _scaled(w, 1.0 / eta[i], c, -1.0)
        centring[i, 0], centring[i, 1], centring[i, 2], centring[i, 3] = c
