"""How a hand can close on something between its fingers: open postures in which the fingertips oppose each other.

Joints that flex a finger close it; the others (abduction, opposition) only turn it, so they are sampled over their
range. Of joints that share a drive, a fingertip presses all but the last one open: in half of the postures these are at
the end of their range. A posture is good where the directions in which the fingertips close balance: forces along them,
all pressing, add up to no force and no moment. Nothing but the tree and the collision geometry is used.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from scipy.optimize import nnls

from pinograsp.checks import brief
from pinograsp.contacts import fingertips
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.contacts.tips import link_centre
from pinograsp.hands import Finger, HandModel
from pinograsp.hands.geometry import hull_points
from pinograsp.objects.body import tangents
from pinograsp.spatial import Array, BoolArray, cross

_ROOM = 0.08  # of its range that a turning joint keeps from its stop: approaches swing back a little before they close
_SHARES = np.linspace(0.1, 1.0, 13)  # of the way from open to closed, at which fingertips are looked at
_AHEAD = 0.5  # of the way that a finger is ahead of, or behind, a mean one at most
_WIDTHS, _REFINED, _TURNS, _AWAY = 12, 3, 30, 0.1  # widths of which the best are refined, how many, how often, how far
_DRAWS = 6  # of the joints that spread fingers
_BESIDE, _PARALLEL = 0.8, 0.9  # cosines: of the way to a finger beside another with their axes, and of these
_PASSED = 1e-3  # [m] by which fingertips may have passed each other
_INNER = 0.25  # of a jaw: where the joint that it slides on is expected
_LEAN, _EDGES = np.radians(25.0), 6  # of the forces that fingertips are taken to make


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Preshape:
    """A way to close, and where it leads: frames are the hand's root frame h.

    Attributes:
        opened: posture before closing (n,) [rad or m].
        closed: posture that closing leads to (n,).
        met: posture on the way at which the fingertips are ``width`` apart (n,).
        centre_h: where the fingertips press together (3,) [m].
        axis_h: unit direction (3,) in which the leading finger presses; the others press against it.
        out_h: unit direction (3,) from the palm to the centre, across ``axis_h``.
        depth: distance of the centre from the fingers' bases along ``out_h`` [m].
        width: of what would lie between the fingertips there [m].
        imbalance: what is left of the fingers' unit forces [-]: 0 where they oppose each other exactly.
        yielded: whether joints that share a drive with one nearer to the fingertip are where this presses them.
    """

    opened: Array
    closed: Array
    met: Array
    centre_h: Array
    axis_h: Array
    out_h: Array
    depth: float
    width: float
    imbalance: float
    yielded: bool

    __repr__ = brief()


def preshapes(
    hand: HandModel,
    rng: np.random.Generator,
    *,
    samples: int = 60,
    uneven: bool = False,
    fingers: tuple[str, ...] | None = None,
) -> list[Preshape]:
    """Preshapes of any width, the best opposed ones of each share of the way.

    Args:
        hand: the hand; with convex hulls as its geometry this takes a second, else several.
        rng: for the joints that spread or oppose fingers.
        samples: postures of these joints.
        uneven: some fingers are further on their way than others, as where they are not mirror images.
        fingers: names of those that alone close; None: all. The others stay open.
    """
    tips, collisions = _Tips(hand, fingers), SelfCollisions(hand)
    found: list[Preshape] = []
    spreads = tips.spreads
    varied = len(spreads) or uneven
    for i in range(samples if varied else 1 + tips.yielding.any()):
        middle, yielded = tips.middle.copy(), i % 2 == 1
        opened, closed = tips.ends(middle, yielded)
        for _ in range(_DRAWS if i and varied else 0):  # until the open fingers do not hit each other
            drawn = rng.uniform(tips.low[spreads], tips.high[spreads])
            share = np.where(tips.flanked[spreads], rng.uniform(), 1.0)  # spread far they hit each other
            middle[spreads] = tips.middle[spreads] + share * (drawn - tips.middle[spreads])
            opened, closed = tips.ends(middle, yielded)
            if not collisions.between(tips.middle, opened):
                break
        ahead = tips.ahead(rng) if uneven else np.zeros(hand.n)
        met = opened + np.clip(_SHARES[:, None] + ahead, 0.0, 1.0) * (closed - opened)
        found += [one for one in tips.preshapes(opened, closed, met) if one is not None]
    return sorted(found, key=lambda one: one.imbalance)


def measure_opening(hand: HandModel, fingers: Sequence[str] | None = None) -> float:
    """How far the fingertips are apart where the hand is open, its spreading joints in the middle [m]; where they do
    not oppose each other there, as soon as they do on their way.
    """
    tips = _Tips(hand, fingers)
    opened, closed = tips.ends(tips.middle)
    shares = np.concatenate([[0.0], _SHARES])[:, None]
    on_the_way = tips.preshapes(opened, closed, opened + shares * (closed - opened))
    return next((shape.width for shape in on_the_way if shape is not None), 0.0)


def free_of_themselves(hand: HandModel, shapes: list[Preshape]) -> list[Preshape]:
    """The preshapes whose links hit each other neither before they close nor where the fingertips meet; some overlap by
    design, anywhere.
    """
    middle, collisions = rest_of(hand), SelfCollisions(hand)
    return [one for one in shapes if not collisions.after(middle, np.stack([one.opened, one.met]))]


def rest_of(hand: HandModel) -> Array:
    """A posture (n,) in which links that overlap do so by design."""
    return np.clip(hand.resting, hand.lower, hand.upper)


def refine(
    hand: HandModel, shapes: list[Preshape], rng: np.random.Generator, *, fingers: tuple[str, ...] | None = None
) -> list[Preshape]:
    """The best opposed of ``shapes`` near each of some widths, fingers spread and moved until they oppose better.

    Without joints that spread or oppose fingers there are none.
    """
    tips, free = _Tips(hand, fingers), free_of_themselves(hand, shapes)
    if not len(tips.spreads):
        return []
    shapes = free if len(free) >= _REFINED else shapes
    collisions, middle = SelfCollisions(hand), rest_of(hand)
    largest = max((one.width for one in shapes), default=0.0)
    better: list[Preshape] = []
    for width in np.linspace(0.0, largest, _WIDTHS + 1)[1:]:
        # What is off in width by a tenth of the largest counts as an imbalance of one tenth.
        def worth(one: Preshape, width: float = float(width)) -> float:
            return one.imbalance + abs(one.width - width) / largest

        for start in sorted(shapes, key=worth)[:_REFINED]:
            best = start
            for turn in range(_TURNS):
                other = tips.move(best, rng, _AWAY * (1.0 - turn / _TURNS))
                if other is not None and worth(other) < worth(best) and not collisions.between(middle, other.met):
                    best = other
            better.append(best)
    return sorted(better, key=lambda one: one.imbalance)


class _Tips:
    """Fingertips of a hand, in its root frame."""

    def __init__(self, hand: HandModel, fingers: Sequence[str] | None):
        self.hand, self.data = hand, hand.model.createData()
        self.oMh = pin.SE3(np.array(hand.pose))
        low, high = np.maximum(hand.lower, -np.pi), np.minimum(hand.upper, np.pi)
        room = np.where(hand.slides, 0.0, _ROOM) * (high - low)
        stays = np.isin(hand.joint_names, list(hand.posture))
        self.low, self.high = (np.where(stays, hand.resting, end) for end in (low + room, high - room))
        self.middle = np.clip(hand.resting, self.low, self.high)
        self.fingers = [(finger.joint_ids[-1], finger.dofs) for finger in hand.fingers]
        self.own = np.array([np.isin(np.arange(hand.n), dofs) for _, dofs in self.fingers])  # joints of each (f, n)
        self._put(self.middle)
        bases = [_base(hand, self.data, finger) for finger in hand.fingers]
        self.points = {j: _distal(_points(hand, j), base) for (j, _), base in zip(self.fingers, bases)}
        # Where the fingers' chains part, whatever arm or forearm the file has behind that.
        first = [self.data.oMi[finger.joint_ids[0]] for finger in hand.fingers]
        self.base = np.mean([pose.act(base) for pose, base in zip(first, bases)], axis=0)
        self.flexion = self._flexion()
        self.beside = np.eye(len(self.fingers), dtype=bool)
        self.towards = self._towards()
        self.yielding = self._yielding()
        self.flanked = self.own[(self.beside.sum(axis=1) > 1)].any(axis=0)  # joints of fingers beside others
        moving = np.unique(np.concatenate([dofs for _, dofs in self.fingers]))
        self.spreads = moving[~self.flexion[moving]]  # joints of a wrist stay
        self.still = np.zeros(hand.n, dtype=bool)  # joints of fingers that stay open
        if fingers is not None:
            which = [finger.name in fingers for finger in hand.fingers]
            closing: BoolArray = np.asarray(self.own[which].any(axis=0))
            self.still[:] = self.own.any(axis=0) & ~closing
            self.fingers = [one for one, closes in zip(self.fingers, which) if closes]
            self.own, self.spreads = self.own[which], self.spreads[closing[self.spreads]]

    def _put(self, q: Array) -> None:
        pin.computeJointJacobians(self.hand.model, self.data, q)

    def _jacobian(self, joint: int, point: Array) -> Array:
        """Of a point (3,) carried by a joint (3, n), world axes."""
        J = pin.getJointJacobian(self.hand.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, self.hand.n)
        moved: Array = J[:3] + cross(J[3:].T, point - self.data.oMi[joint].translation).T
        return moved

    def _flexion(self) -> np.ndarray:
        """Which joints close a finger (n,): those that slide, and those parallel to a finger's last one."""
        flexion = np.zeros(self.hand.n, dtype=bool)
        self._put((self.low + self.high) / 2)
        for joint, dofs in self.fingers:
            J = pin.getJointJacobian(self.hand.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, self.hand.n)
            last = J[3:, dofs[-1]]
            for i in dofs.tolist():
                turning = float(np.linalg.norm(J[3:, i]))
                parallel = abs(J[3:, i] @ last) > 0.7 * turning * np.linalg.norm(last)
                flexion[i] |= turning < 1e-9 or i == dofs[-1] or parallel
        return flexion

    def _towards(self) -> Array:
        """Signs (n,) of the directions in which flexion joints bring the fingertips together."""
        towards = np.zeros(self.hand.n)
        for q in (self.middle, (self.low + self.high) / 2):
            self._put(q)
            at = np.array([self.data.oMi[joint].act(self.points[joint].mean(axis=0)) for joint, _ in self.fingers])
            if len(at) == 1:
                at = np.vstack([at, fingertips(self.hand, self.data)[1]])
            centre = at.mean(axis=0)
            for (joint, dofs), tip in zip(self.fingers, at):
                towards[dofs] += (self._jacobian(joint, tip).T @ (centre - tip))[dofs]
        return np.where(self.flexion, np.where(towards * self._mend(towards) >= 0, 1.0, -1.0), 0.0)

    def _mend(self, towards: Array) -> Array:
        """Signs (n,): -1 for the joints of fingers that would close the other way than those beside them, which turn
        about the same direction. Notes which fingers are beside which (f, f).
        """
        self._put(self.middle)
        bases = np.array([self.data.oMi[joint].translation for joint, _ in self.fingers])
        axes, closing = np.zeros(bases.shape), np.zeros(len(bases))
        for k, (joint, dofs) in enumerate(self.fingers):
            columns = pin.getJointJacobian(self.hand.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)
            turns = columns.reshape(6, -1)[3:, dofs] * self.flexion[dofs]
            axes[k] = turns[:, -1] / max(float(np.linalg.norm(turns[:, -1])), 1e-9)
            closing[k] = towards[dofs] @ np.sign(axes[k] @ turns)
        signs, alike = np.ones(self.hand.n), axes @ axes.T
        ways = bases[:, None] - bases
        along = np.abs(np.einsum("klx,lx->kl", ways, axes)) >= _BESIDE * np.linalg.norm(ways, axis=2)
        self.beside = along & (np.abs(alike) > _PARALLEL)
        for k, (_, dofs) in enumerate(self.fingers):
            others = np.sign(alike[:, k] * self.beside[:, k]) @ closing
            if others * closing[k] < 0 and self.own[:, dofs].sum(axis=0).max() == 1:
                signs[dofs] = -1.0
        return signs

    def _yielding(self) -> BoolArray:
        """Which joints (n,) share a drive with a joint nearer to their fingertip, so that this presses them open."""
        yielding = np.zeros(self.hand.n, dtype=bool)
        for ratio in self.hand.ratios:
            for _, dofs in self.fingers:
                yielding[dofs[(ratio.row[dofs] != 0) & self.flexion[dofs]][:-1]] = True
        return yielding

    def ends(self, middle: Array, yielded: bool = False) -> tuple[Array, Array]:
        """Open and closed posture (n,), (n,) with the other joints as in ``middle``; ``yielded``: with the joints that
        their fingertip presses open where that leads.
        """
        closing = self.towards > 0
        opened = np.where(self.flexion, np.where(closing, self.low, self.high), middle)
        closed = np.where(self.flexion, np.where(closing, self.hand.upper, self.hand.lower), middle)
        if yielded:
            stop = np.where(closing, self.hand.lower, self.hand.upper)
            opened, closed = (np.where(self.yielding, stop, q) for q in (opened, closed))
        return opened, np.where(self.still, opened, closed)

    def ahead(self, rng: np.random.Generator) -> Array:
        """Shares of the way (n,) that the joints of a finger are ahead of, or behind, those of the others."""
        ahead = np.zeros(self.hand.n)
        for _, dofs in self.fingers:
            ahead[dofs] = rng.uniform(-_AHEAD, _AHEAD)
        return ahead

    def move(self, one: Preshape, rng: np.random.Generator, size: float) -> Preshape | None:
        """A preshape with its fingers spread and moved a little, by shares of their ranges."""
        opened, closed = one.opened.copy(), one.closed.copy()
        moving = np.concatenate([dofs for _, dofs in self.fingers])
        opened[moving] += size * rng.normal(size=len(moving)) * (self.high - self.low)[moving]
        yielded = self.yielding & (one.opened == one.closed)
        opened = np.where(yielded, one.opened, np.clip(opened, self.low, self.high))
        closed[self.spreads] = opened[self.spreads]
        way = closed - opened
        shares = np.divide(one.met - one.opened, way, out=np.zeros(self.hand.n), where=np.abs(way) > 1e-9)
        for _, dofs in self.fingers:
            shares[dofs] += size * rng.normal()
        met = opened + np.clip(shares, 0.0, 1.0) * way
        # Joints begin at most halfway, so that the hand still opens wider than what it is to close on.
        half = (self.ends(opened)[0] + met) / 2
        early = np.where(self.towards > 0, np.minimum(opened, half), np.maximum(opened, half))
        return self.preshape(np.where(self.flexion & ~yielded, early, opened), closed, met)

    def preshape(self, opened: Array, closed: Array, met: Array) -> Preshape | None:
        """The preshape whose fingertips meet at a posture (n,) on the way; None where none of them move."""
        return self.preshapes(opened, closed, met[None])[0]

    def preshapes(self, opened: Array, closed: Array, met: Array) -> list[Preshape | None]:
        """Those whose fingertips meet at postures (m, n) on the way, as :meth:`preshape`."""
        m, f, model = len(met), len(self.fingers), self.hand.model
        R, origins, J = np.empty((m, f, 3, 3)), np.empty((m, f, 3)), np.empty((m, f, 6, self.hand.n))
        for i, q in enumerate(met):
            self._put(q)
            for k, (joint, _) in enumerate(self.fingers):
                pose = self.data.oMi[joint]
                R[i, k], origins[i, k] = pose.rotation, pose.translation
                columns = pin.getJointJacobian(model, self.data, joint, pin.LOCAL_WORLD_ALIGNED)
                J[i, k] = columns.reshape(6, -1)  # of one joint it is flat
        twists = np.einsum("mkin,kn->mki", J, self.own * (closed - opened))
        at, along = np.empty((2, *origins.shape))
        for k, (joint, _) in enumerate(self.fingers):
            points, turn = self.points[joint], R[:, k]
            along[:, k] = twists[:, k, :3] + cross(twists[:, k, 3:], turn @ points.mean(axis=0))
            ahead = _ahead(points, np.einsum("mij,mi->mj", turn, along[:, k]))
            at[:, k] = origins[:, k] + np.einsum("mij,mj->mi", turn, ahead)
        sizes = np.linalg.norm(along, axis=2)
        moving, along = sizes >= 1e-9, along / np.maximum(sizes, 1e-9)[..., None]
        return [self._meet(opened, closed, q, at[i, moving[i]], along[i, moving[i]]) for i, q in enumerate(met)]

    def _meet(self, opened: Array, closed: Array, met: Array, at: Array, along: Array) -> Preshape | None:
        """The preshape whose fingertips are at points (f, 3) and move along directions (f, 3) at the posture (n,)."""
        if not len(at):
            return None
        if len(at) == 1:  # the palm holds against a single finger
            self._put(met)
            at, along = np.vstack([at, fingertips(self.hand, self.data)[1]]), np.vstack([along, -along])
        pressing, imbalance = balance(at, along)
        lead = int(np.argmax(pressing))
        others = pressing.copy()
        others[lead] = 0.0
        if others.sum() < 1e-6:
            return None
        other = others @ at / others.sum()
        # Of jaws that close on arcs both lean the same way: what they press against each other counts.
        axis = along[lead] - others @ along / others.sum()
        axis /= max(float(np.linalg.norm(axis)), 1e-9)
        width = float((other - at[lead]) @ axis)
        if width < -_PASSED:  # they would have to pass through each other
            return None
        centre = (at[lead] + other) / 2
        out = centre - self.base
        depth, out = float(np.linalg.norm(out)), out - axis * (axis @ out)
        if np.linalg.norm(out) < 1e-6:
            out = cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
        turn = self.oMh.rotation.T
        return Preshape(
            opened=opened,
            closed=closed,
            met=met,
            centre_h=np.array(self.oMh.actInv(centre)),
            axis_h=turn @ axis,
            out_h=turn @ (out / np.linalg.norm(out)),
            depth=depth,
            width=max(0.0, width),
            imbalance=imbalance,
            yielded=bool((self.yielding & (opened == closed)).any()),
        )


