"""Powers of F_n in the objective."""

from __future__ import annotations

import numpy as np

from pinograsp.forces.jit import jit
from pinograsp.forces.kernels.flags import COUNTED, FLAGS
from pinograsp.forces.kernels.layouts import Powers
from pinograsp.spatial import Array


@jit(**FLAGS)
def phi(F: float, coefs: Array, exps: Array) -> tuple[float, float, float]:
    """phi, phi' and phi'' at F > 0; the powers are those of :class:`~pinograsp.forces.kernels.layouts.Powers`."""
    value, first, second = 0.0, 0.0, 0.0
    if coefs.shape[0] > 0:
        # The exponents are 1 + j / rho (Eqs. 9 and 11), so one power serves all of them.
        root = F ** exps[0]
        for a in range(coefs.shape[0]):
            power, exponent = coefs[a], exps[0] * exps[1 + a]
            for _ in range(int(exps[1 + a])):
                power *= root
            value += power / (1.0 + exponent)
            first += power
            second += exponent * power
    return value * F, first, second / F


@jit(**COUNTED)
def powers_of(terms: Array, scale: float, unit: float) -> Powers:
    """phi' from pairs (coefficient, exponent): the exponents are 1, 1 + 1 / rho and 1 + 2 / rho."""
    count = terms.shape[0]
    coefs, exps = np.empty(count), np.empty(count + 1)
    exps[0] = 1.0
    for a in range(count):
        if terms[a, 1] > 1.0:
            exps[0] = min(exps[0], terms[a, 1] - 1.0)
    for a in range(count):
        coefs[a] = terms[a, 0] * terms[a, 1] * scale ** terms[a, 1] / unit
        exps[1 + a] = np.round((terms[a, 1] - 1.0) / exps[0])
    return Powers(coefs, exps)
