"""What the compiled functions take and give: k contacts with d components each, F_n the last of them.

Arrays of the interior-point method are by contact, (k, d); those of the dual Newton method by component, (d, k), so
that its innermost loops run over contacts that are neighbours in memory, without branches where speed depends on it.
Handing a named tuple to a compiled function costs some nanoseconds for each of its arrays, unless references to these
are counted (see :mod:`~pinograsp.forces.kernels.flags`), which costs much more.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from pinograsp.spatial import Array, IntArray

CONVERGED, STALLED, INFEASIBLE = 0, 1, 2
PROVEN = 1e-9  # margin of a Farkas certificate, relative to the load


class Powers(NamedTuple):
    """phi' is the sum of coefs[a] F^(exps[0] exps[1 + a]): coefs (a,), exps (1 + a,), integers from the second on."""

    coefs: Array
    exps: Array


# -- dual Newton ------------------------------------------------------------------------------------------------------


class Balance(NamedTuple):
    """A x = b: A (m, d k) by component, b (m,). With ``give`` > 0 it may be missed at a cost of |A x - b|^2 / (2
    give).
    """

    A: Array
    b: Array
    give: float


class Quadratic(NamedTuple):
    """1/2 w x^2 + q x with w > 0 and q (d, k)."""

    w: Array
    q: Array


class Costs(NamedTuple):
    """The objective of separable problems: the diagonal P and q (d, k), and powers of F_n."""

    P: Array
    q: Array
    powers: Powers


class Cones(NamedTuple):
    """lo <= F_n <= hi (k,), and friction: the first ``n_round`` components together, the others each up to its radius
    times F_n; radii (d - 1,).
    """

    lo: Array
    hi: Array
    radii: Array
    n_round: int


# -- interior points --------------------------------------------------------------------------------------------------


class Rows(NamedTuple):
    """Balance (m rows) and torque rows (r).

    Attributes:
        A: balance and torque rows that several contacts enter, by component (n rounded up to a multiple of three, d k).
        B: all rows, those of A first, by contact (k, d, m + r).
        touched: the rows that a contact enters (k, m + r).
        counts: how many of these a contact has below n, and in all (k, 2).
        shared: n, the number of rows of A that are not padding.
    """

    A: Array
    B: Array
    touched: IntArray
    counts: IntArray
    shared: int


class Limits(NamedTuple):
    """Limits of single contacts: f facets of the friction cone, F_n, up to g torque rows that only this one enters.

    Attributes:
        G: their coefficients (f + 1 + g, d, k).
        used: which components enter them (f + 1 + g, d).
        own: where in ``Rows.B`` the torque rows are, -1 for none (g, k).
    """

    G: Array
    used: IntArray
    own: IntArray


class Friction(NamedTuple):
    """The friction cone F_n U of :class:`~pinograsp.contacts.Friction`.

    Attributes:
        facets: normals with -1 ... 1 for F_n (f, d).
        vertices: of a polygon (v, 2), else (0, 2).
        radii: of components outside the round ones (d - 1,).
        n_round: components that a second-order cone bounds.
    """

    facets: Array
    vertices: Array
    radii: Array
    n_round: int


class Objective(NamedTuple):
    """1/2 x'P x + q'x and powers of F_n: P (k, d, d), q (k, d)."""

    P: Array
    q: Array
    powers: Powers


class Ranges(NamedTuple):
    """lo < hi (k,) of F_n, R_lo < R_hi (r,) of the torque rows."""

    lo: Array
    hi: Array
    R_lo: Array
    R_hi: Array


class Problem(NamedTuple):
    """A force problem as the interior-point method takes it; b (m,) is the right-hand side of the balance."""

    rows: Rows
    limits: Limits
    friction: Friction
    ranges: Ranges
    objective: Objective
    b: Array


class Answers(NamedTuple):
    """Results: x (k, d), multipliers y (m + r,) of all rows, friction gauges (k,), residual (m,) of the balance."""

    x: Array
    y: Array
    gauge: Array
    residual: Array


class Scalars(NamedTuple):
    """Constant of the objective, largest diagonal entry of P, moment length [m], relative margin of active limits."""

    constant: float
    largest: float
    arm: float
    near: float


class Grasp(NamedTuple):
    """A grasp for one load after another, in newtons.

    Attributes:
        rows: balance and torque rows.
        limits: of single contacts.
        friction: the cone.
        P: blocks of the quadratic objective (k, d, d).
        q: linear objective (k, d).
        R_lo: least values of the torque rows (r,).
        R_hi: largest values of the torque rows (r,).
        correction: pseudoinverse of the balance (k d, m).
        widths: component over force in the contact's axes (k, d).
        grasp_matrix: contact forces to wrench (6, 3 k).
        normals: of the contacts (k, 3), world axes.
        scalars: single numbers.
    """

    rows: Rows
    limits: Limits
    friction: Friction
    P: Array
    q: Array
    R_lo: Array
    R_hi: Array
    correction: Array
    widths: Array
    grasp_matrix: Array
    normals: Array
    scalars: Scalars


