"""The contact law of two elastic bodies, from their materials and shapes: Hertz's."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.optimize import brentq
from scipy.special import ellipkm1, elliprd

from pinograsp.checks import array_of, number
from pinograsp.contacts.compliance import MarhefkaOrin
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array

# A gap that opens this much more slowly in one direction than the bodies curve is a line contact: what is left of a
# difference of two equal curvatures is rounding, and the patch would be ten thousand times longer than wide.
_LINE = 1e-9


def hertz(
    *,
    young: ArrayLike,
    poisson: ArrayLike,
    curvatures: ArrayLike,
    angle: float = 0.0,
    damping: float = 0.0,
) -> MarhefkaOrin:
    """Hertz's law F_n = K delta^1.5 of two elastic bodies that touch at a point.

    K. L. Johnson, Contact Mechanics (Cambridge University Press, 1985), chapter 4; ``depth`` is the approach of the
    two bodies. Let A x^2 + B y^2 be the gap between the undeformed surfaces, A <= B, b <= a the semi-axes of the
    patch, 1 / E* = (1 - nu_1^2) / E_1 + (1 - nu_2^2) / E_2, K(m) and E(m) the complete elliptic integrals and
    D = (K - E) / m. Then m = 1 - (b/a)^2 solves B/A = (K - D) / ((1 - m) D), and

        stiffness = (2 pi / 3) E* sqrt(D / A) / K^1.5,

    which where A = B is 4/3 E* sqrt(R) with R = 1 / (2 A).

    Args:
        young: Young's moduli (E_1, E_2) [Pa].
        poisson: Poisson's ratios (nu_1, nu_2) [-].
        curvatures: principal curvatures (2, 2) [1/m], one row per body, the smaller first, positive where the body
            is convex: what the shapes' ``curvature`` gives.
        angle: between the directions of the bodies' first curvatures [rad].
        damping: lambda [N s/m^2.5]; Hertz's contact itself has none.

    Raises:
        InvalidInput: materials that do not exist, or a gap that does not open in both directions.
    """
    moduli, ratios = array_of("Young's moduli", young, (2,)), array_of("Poisson's ratios", poisson, (2,))
    if np.any(moduli <= 0):
        raise InvalidInput(f"Young's moduli: expected two numbers > 0 [Pa], got {moduli.tolist()}")
    if np.any((ratios <= -1) | (ratios > 0.5)):
        raise InvalidInput(f"Poisson's ratios: expected two numbers > -1 and <= 0.5, got {ratios.tolist()}")
    A, B = _gap_curvatures(array_of("curvatures", curvatures, (2, 2)), number("angle", angle, unit="rad"))
    modulus = 1 / ((1 - ratios**2) / moduli).sum()

    # From 1 - m = (b/a)^2, and D as Carlson's integral: (K - E) / m has no digits left near a circle.
    def integrals(slimness: float) -> tuple[float, float]:
        return ellipkm1(slimness), elliprd(0.0, slimness, 1.0) / 3

    def miss(log_slimness: float) -> float:
        slimness = np.exp(log_slimness)
        K, D = integrals(slimness)
        return float(np.log((K - D) / (slimness * D)) - np.log(B / A))

    # B/A is 1 at a circle, where rounding may put it on either side, and far beyond 1 / _LINE at exp(-30).
    slimness = 1.0 if miss(0.0) >= 0 else np.exp(brentq(miss, -30.0, 0.0, xtol=1e-15, rtol=1e-14))
    K, D = integrals(slimness)
    return MarhefkaOrin(stiffness=2 * np.pi / 3 * modulus * np.sqrt(D / A) / K**1.5, damping=damping, exponent=1.5)


def _gap_curvatures(curvatures: Array, angle: float) -> tuple[float, float]:
    """A <= B [1/m] of the gap A x^2 + B y^2 between two bodies with principal curvatures (2, 2) [1/m].

    K. L. Johnson, Contact Mechanics (1985), section 4.1. Raises :class:`InvalidInput` where A is not above zero.
    """
    (first, second), total = np.diff(curvatures, axis=1)[:, 0], curvatures.sum()
    # |d1 + d2 exp(2 i angle)|: its square is Johnson's d1^2 + d2^2 + 2 d1 d2 cos(2 angle).
    spread = np.hypot(first + second * np.cos(2 * angle), second * np.sin(2 * angle))
    slow, fast = float(total - spread) / 4, float(total + spread) / 4
    rounding = _LINE * np.abs(curvatures).max()
    if slow > rounding:
        return slow, fast
    touching = "along a line or an area" if slow >= -rounding else "at more than one point (one is hollow)"
    raise InvalidInput(
        f"curvatures: expected bodies whose gap opens in both directions, got relative curvatures {2 * slow:.6g} and "
        f"{2 * fast:.6g} [1/m] from {curvatures.tolist()}: they touch {touching}, and Hertz's point contact needs "
        "relative curvature in both directions. Give one body a crown (an ellipsoid instead of a cylinder or a plane), "
        "or measure the law: MeasuredCompliance(depths=..., forces=...)"
    )
