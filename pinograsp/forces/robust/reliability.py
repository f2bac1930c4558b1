"""The probability that contacts hold a load when friction, load and contacts differ from the plan at random.

Every sample is a force problem of its own; all are solved as one batch (:func:`~pinograsp.forces.solve_batch`), in
seconds instead of the hours of a simulation. Motion, rolling and vibration are left to the simulation
(:func:`~pinograsp.simulation.monte_carlo`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pinograsp.checks import array_of, at_least_zero, brief, instance_of, integer, number, read_only, shorten
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.solve.batch import ForceBatch, solve_batch
from pinograsp.spatial import Array, BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reliability:
    """Samples of random errors, and whether contact forces hold under each.

    Attributes:
        held: which samples have forces (count,) bool.
        undecided: number of samples with neither forces nor a proof that there are none.
        normal_forces: F_n of each sample (count, k) [N]; zeros if there are none.
        mu: friction coefficients, as drawn (count, k) [-].
        loads: as drawn (count, 6) [N, N m].
        points_o: contact points, as drawn (count, k, 3) [m].
        normals_o: contact normals, as drawn (count, k, 3) [-].
    """

    held: BoolArray
    undecided: int
    normal_forces: Array
    mu: Array
    loads: Array
    points_o: Array
    normals_o: Array

    __repr__ = brief()

    @property
    def probability(self) -> float:
        """Share of the samples that can be held."""
        return float(self.held.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability (Wilson's score); undecided samples count as not held."""
        from scipy.stats import binomtest  # slow to import

        low, high = binomtest(int(self.held.sum()), len(self.held)).proportion_ci(0.95, method="wilson")
        return float(low), float(high)

    def squeeze(self, share: float = 0.95) -> Array:
        """F_n (k,) [N] of each contact that suffices in ``share`` of the samples that hold."""
        if not self.held.any():
            raise InvalidInput("squeeze: none of the samples can be held")
        share = number("share", share, above=0, at_most=1)
        return read_only(np.quantile(self.normal_forces[self.held], share, axis=0))


_MOST = 10_000_000  # samples: more do not fit into memory


def holding_probability(
    problem: ForceProblem,
    impact_time: float,
    *,
    normal_forces: ArrayLike | None = None,
    friction: float = 0.1,
    load: float = 0.1,
    disturbance: ArrayLike | None = None,
    points: float = 1e-3,
    normals: float = 0.05,
    count: int = 10_000,
    seed: int = 0,
) -> Reliability:
    """Sample errors and count how often contact forces hold the load.

    Args:
        problem: nominal contacts, load, friction and limits; the safety factor of friction is not used, as errors are
            drawn here.
        impact_time: t_I [s].
        normal_forces: fixed F_n of the hand (k,) [N]: friction alone reacts. This is strict: compliant fingers let the
            object settle, so a simulation holds more. None: the hand knows the errors and adapts F_n within the
            problem's range.
        friction: relative standard deviation of each contact's mu, which is never below zero.
        load: relative standard deviation of the load's size.
        disturbance: standard deviations (6,) of an additional wrench [N, N m]; default: none.
        points: standard deviation of the contact points in their tangent planes [m].
        normals: standard deviation of the normals [rad].
        count: number of samples.
        seed: of the random numbers.

    Raises:
        InvalidInput: a problem with torque limits, or negative standard deviations.
        ExtraMissing: the compiled core is not installed.
    """
    instance_of("problem", problem, ForceProblem)
    count, seed = integer("count", count, at_least=1, at_most=_MOST), integer("seed", seed, at_least=0)
    friction, load = number("error of friction", friction, at_least=0), number("error of load", load, at_least=0)
    points = number("error of points", points, at_least=0, unit="m")
    normals = number("error of normals", normals, at_least=0)
    spread = np.zeros(6) if disturbance is None else array_of("disturbance", disturbance, (6,))
    if np.any(spread < 0):
        raise InvalidInput(f"disturbance: expected six standard deviations >= 0, got {shorten(spread.tolist())}")
    if problem.torques is not None:
        raise InvalidInput("holding_probability: torque limits are not part of it; give normal_forces that keep them")
    rng, contacts, k = np.random.default_rng(seed), problem.contacts, problem.k
    low, high = problem.normal_force_range(problem.checked_impact_time(impact_time))
    if normal_forces is not None:
        low = high = at_least_zero("normal forces", array_of("normal forces", normal_forces, (k,)))
    mu = problem.mu * np.maximum(0.0, 1.0 + friction * rng.normal(size=(count, k)))
    loads = problem.load * (1.0 + load * rng.normal(size=(count, 1))) + spread * rng.normal(size=(count, 6))
    along, tilts = points * rng.normal(size=(count, k, 2)), normals * rng.normal(size=(count, k, 2))
    frames = contacts.rotations_oc
    moved = contacts.points_o + np.einsum("kij,nkj->nki", frames[:, :, :2], along)
    turns = np.einsum("kij,nkj->nki", frames[:, :, :2], tilts)
    rotations = Rotation.from_rotvec(turns.reshape(-1, 3)).as_matrix().reshape(count, k, 3, 3) @ frames
    batch = ForceBatch(
        points=moved - contacts.com_o,
        rotations=rotations,
        loads=loads,
        mu=mu,
        low=low,
        high=high,
        friction=replace(problem.friction, safety=1.0),
        balance=problem.balance,
        moment_lengths=problem.moment_length,
        energies={"work": np.array(problem.energy_terms(impact_time, "work"))},
    )
    # Soft fingers' least squares would go to the general methods.
    found = solve_batch(batch, objective="work" if problem.friction.elliptic else "least_squares")
    return Reliability(
        held=read_only(found.ok),
        undecided=int((found.status == Status.INACCURATE).sum()),
        normal_forces=read_only(found.forces_c[:, :, 2]),
        mu=read_only(mu),
        loads=read_only(loads),
        points_o=read_only(moved),
        normals_o=read_only(rotations[:, :, :, 2]),
    )