def balance(at: Array, along: Array) -> tuple[Array, float]:
    """Shares (f,) of sum 1 in which forces about directions (f, 3) at points (f, 3) balance best, and what they leave.

    The forces may lean by ``_LEAN``, as the object's surface and friction let them.
    """
    arms = at - at.mean(axis=0)
    arm = max(float(np.linalg.norm(arms, axis=1).mean()), 1e-6)
    across = tangents(along)
    turn = np.arange(_EDGES) * 2 * np.pi / _EDGES
    lean = across @ np.stack([np.cos(turn), np.sin(turn)]) * np.tan(_LEAN)  # (f, 3, edges)
    forces = np.concatenate([along[:, None], along[:, None] + lean.transpose(0, 2, 1)], axis=1)
    moments = cross(arms[:, None], forces) / arm
    rows = np.concatenate([forces, moments], axis=2).reshape(-1, 6).T
    weights, _ = nnls(np.vstack([rows, np.full(rows.shape[1], 1e2)]), np.append(np.zeros(6), 1e2))
    shares = weights.reshape(len(at), -1).sum(axis=1)
    return shares / shares.sum(), float(np.linalg.norm(rows @ weights))


def _ahead(points: Array, directions: Array) -> Array:
    """The means (m, 3) of the points (p, 3) that lie farthest along directions (m, 3) of any length."""
    along = directions @ points.T / np.maximum(np.linalg.norm(directions, axis=1), 1e-9)[:, None]
    ahead = along >= along.max(axis=1, keepdims=True) - 1e-3
    means: Array = ahead @ points / ahead.sum(axis=1)[:, None]
    return means


