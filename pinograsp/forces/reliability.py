"""How probably contacts hold a load when friction, load and contacts are not quite what the plan says.

Every sample is a force problem of its own, all are solved at once (:func:`~pinograsp.forces.solve_batch`). Seconds here
are hours of simulation; what moves, rolls or shakes only the simulation knows (:func:`~pinograsp.referee.monte_carlo`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from pinograsp.checks import array_of, brief, instance_of, integer, number, read_only, shown
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces.batch import ForceBatch, solve_batch
from pinograsp.forces.problem import ForceProblem


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reliability:
    """What came of random errors.

    Attributes:
        held: which samples have forces (count,) bool.
        undecided: how many have neither forces nor a proof that there are none.
        normal_forces: F_n of each sample (count, k) [N]; zeros where there are none.
        mu (count, k), loads (count, 6) [N, N m], points_o (count, k, 3) [m], normals_o (count, k, 3): as drawn.
    """

    held: np.ndarray
    undecided: int
    normal_forces: np.ndarray
    mu: np.ndarray
    loads: np.ndarray
    points_o: np.ndarray
    normals_o: np.ndarray

    __repr__ = brief()

    @property
    def probability(self) -> float:
        """Share that can be held."""
        return float(self.held.mean())

    @property
    def interval(self) -> tuple[float, float]:
        """95 % confidence interval of the probability (Wilson's score); undecided samples count as lost."""
        from scipy.stats import binomtest  # slow to import

        low, high = binomtest(int(self.held.sum()), len(self.held)).proportion_ci(0.95, method="wilson")
        return float(low), float(high)

    def squeeze(self, share: float = 0.95) -> np.ndarray:
        """F_n (k,) [N] that each contact's need exceeds in no more than 1 - ``share`` of the samples that hold."""
        if not self.held.any():
            raise InvalidInput("squeeze: none of the samples can be held")
        share = number("share", share, above=0, at_most=1)
        return read_only(np.quantile(self.normal_forces[self.held], share, axis=0))


_MOST = 10_000_000  # samples: more do not fit into the memory


def holding_probability(
    problem: ForceProblem,
    impact_time: float,
    *,
    normal_forces=None,
    friction: float = 0.1,
    load: float = 0.1,
    disturbance=None,
    points: float = 1e-3,
    normals: float = 0.05,
    count: int = 10_000,
    seed: int = 0,
) -> Reliability:
    """Sample errors and tell how often there are contact forces that hold.

    Args:
        problem: the contacts, load, friction (without its safety factor: errors are drawn here) and limits about which
            the errors are.
        impact_time: t_I [s].
        normal_forces: what the hand squeezes with (k,) [N], whatever happens: friction alone reacts. A strict view:
            fingers that give let the object settle, so a simulation holds more. None: the hand knows the errors and
            adapts, within the problem's range of F_n.
        friction: relative standard deviation of each contact's mu, never below zero.
        load: that of the load's size.
        disturbance: standard deviations (6,) of a wrench on top [N, N m]; default: none.
        points: standard deviation of the contact points in their tangent planes [m].
        normals: of the normals [rad].
        count: samples.
        seed: of the random numbers.

    Raises:
        InvalidInput: torque limits, errors that are negative.
        ExtraMissing: numba (extra ``fast``) is not installed.
    """
    instance_of("problem", problem, ForceProblem)
    count, seed = integer("count", count, at_least=1, at_most=_MOST), integer("seed", seed, at_least=0)
    friction, load = number("error of friction", friction, at_least=0), number("error of load", load, at_least=0)
    points = number("error of points", points, at_least=0, unit="m")
    normals = number("error of normals", normals, at_least=0)
    spread = np.zeros(6) if disturbance is None else array_of("disturbance", disturbance, (6,))
    if np.any(spread < 0):
        raise InvalidInput(f"disturbance: expected six standard deviations >= 0, got {shown(spread.tolist())}")
    if problem.torques is not None:
        raise InvalidInput("holding_probability: torque limits are not part of it; give normal_forces that keep them")
    rng, contacts, k = np.random.default_rng(seed), problem.contacts, problem.k
    low, high = problem.normal_force_range(problem.checked_impact_time(impact_time))
    if normal_forces is not None:
        low = high = array_of("normal forces", normal_forces, (k,))
        if np.any(low < 0):
            raise InvalidInput(f"normal forces: expected values >= 0 [N], got {shown(low.tolist())}")
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
    found = solve_batch(batch, objective="work" if problem.friction.model == "soft" else "least_squares")
    return Reliability(
        held=read_only(found.ok),
        undecided=int((found.status == Status.INACCURATE).sum()),
        normal_forces=read_only(found.forces_c[:, :, 2]),
        mu=read_only(mu),
        loads=read_only(loads),
        points_o=read_only(moved),
        normals_o=read_only(rotations[:, :, :, 2]),
    )
