"""A planned squeeze as a mechanism in equilibrium, whatever its contacts' stiffness and its drives turn out to be.

Let u = u* + B z - G^T x be the motions of the hand's contact points less those of the object's, from first touch, for
changes z of what yields in the hand, against the stiffness D, and x of the object from what was planned. In
equilibrium

    min over z, x of   sum of the contacts' elastic energies(u) + z^T D z / 2 - f*^T (B z - G^T x),

a convex function: f* are the planned forces, which the commands give and which balance the load; where drives make
only a share of the efforts that they are told, that share of f*^T B z counts. Contacts press with
f(u_z), that of the contact law, and stick with the tangential stiffness of their planned normal force. Where that asks
for more than friction allows, the tangential force is what friction allows along the same direction, and equilibrium is
found again.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from pinograsp.actuation.compliant_hand import CompliantHand, invert_stiffness, yielding_motions
from pinograsp.actuation.quasistatic import normal_stiffness
from pinograsp.checks import brief, instance_of, number
from pinograsp.contacts import Compliance
from pinograsp.errors import InvalidInput
from pinograsp.forces import TOLERANCE, ForceProblem, ForceSolution
from pinograsp.spatial import Array, BoolArray

_STEPS, _HALVINGS = 200, 40
# Friction is reduced to what there is in so many parts, each of so many steps, halved so often.
_REDUCTIONS, _SLIP_STEPS, _SLIP_HALVINGS = 8, 25, 12
_SETTLED = 1e-10  # of the forces' sizes, in each motion: well below what counts as balanced
_DAMPING = 1e-11  # relative: steps stay finite along motions that nothing resists
_SLIPPERY = 1e3  # times the friction there is, from which on it is reduced
NEGLIGIBLE = 1e-6  # of the largest force: contacts that were not planned to press


class Settled(NamedTuple):
    """An equilibrium: forces (k, 3) [N], motions (p,) of what yields and of the object, and whether it is one."""

    forces: Array
    moved: Array
    balanced: bool

    @property
    def shift(self) -> Array:
        """The object's motion (6,), a twist [m, rad]."""
        return self.moved[-6:]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Squeeze:
    """A squeeze as it was planned, and how hand and object may move from there.

    ``motions`` (3k, p): u per unit of what yields, then of the object's twist; ``yielding`` (p, p): stiffness against
    them without the contacts; ``stretch`` (k, 2): tangential motions that give the planned forces [m]; ``efforts``
    (p,): what the drives make of what is commanded, share of it, 1 along all other motions [-].
    """

    problem: ForceProblem
    torsion: Array
    planned: Array
    ratio: float
    stretch: Array
    motions: Array
    yielding: Array
    efforts: Array

    __repr__ = brief()

    @classmethod
    def of(cls, solution: ForceSolution, hand: CompliantHand, tangential_ratio: float) -> Squeeze:
        """The squeeze of a solution by a hand; :class:`InvalidInput` where they do not go together."""
        instance_of("solution", solution, ForceSolution)
        instance_of("hand", hand, CompliantHand)
        if not solution.found:
            raise InvalidInput("solution: expected one with forces, got one without: see its status and infeasibility")
        problem = solution.problem
        if hand.k != problem.k:
            raise InvalidInput(f"hand: expected the Jacobian of {problem.k} contacts, got that of {hand.k}")
        ratio = number("tangential stiffness ratio", tangential_ratio, at_least=0)
        planned = np.array(solution.forces_c)
        planned[:, 2] = np.maximum(planned[:, 2], 0.0)
        stiff = ratio * normal_stiffness(problem.compliance, planned[:, 2])[:, None]
        largest = float(np.abs(planned).max())
        if not largest > 0:
            raise InvalidInput("solution: expected forces that press, got none: there is no squeeze to analyse")
        if np.any((stiff == 0) & (np.abs(planned[:, :2]) > NEGLIGIBLE * largest)):
            raise InvalidInput(
                "tangential forces: expected none where contacts have no tangential stiffness, got "
                f"{np.abs(planned[:, :2]).max():.3g} N: give tangential_ratio > 0, or plan without friction"
            )
        motions, yielding = cls._assemble_motions(problem, hand)
        return cls(
            problem=problem,
            torsion=np.array(solution.torsion) if len(solution.torsion) else np.zeros(problem.k),
            planned=planned,
            ratio=ratio,
            stretch=np.divide(planned[:, :2], stiff, out=np.zeros((problem.k, 2)), where=stiff > 0),
            motions=motions,
            yielding=yielding,
            efforts=np.ones(len(yielding)),
        )

    @staticmethod
    def _assemble_motions(problem: ForceProblem, hand: CompliantHand) -> tuple[Array, Array]:
        Z, D = yielding_motions(hand)
        p = len(D)
        yielding = np.zeros((p + 6, p + 6))
        yielding[:p, :p] = D
        return np.hstack([hand.jacobian @ Z, -problem.contacts.G.T]), yielding

    def with_hand(self, hand: CompliantHand) -> Squeeze:
        """The same squeeze by a hand that yields otherwise."""
        motions, yielding = self._assemble_motions(self.problem, hand)
        return replace(self, motions=motions, yielding=yielding, efforts=np.ones(len(yielding)))

    def with_drives(self, hand: CompliantHand, shares: Array) -> Squeeze:
        """The same commands to the hand's drives, where these make ``shares`` (m,) of each effort, at any motion."""
        own = np.sqrt(shares)
        gains = own[:, None] * hand.gains * own if hand.gains.ndim == 2 else shares * hand.gains
        squeeze = self.with_hand(replace(hand, gains=gains))
        squeeze.efforts[: hand.yielding.sum()] = shares[hand.yielding]
        return squeeze

    def stiffness(self, factor: float) -> Array:
        """K_c (3k, 3k) [N/m] at the planned forces, where contacts press ``factor`` times as much as in the plan."""
        normal = normal_stiffness(self.problem.compliance.scale(factor), self.planned[:, 2])
        return np.diag(np.column_stack([self.ratio * normal, self.ratio * normal, normal]).ravel())

    @property
    def pull(self) -> Array:
        """What the commands and the load pull with along each motion (p,) [N m or N]."""
        return np.asarray(self.efforts * (self.motions.T @ self.planned.ravel()))

    def settle(self, factor: float) -> Settled:
        """The equilibrium where contacts press ``factor`` times as much, by Newton's method on the energy."""
        law, k, T = self.problem.compliance.scale(factor), self.problem.k, self.motions
        across = np.diag(self.stiffness(factor)).reshape(k, 3)[:, :2]
        start = np.column_stack([self.stretch, self.problem.compliance.depth(self.planned[:, 2])])
        pull = self.pull

        def forces(v: Array) -> tuple[float, Array, Array]:
            """Energy [J] without its constants, forces (k, 3) [N] and depths (k,) [m]."""
            u = start + (T @ v).reshape(k, 3)
            depth = np.maximum(u[:, 2], 0.0)
            f = np.column_stack([across * u[:, :2], law.force(depth)])
            stored = law.energy(depth).sum() + (across * u[:, :2] ** 2).sum() / 2
            return float(stored + v @ self.yielding @ v / 2 - pull @ v), f, depth

        size = np.abs(T).sum(axis=0) * np.abs(self.planned).max()
        usual = np.diag(T.T @ self.stiffness(factor) @ T + self.yielding)
        scale = np.divide(1.0, np.sqrt(usual), out=np.zeros(len(usual)), where=usual > 0)
        v = np.zeros(len(usual))
        energy, f, depth = forces(v)
        gradient = T.T @ f.ravel() + self.yielding @ v - pull
        for _ in range(_STEPS):
            if np.all(np.abs(gradient) <= _SETTLED * size):
                break
            slope = law.slope(depth) * (depth > 0)
            springs = np.column_stack([across, slope]).ravel()
            hessian = scale[:, None] * ((T.T * springs) @ T + self.yielding) * scale
            step = -scale * np.linalg.solve(hessian + _DAMPING * np.eye(len(v)), scale * gradient)
            falls, part, before, was = float(gradient @ step), 1.0, v, energy
            for _ in range(_HALVINGS):
                v = before + part * step
                energy, f, depth = forces(v)
                gradient = T.T @ f.ravel() + self.yielding @ v - pull
                # The energy is convex: where it still falls along the step it has fallen all the way.
                if gradient @ step <= 0 or energy <= was + 1e-4 * part * falls:
                    break
                part /= 2
        balanced = bool(np.all(np.abs(gradient) <= TOLERANCE.residual * size))
        stuck = Settled(forces=f, moved=v, balanced=balanced)
        share, within = self.friction(f)
        if not balanced or within.all():
            return stuck
        most = float(min(share.max(), _SLIPPERY))
        return self._find_slip(law, across, start, v, scale, size, most) or stuck

    # Seven arguments: what the equilibrium without slip was found from, and where it is.
    def _find_slip(
        self, law: Compliance, across: Array, start: Array, v: Array, scale: Array, size: Array, most: float
    ) -> Settled | None:
        """The equilibrium where contacts slip, by a semismooth Newton method from the one without, ``v`` (p,), which
        takes ``most`` times the friction; None where none is found.
        """
        T, k, pull = self.motions, self.problem.k, self.pull
        twisted = self.torsion_share

        def residual(v: Array, more: float) -> tuple[Array, Array, Array]:
            """What is left over (p,), forces (k, 3) [N] and their slopes (k, 3, 3) [N/m]."""
            u = start + (T @ v).reshape(k, 3)
            depth = np.maximum(u[:, 2], 0.0)
            normal, slope = law.force(depth), law.slope(depth) * (depth > 0)
            rest = np.sqrt(np.maximum(normal**2 - twisted**2, 0.0))
            mu = more * self.problem.mu
            tried = across * u[:, :2]
            length = np.linalg.norm(tried, axis=1)
            slips = length > mu * rest
            along = np.divide(tried, length[:, None], out=np.zeros_like(tried), where=length[:, None] > 0)
            kept = np.where(slips, np.divide(mu * rest, length, out=np.ones(k), where=slips), 1.0)
            slopes = np.zeros((k, 3, 3))
            slopes[:, 2, 2] = slope
            slopes[:, :2, :2] = (kept[:, None] * across)[:, :, None] * np.eye(2)
            slopes[:, :2, :2] -= (slips * kept * across[:, 0])[:, None, None] * along[:, :, None] * along[:, None]
            growth = np.divide(mu * normal, rest, out=np.zeros(k), where=rest > 0) * slope
            slopes[:, :2, 2] = (slips * growth)[:, None] * along
            f = np.column_stack([kept[:, None] * tried, normal])
            return T.T @ f.ravel() + self.yielding @ v - pull, f, slopes

        for more in np.geomspace(max(most, 1.0), 1.0, _REDUCTIONS).tolist():
            left, f, slopes = residual(v, more)
            for _ in range(_SLIP_STEPS):
                if np.all(np.abs(left) <= _SETTLED * size):
                    break
                pushed = np.einsum("kcd,kdp->kcp", slopes, T.reshape(k, 3, -1)).reshape(3 * k, -1)
                matrix = scale[:, None] * (T.T @ pushed + self.yielding) * scale + _DAMPING * np.eye(len(v))
                try:
                    step = -scale * np.linalg.solve(matrix, scale * left)
                except np.linalg.LinAlgError:
                    return None
                was, part, before = float(np.linalg.norm(scale * left)), 1.0, v
                for _ in range(_SLIP_HALVINGS):
                    v = before + part * step
                    left, f, slopes = residual(v, more)
                    if np.linalg.norm(scale * left) <= (1 - 1e-4 * part) * was:
                        break
                    part /= 2
                if part < 0.5 ** (_SLIP_HALVINGS - 1):
                    break  # at a standstill: further steps would only be halved as often
        # Whether it got there at larger friction does not matter: contacts that open make that hard, too.
        left, f, _ = residual(v, 1.0)
        balanced = bool(np.all(np.abs(left) <= TOLERANCE.residual * size))
        return Settled(forces=f, moved=v, balanced=True) if balanced else None

    def response(self, factor: float, settled: Settled) -> Array:
        """Change of the forces of an equilibrium per change of the planned ones (3k, 3k), to first order.

        As if all contacts stuck, with the tangential stiffness of the forces that were planned before.
        """
        law, k, T = self.problem.compliance, self.problem.k, self.motions
        depth = law.depth(self.planned[:, 2]) + (T @ settled.moved)[2::3]
        stiff = np.diag(self.stiffness(factor)).copy()
        stiff[2::3] = law.scale(factor).slope(depth) * (depth > 0)
        normal = normal_stiffness(law, np.maximum(self.planned[:, 2], NEGLIGIBLE * self.planned[:, 2].max()))
        assumed = np.column_stack([self.ratio * normal, self.ratio * normal, normal]).ravel()
        kept = np.diag(np.divide(stiff, assumed, out=np.zeros(3 * k), where=assumed > 0))
        unmet = self.efforts[:, None] * T.T - T.T @ kept
        yielded = invert_stiffness((T.T * stiff) @ T + self.yielding) @ unmet
        return np.asarray(kept + stiff[:, None] * (T @ yielded))

    @property
    def torsion_share(self) -> Array:
        """Normal force that soft fingers need for their moments alone (k,) [N]; 0 for other models."""
        friction = self.problem.friction
        if not friction.elliptic:
            return np.zeros(self.problem.k)
        return np.asarray(np.abs(self.torsion) / friction.torsion, dtype=float)

    def friction(self, forces: Array) -> tuple[Array, BoolArray]:
        """Share of its friction that each contact uses (k,) [-], and whether that is within it (k,) bool."""
        planned = self.problem.friction
        # Pyramids stand for round cones.
        model = replace(planned, safety=1.0, model="cone" if planned.polyhedral else planned.model)
        across = np.column_stack([forces[:, :2], self.torsion])[:, : model.d - 1]
        allowed = model.scale(self.problem.mu)
        rounding = TOLERANCE.violation * float(max(np.abs(forces).max(), np.abs(self.planned).max()))
        needed = model.gauge(np.divide(across, allowed, out=np.zeros_like(across), where=allowed > 0))
        needed[np.any((allowed == 0) & (np.abs(across) > rounding), axis=1)] = np.inf
        normal = forces[:, 2]
        share = np.divide(needed, normal, out=np.where(needed > rounding, np.inf, 0.0), where=normal > rounding)
        return share, needed <= normal + rounding

    def remarks(self, settled: Settled) -> list[str]:
        """Why the object is not held there, in words; empty where it is."""
        problem, names, found = self.problem, self.problem.contacts.names, list[str]()
        if not settled.balanced:
            found.append("no equilibrium")
        share, within = self.friction(settled.forces)
        found += [f"{names[i]} slips: {share[i]:.3g} of its friction" for i in np.flatnonzero(~within)]
        normal = settled.forces[:, 2]
        if problem.max_normal_force is not None:
            cap = problem.max_normal_force
            over = np.flatnonzero(normal > cap * (1 + TOLERANCE.violation))
            found += [f"{names[i]} presses with {normal[i]:.4g} N, more than {cap[i]:.4g}" for i in over]
        if problem.torques is not None:
            rotations = problem.contacts.rotations_oc
            moments = self.torsion[:, None] * rotations[:, :, 2]
            torques = np.abs(problem.torques.torques(np.einsum("kxc,kc->kx", rotations, settled.forces), moments))
            limit = problem.torques.limit
            over = np.flatnonzero(torques > limit * (1 + TOLERANCE.active))
            found += [
                f"{problem.torques.joints[j]} needs a torque of {torques[j]:.4g}, more than {limit[j]:.4g}"
                for j in over
            ]
        return found