def _base(hand: HandModel, data: pin.Data, finger: Finger) -> Array:
    """Where a finger begins (3,), in the frame of its only joint: there.

    A joint that slides may be anywhere along its jaw. Beyond the quarter at the palm, it is the jaw's end there.
    """
    joint = finger.joint_ids[-1]
    points, parent = _points(hand, joint), hand.model.parents[joint]
    if len(finger.joint_ids) > 1 or not hand.slides[finger.dofs].all() or not len(_points(hand, parent)):
        return np.zeros(3)
    palm = data.oMi[joint].actInv(link_centre(hand, data, parent))
    near = points @ palm
    if near.max() <= _INNER * np.ptp(near):
        return np.zeros(3)
    inner: Array = points[near >= near.max() - 1e-3 * np.linalg.norm(palm)].mean(axis=0)
    return inner


def _distal(points: Array, base: Array) -> Array:
    """Those of a link's points (p, 3) that lie far from where the finger begins (3,): where it presses."""
    far = np.linalg.norm(points - base, axis=1)
    distal: Array = points[far >= 0.6 * far.max()]
    return distal


def measure_thickness(hand: HandModel) -> dict[str, float]:
    """How thick the ends of the fingers are [m]: the least extent of their hulls along the hulls' own axes."""
    found, data = {}, hand.model.createData()
    pin.forwardKinematics(hand.model, data, rest_of(hand))
    for finger in hand.fingers:
        points = _distal(_points(hand, finger.joint_ids[-1]), _base(hand, data, finger))
        centred = points - points.mean(axis=0)
        axes = np.linalg.svd(centred, full_matrices=False)[2]
        found[finger.name] = float(np.ptp(centred @ axes.T, axis=0).min())
    return found


def _points(hand: HandModel, joint: int) -> Array:
    """Points (p, 3) on the hull of what a joint carries, in its frame; its origin where it carries nothing."""
    found = [
        one.placement.act(point)
        for one in hand.geometry.geometryObjects
        if one.parentJoint == joint
        for point in hull_points(one.geometry)
    ]
    return np.array(found) if found else np.zeros((1 if joint else 0, 3))
