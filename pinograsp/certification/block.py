"""A block of grasps on their way to their certificates: contacts, forces, verdicts, as arrays."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from pinograsp.certification.elastic import Reactions, factors
from pinograsp.certification.record import FAR_OFF, Certificates
from pinograsp.certification.squeeze import (
    Forces,
    Grips,
    Holding,
    as_much_as_can_be,
    held,
    least_mu,
    pressing,
    squeezed,
)
from pinograsp.checks import flag, instance_of, integer, number, read_only
from pinograsp.contacts import Friction
from pinograsp.contacts.bulk import BulkContacts, BulkScene
from pinograsp.contacts.contact_set import bare_contacts
from pinograsp.contacts.friction import CONE, SOFT
from pinograsp.contacts.support import CORNERS
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import GraspConditions, Reserve
from pinograsp.forces.reserve import least_squeeze
from pinograsp.hands import HandModel
from pinograsp.hands.drives import ratios_of
from pinograsp.hands.efforts import exceed_ways
from pinograsp.motion import effort_of
from pinograsp.motion.producible import HARDLY, JOINTS, SHIFTS
from pinograsp.motion.torques import DRY_FRICTION
from pinograsp.objects.body import Body, tangents
from pinograsp.spatial import Array, BoolArray, IntArray

_Scalar = TypeVar("_Scalar", bound=np.generic)

_NEAR = 1e-9  # of shares: rounding
_BEYOND = 0.02  # [rad or, times the lever, m] beyond a limit that is the data set's carelessness: put on the limit
# Motions that close gaps as a matter of course [rad; m with the lever], and what may be left of a gap [m].
_REACH, _LEVER, _OPEN = 0.1, 0.03, 3e-4
_UNMADE = 0.2  # share of the depths that the hand's joints cannot choose: more is not what it makes


class Asked:
    """A hand, an object and what is asked of its grasps; arguments as of :func:`~pinograsp.certification.certify`."""

    def __init__(
        self,
        hand: HandModel,
        body: Body,
        conditions: GraspConditions,
        tolerance: float,
        *,
        palm: bool,
        patches: bool,
        exact: bool,
        drives: bool,
        threads: int | None,
    ):
        instance_of("hand", hand, HandModel)
        instance_of("body", body, Body)
        instance_of("conditions", conditions, GraspConditions)
        threads = None if threads is None else integer("threads", threads, at_least=1)
        if conditions.balance != "wrench":
            raise InvalidInput(
                "conditions: expected balance='wrench': a free object turns where moments are not balanced"
            )
        if conditions.reserve is not None and conditions.reserve.stiffness_factors:
            raise InvalidInput(
                "conditions: expected a reserve with softer=1 and stiffer=1: servos are not looked at here"
            )
        self.hand, self.body, self.conditions = hand, body, conditions
        self.tolerance = number("tolerance", tolerance, at_least=1e-7, unit="m")
        self.palm, self.patches = flag("palm", palm), flag("patches", patches)
        self.exact, self.drives = flag("exact", exact), flag("drives", drives)
        self.threads = threads
        self.scene = BulkScene(hand, body)
        self.fingers = self.scene.fingers
        pressing = np.concatenate([finger.dofs for finger in hand.fingers])
        self.idle = np.setdiff1d(np.arange(hand.n), pressing)
        self.limit = effort_of(hand, conditions.torque_limit)
        self.reserve = Reserve.none() if conditions.reserve is None else conditions.reserve
        weight = np.concatenate([body.mass * conditions.gravity_o, np.zeros(3)])
        self.wrenches = self.reserve.load_set(body, conditions.gravity_o).loads - weight
        self.wrenches = self.wrenches[np.abs(self.wrenches).max(axis=1) > 0]
        law = conditions.compliance
        cap = np.inf if conditions.max_normal_force is None else conditions.max_normal_force
        deepest = float(law.force(conditions.max_depth))
        self.holding = Holding(friction=CONE, mu=conditions.mu, weight=weight, cap=min(cap, deepest))
        ratios = () if hand.direct_drive else ratios_of(hand.joint_names, hand.drives)
        self.ratios = np.array([ratio.row for ratio in ratios]).reshape(-1, hand.n)


class Block:
    """Some postures on their way to their verdicts; arrays as in :class:`Certificates`."""

    def __init__(self, asked: Asked, q: Array, roots: Array):
        hand, count = asked.hand, len(q)
        allowed = _BEYOND * np.where(hand.slides, _LEVER, 1.0)
        self.beyond = ((q < hand.lower - allowed) | (q > hand.upper + allowed)).any(axis=1)
        self.own, self.q, self.roots = asked, np.clip(q, hand.lower, hand.upper), roots
        self.reason = np.full(count, Status.HELD.code)
        self.elapsed = {"contacts": 0.0, "forces": 0.0, "friction": 0.0}
        self.torques, self.reserve, self.weakest = np.zeros((count, hand.n)), np.zeros(count), np.zeros((count, 6))
        self.least_mu, self.largest_load = np.full(count, np.inf), np.zeros(count)
        self.effort, self.unproducible, self.residual = np.zeros(count), np.zeros(count), np.zeros(count)

    @contextmanager
    def _timed(self, stage: str) -> Iterator[None]:
        started = time.perf_counter()
        yield
        self.elapsed[stage] += time.perf_counter() - started

    def find_contacts(self) -> None:
        """Where each posture touches, as padded arrays of contacts (N, k)."""
        own = self.own
        with self._timed("contacts"):
            found = own.scene.contacts(self.q, self.roots, tolerance=own.tolerance, gravity_o=own.conditions.gravity_o)
            self.depth, self.failed = found.depth, found.failed
            self.collision, self.gravity_torques = found.collision, found.gravity_torques
            off = ~self.beyond & (self.depth == 0) & (np.bincount(found.grasp, minlength=len(self.q)) == 0)
            every = np.arange(len(own.scene.parts))
            self.depth[off] = -own.scene.gaps(self.q[off], self.roots[off], every, FAR_OFF)
            self._pack(found)

    def _pack(self, found: BulkContacts) -> None:
        """Touches of fingers and palm that can be at once as contacts, one at each corner of an area."""
        own = self.own
        fingers = own.fingers[found.part]
        self.touches = np.flatnonzero((fingers >= 0) if own.palm else (fingers > 0))
        corners = found.counts[self.touches] if own.patches else np.ones(len(self.touches), dtype=np.int64)
        touch = np.repeat(self.touches, corners)
        corner = np.arange(len(touch)) - np.repeat(np.cumsum(corners) - corners, corners)
        self._fill(found, touch, corner)
        if (open_ := self._stays_open()).any():
            slot = np.arange(len(touch)) - np.repeat(np.cumsum(self.counts) - self.counts, self.counts)
            kept = ~open_[found.grasp[touch], slot]
            self._fill(found, touch[kept], corner[kept])
        self._pair(found)

    def _fill(self, found: BulkContacts, touch: IntArray, corner: IntArray) -> None:
        """Contacts at corners of touches, as padded arrays."""
        own, count, grasp = self.own, len(self.q), found.grasp[touch]
        fingers = own.fingers[found.part]
        self.counts = np.bincount(grasp, minlength=count)
        slot = np.arange(len(touch)) - np.repeat(np.cumsum(self.counts) - self.counts, self.counts)
        shape = count, max(int(self.counts.max(initial=0)), 1)

        def padded(values: NDArray[_Scalar]) -> NDArray[_Scalar]:
            result: NDArray[_Scalar] = np.zeros((*shape, *values.shape[1:]), dtype=values.dtype)
            result[grasp, slot] = values
            return result

        points = found.corners_o[touch, corner] if own.patches else _middles(found)[touch]
        arms = points - found.points_o[touch]
        J = found.jacobians_o[touch]
        J[:, :3] += np.cross(J[:, 3:], arms[:, :, None], axis=1)
        normals = found.normals_o[touch]
        frames = np.concatenate([tangents(normals), normals[:, :, None]], axis=2)
        self.used = np.arange(shape[1]) < self.counts[:, None]
        leaning = found.leaning[touch, corner] if own.patches else np.zeros(len(touch))
        self.points_o, self.gaps, self.jacobians = padded(points), padded(found.gap[touch] + leaning), padded(J)
        # What closes the gap that leaning faces leave.
        law = own.conditions.compliance
        self.closing = padded(law.force(leaning))
        self.rotations = padded(frames)
        self.rotations[~self.used] = np.eye(3)
        self.links = padded(own.scene.link_of[found.part[touch]])
        touched = np.zeros((count, own.fingers.max() + 2), dtype=bool)
        touched[grasp, fingers[touch]] = True
        self.touched = touched.sum(axis=1)

    def _motions(self) -> tuple[Array, Array]:
        """How joints (N, k, n) and the object's shift (N, k, 6), turns times the arm, bring contacts closer."""
        own = self.own
        normals = self.rotations[..., 2] * self.used[..., None]
        moves = np.einsum("nkxj,nkx->nkj", self.jacobians[:, :, :3], normals)
        moves[..., own.idle] = 0.0
        arms = (self.points_o - own.body.com_o) * self.used[..., None]
        arm = np.sqrt(np.einsum("nkx,nkx->n", arms, arms) / np.maximum(self.counts, 1))
        turned = np.cross(arms, normals) / np.maximum(arm, HARDLY)[:, None, None]
        return moves, np.concatenate([normals, turned], axis=2)

    def _stays_open(self) -> BoolArray:
        """Which contacts (N, k) are off the surface and cannot come to it while the others stay there.

        The gaps that are left by the least motion of joints and object, as far as such motions go.
        """
        moves, shifts = self._motions()
        B = np.concatenate([moves * _REACH, shifts * _REACH * _LEVER], axis=2) / _OPEN
        left = _left(B, self.gaps)
        return np.asarray((left > _OPEN) & self.used, dtype=bool)

    def _pair(self, found: BulkContacts) -> None:
        """Of grasps by two links: tan of the largest angle between a normal and the line through both touches."""
        touch = self.touches
        grasp = found.grasp[touch]
        two = np.flatnonzero(np.bincount(grasp, minlength=len(self.q)) == 2)
        first = touch[np.searchsorted(grasp, two)]
        second = touch[np.searchsorted(grasp, two) + 1]
        middle = _middles(found)
        line = middle[second] - middle[first]
        size = np.linalg.norm(line, axis=1)
        along = np.stack([np.einsum("tx,tx->t", line, found.normals_o[i]) for i in (first, second)])
        cosine = np.minimum(along[0], -along[1]) / np.where(size > 0, size, 1.0)
        self.antipodal_mu = np.full(len(self.q), np.inf)
        facing = cosine > 0
        self.antipodal_mu[two[facing]] = np.sqrt(np.maximum(1.0 / cosine[facing] ** 2 - 1.0, 0.0))

    def find_forces(self) -> None:
        """The squeeze of each grasp that touches with two links or more."""
        own = self.own
        shape, given = self.points_o.shape[:2], own.conditions.friction
        self.local = np.zeros((*shape, 4))  # x, y, torsion, normal
        self.squeezed, self.weight_held = np.zeros(len(self.q), dtype=bool), np.zeros(len(self.q), dtype=bool)
        self.status = np.full(len(self.q), Status.INFEASIBLE, dtype=object)
        touching = self.touched >= 2
        few = self.touched <= 2
        groups = [(given, touching)] if given is not None else [(CONE, touching & ~few), (SOFT, touching & few)]
        for friction, which in groups:
            chosen = np.flatnonzero(which)
            if len(chosen):
                self._force(friction, chosen)

    def _force(self, friction: Friction, chosen: IntArray) -> None:
        own = self.own
        com = own.body.com_o
        grips = Grips(
            points=(self.points_o[chosen] - com) * self.used[chosen][..., None],
            rotations=self.rotations[chosen],
            counts=self.counts[chosen],
            least=np.minimum(self.closing[chosen], own.holding.cap),
        )
        holding = replace(own.holding, friction=friction)
        with self._timed("forces"):
            plain = held(grips, holding, own.threads)
            squeeze, ways = squeezed(grips, holding, own.reserve, own.wrenches, own.threads)
            found = squeeze.found
            self.weight_held[chosen], self.squeezed[chosen] = plain.found | found, found
            self.status[chosen] = np.where(found | plain.found, Status.OK, plain.status)
            forces = np.where(found[:, None, None], squeeze.local, plain.local)
            weak = np.flatnonzero(plain.found & ~found & ways[0].borne.all(axis=1))
            if own.exact and len(weak):
                better = self._exactly(chosen[weak], grips.of(weak), holding)
                forces[weak] = np.where(better.found[:, None, None], better.local, forces[weak])
                self.squeezed[chosen[weak]] |= better.found
                self.reserve[chosen[weak[better.found]]] = 1.0
                weak = weak[~better.found]
            if len(weak):
                some = as_much_as_can_be(grips.of(weak), holding, own.reserve, own.wrenches, own.threads)
                forces[weak] = np.where(some.found[:, None, None], some.local, forces[weak])
            columns = [0, 1, 2, 3] if friction.d == 4 else [0, 1, 3]
            self.local[chosen[:, None], :, np.array(columns)] = np.swapaxes(forces, 1, 2)
            self.residual[chosen] = np.where(found, squeeze.residual, plain.residual)
            pressed = found | plain.found
            either = [factors(forces, one, grips.used, holding.friction, holding.mu) for one in ways]
            multiples = np.maximum(*either)
            self._margins(chosen[pressed], multiples[pressed])
            self._torques(chosen, plain, ways[0], friction)
        with self._timed("friction"):
            self.least_mu[chosen] = least_mu(grips, holding, own.threads)

    def _exactly(self, chosen: IntArray, grips: Grips, holding: Holding) -> Forces:
        """The least squeezes that bear the reserve, where the quick way finds none: a program each."""
        own = self.own
        conditions = replace(own.conditions, friction=holding.friction)
        normal = np.zeros(grips.used.shape)
        for row, (i, count) in enumerate(zip(chosen.tolist(), grips.counts.tolist())):
            contacts = bare_contacts(self.points_o[i, :count], self.rotations[i, :count], own.body.com_o)
            problem = conditions.problem(own.body, contacts)
            problem = replace(problem, min_normal_force=self.closing[i, :count])
            found = least_squeeze(problem, own.reserve)
            normal[row, :count] = 0.0 if found is None else found
        kept = holding.kept_back(own.reserve)
        forces = pressing(grips, kept, normal, own.threads)
        status = np.where((normal > 0).any(axis=1), forces.status, Status.INFEASIBLE)
        return Forces(status=status, local=forces.local, residual=forces.residual)

    def _margins(self, chosen: IntArray, multiples: Array) -> None:
        if not multiples.shape[1]:
            self.reserve[chosen] = np.inf
            return
        # At least what a program has proven.
        self.reserve[chosen] = np.maximum(self.reserve[chosen], multiples.min(axis=1))
        self.weakest[chosen] = self.own.wrenches[multiples.argmin(axis=1)]

    def _torques(self, chosen: IntArray, plain: Forces, reacted: Reactions, friction: Friction) -> None:
        """Holding torques, their largest share of a limit under all loads, and the load that the limits allow."""
        own = self.own
        columns = self._torque_columns(chosen, friction)
        bias = self.gravity_torques[chosen]
        forces = self.local[chosen][..., [0, 1, 2, 3] if friction.d == 4 else [0, 1, 3]]
        tau = bias + np.einsum("nkdj,nkd->nj", columns, forces)
        self.torques[chosen] = tau
        change = np.concatenate([reacted.tangential, reacted.normal[:, :, None]], axis=2)
        added = np.einsum("nkdj,nkdm->nmj", columns, change)
        usable = own.limit * (1.0 - own.reserve.torque)
        limited = np.isfinite(own.limit)
        most = np.abs(tau[:, None] + added).max(axis=1, initial=0.0)
        self.effort[chosen] = (np.maximum(most, np.abs(tau)) / usable)[:, limited].max(axis=1, initial=0.0)
        alone = np.einsum("nkdj,nkd->nj", columns, plain.local)
        room = np.where(alone > 0, own.limit - bias, own.limit + bias)
        with np.errstate(divide="ignore", invalid="ignore"):
            multiples = np.where(np.abs(alone) > 1e-12, np.maximum(room, 0.0) / np.abs(alone), np.inf).min(axis=1)
            pressed = plain.local[..., -1].max(axis=1)
            multiples = np.minimum(multiples, np.where(pressed > 0, own.holding.cap / pressed, np.inf))
        self.largest_load[chosen] = np.where(plain.found, multiples * own.holding.size, 0.0)

    def _torque_columns(self, chosen: IntArray, friction: Friction) -> Array:
        """Joint torques per unit of the contact components (N, k, d, n)."""
        J, R = self.jacobians[chosen], self.rotations[chosen]
        found = np.einsum("nkxj,nkxc->nkcj", J[:, :, :3], R)
        if friction.d == 4:
            turning = np.einsum("nkxj,nkx->nkj", J[:, :, 3:], R[..., 2])
            found = np.concatenate([found[:, :, :2], turning[:, :, None], found[:, :, 2:]], axis=2)
        found *= self.used[chosen][:, :, None, None]
        return np.asarray(found, dtype=float)

    def judge(self) -> None:
        """The reason of each grasp, the first that applies."""
        self.unproducible = self._unproducible()
        self.producible = (self.unproducible <= _UNMADE) & ~self._beyond_drives() & self.weight_held
        undecided = ~self.weight_held & (self.status != Status.INFEASIBLE)
        for status, where in (
            (Status.DRIVES, ~self.producible & self.own.drives),
            (Status.TORQUE, self.effort > 1 + _NEAR),
            (Status.RESERVE, ~self.squeezed),
            (Status.FRICTION, ~self.weight_held & np.isfinite(self.least_mu)),
            (Status.NO_FORCES, ~self.weight_held & ~np.isfinite(self.least_mu)),
            (Status.UNDECIDED, undecided),
            (Status.NO_CONTACT, self.touched < 2),
            (Status.SELF_COLLISION, self.collision >= 0),
            (Status.PENETRATES, self.depth > 0),
            (Status.GEOMETRY_FAILED, self.failed),
            (Status.JOINT_LIMIT, self.beyond),
        ):
            self.reason[where] = status.code

    def _unproducible(self) -> Array:
        """Share of the depths (N,) that neither the joints nor a shift of the object can choose.

        Of the depths d it is |(1 + B B^T)^-1 d| / |d|, where B has the motions of :func:`pressing_together
        <pinograsp.motion.pressing_together>` as columns, scaled likewise: what takes large motions does not count.
        """
        law = self.own.conditions.compliance
        depths = law.depth(np.maximum(self.local[..., 3], 0.0))
        moves, shifts = self._motions()
        sizes = np.linalg.norm(moves, axis=1, keepdims=True)
        moves = moves / (JOINTS * np.where(sizes > HARDLY, sizes, np.inf))
        left = _left(np.concatenate([moves, shifts / SHIFTS], axis=2), depths)
        size = np.linalg.norm(depths, axis=1)
        share: Array = np.where(size > 0, np.linalg.norm(left, axis=1) / np.where(size > 0, size, 1.0), 0.0)
        return share

    def _beyond_drives(self) -> BoolArray:
        """Which grasps (N,) need torques that drives of several joints or of one direction, or springs, do not make."""
        own, hand = self.own, self.own.hand
        wrong_way: BoolArray = exceed_ways(hand, self.q, self.torques).any(axis=1)
        if not len(own.ratios):
            return wrong_way
        made = np.zeros_like(self.q)
        for spring in hand.springs:
            joint = hand.joint_names.index(spring.joint)
            made[:, joint] -= spring.stiffness * (self.q[:, joint] - spring.rest)
        off = np.abs((self.torques - made) @ own.ratios.T)
        arms = np.linalg.norm(np.einsum("pj,nkxj->npkx", own.ratios, self.jacobians[:, :, :3]), axis=3)
        borne = DRY_FRICTION * np.einsum("npk,nk->np", arms, self.local[..., 3])
        return wrong_way | (off > borne + 1e-9).any(axis=1)

    def certificates(self) -> Certificates:
        """All of it, computed."""
        self.find_contacts()
        self.find_forces()
        self.judge()
        own = self.own
        forces = np.einsum("nkxc,nkc->nkx", self.rotations, self.local[..., [0, 1, 3]])
        return Certificates(
            hand=own.hand,
            object=own.body,
            conditions=own.conditions,
            q=read_only(self.q),
            roots=read_only(self.roots),
            reason=read_only(self.reason),
            counts=read_only(self.counts),
            links=read_only(self.links),
            link_names=tuple(own.scene.links),
            points_o=read_only(self.points_o),
            normals_o=read_only(self.rotations[..., 2] * self.used[..., None]),
            gaps=read_only(self.gaps),
            forces_o=read_only(forces),
            torsion=read_only(self.local[..., 2]),
            torques=read_only(self.torques),
            reserve=read_only(self.reserve),
            weakest=read_only(self.weakest),
            least_mu=read_only(self.least_mu),
            antipodal_mu=read_only(self.antipodal_mu),
            largest_load=read_only(self.largest_load),
            effort=read_only(self.effort),
            producible=read_only(self.producible & (self.effort <= 1 + _NEAR)),
            unproducible=read_only(self.unproducible),
            residual=read_only(self.residual),
            depth=read_only(self.depth),
            elapsed=self.elapsed,
        )


def _left(B: Array, wanted: Array) -> Array:
    """What the motions B (N, k, m) leave of changes of k distances (N, k): (1 + B B^T)^-1 of these."""
    k = B.shape[1]
    left = np.linalg.solve(np.eye(k) + B @ np.swapaxes(B, 1, 2), wanted[..., None])[..., 0]
    return np.asarray(left, dtype=float)


def _middles(found: BulkContacts) -> Array:
    """Middles of the areas that touch (t, 3)."""
    counts = (np.arange(CORNERS) < found.counts[:, None])[..., None]
    return np.asarray((found.corners_o * counts).sum(axis=1) / found.counts[:, None], dtype=float)