# -- many problems ----------------------------------------------------------------------------------------------------


class Bulk(NamedTuple):
    """N problems of up to k contacts, of which the first ``counts`` (N,) count.

    Attributes:
        points: about the centres of mass (N, k, 3).
        rotations: contact frames (N, k, 3, 3).
        counts: numbers of contacts (N,).
        loads: external wrenches (N, 6).
        mu: friction coefficients over the safety factor (N, k).
        low: least F_n (N, k).
        high: largest F_n (N, k).
        arms: moment lengths (N,).
        terms: powers of F_n in the objective (N, t, 2): pairs (coefficient, exponent).
    """

    points: Array
    rotations: Array
    counts: IntArray
    loads: Array
    mu: Array
    low: Array
    high: Array
    arms: Array
    terms: Array


class BulkModel(NamedTuple):
    """What all problems share: rows of the balance, torsion [m] over the safety factor, weight of the sum of squared
    forces, radii and ``n_round`` of :class:`Cones`.
    """

    rows: int
    torsion: float
    squares: float
    radii: Array
    n_round: int


class BulkResults(NamedTuple):
    """Forces (N, k, 3), torsional moments (N, k); objective, lower bound, residual [N], violation [N], code (N,)."""

    forces: Array
    moments: Array
    objective: Array
    lower_bound: Array
    residual: Array
    violation: Array
    codes: IntArray

    @classmethod
    def of(cls, n: int, k: int) -> BulkResults:
        """Room for n problems of up to k contacts; zeros, and STALLED."""
        return cls(
            forces=np.zeros((n, k, 3)),
            moments=np.zeros((n, k)),
            objective=np.zeros(n),
            lower_bound=np.zeros(n),
            residual=np.zeros(n),
            violation=np.zeros(n),
            codes=np.full(n, STALLED),
        )


# -- tick by tick -----------------------------------------------------------------------------------------------------


class TickSettings(NamedTuple):
    """Of a loop: numbers of contacts, components, joints, rows of the balance and round components; torsion [m], moment
    length [m], safety factor, Newton steps of one try, change of shares per tick; number of couplings.
    """

    contacts: int
    components: int
    joints: int
    rows: int
    n_round: int
    torsion: float
    arm: float
    safety: float
    steps: int
    ramp: float
    couplings: int


class TickInputs(NamedTuple):
    """What a tick reads.

    Attributes:
        com: centre of mass (3,).
        rate: largest change of F_n in this tick (1,) [N].
        wrench: the load (6,).
        points: about the centre of mass (k, 3).
        rotations: contact frames (k, 3, 3).
        mu: friction coefficients (k,).
        least: least F_n (k,) [N].
        largest: largest F_n (k,) [N].
        share: of these that holds now (k,).
        target: what the share moves to (k,).
        torque_limit: of the joints (n,).
        couplings: combinations of the torques that no drive makes (p, n).
        coupled: what springs make of them (p,).
        borne: share of the contacts' torques on them that friction bears (1,).
    """

    com: Array
    rate: Array
    wrench: Array
    points: Array
    rotations: Array
    mu: Array
    least: Array
    largest: Array
    share: Array
    target: Array
    torque_limit: Array
    couplings: Array
    coupled: Array
    borne: Array


class TickOutputs(NamedTuple):
    """Forces (k, 3), torsional moments (k,), what is not balanced (6,), torques (n,); before a tick the last one's."""

    forces: Array
    moments: Array
    unbalanced: Array
    torques: Array


class TickRoom(NamedTuple):
    """Multipliers of the last tick (m,) [N]; the tick's problem, its solution x (d, k), y (m,), the unit of each
    component (d, k), friction coefficients over the safety factor (k,), scratch.
    """

    multipliers: Array
    balance: Balance
    quadratic: Quadratic
    cones: Cones
    x: Array
    y: Array
    widths: Array
    slip: Array
    work: Array


class Tick(NamedTuple):
    """All that a loop remembers, views of one array."""

    settings: TickSettings
    inputs: TickInputs
    outputs: TickOutputs
    room: TickRoom


class TorqueRows(NamedTuple):
    """Which torque rows there are, of joints and couplings; several contacts load the first ``shared`` of them.

    Attributes:
        shared: number of these.
        row_of: row of a joint, -1 for none (n,).
        own: as of :class:`Limits`.
        touched: as of :class:`Rows`.
        counts: as of :class:`Rows`.
        used: as of :class:`Limits`.
        pair_of: rows of a coupling, one for either side, -1 for none (p, 2).
    """

    shared: int
    row_of: IntArray
    own: IntArray
    touched: IntArray
    counts: IntArray
    used: IntArray
    pair_of: IntArray


class Hand(NamedTuple):
    """Jacobian (6 columns,) of the joints, column by column, world axes, linear velocity at the world's origin first;
    gravity (n,); links (p, 3): contact, column and joint, for each joint that moves a contact.
    """

    jacobian: Array
    gravity: Array
    links: IntArray
