"""What is known of many grasps: which hold, how hard they press, and why the others do not hold."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinograsp.checks import brief, integer, items_of, read_only
from pinograsp.contacts import PALM, Contact, ContactSet
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import ForceProblem, GraspConditions
from pinograsp.hands import HandModel
from pinograsp.motion.remedies import name_displacement
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, BoolArray, IntArray, tangent_frame

BEYOND = 0.02  # [rad or, times the lever, m] beyond a limit that is carelessness; more is told, or refused

_FEWEST, _NEARLY_ALL = 5, 0.9  # grasps, and the share of them from which on chance does not explain it
_FRAMES = (
    "are frames, units and the order of the joints right? Poses are in the frame of the object's file, not in one at "
    "its centre of mass (body.com_b away), in metres (millimetres need scale=0.001); joints are in the order of "
    "hand.joint_names, in radians. If all of this is right, the contacts are farther away than the tolerance"
)
# What decides where most grasps have one reason.
_DECISIVE = {
    Status.DRIVES: "the drives of several joints are assumed to share their effort by fixed arms; drives=False "
    "(--no-drives) leaves this test to the column 'producible'",
    Status.PENETRATES: "are the poses in the frame of the object's file, not in one at its centre of mass? A larger "
    "tolerance (--tolerance) counts links that are this deep as contacts, right or wrong",
    Status.NO_CONTACT: "are the poses in the frame of the object's file, not in one at its centre of mass? A larger "
    "tolerance (--tolerance) counts links that are this far away as contacts, right or wrong",
    Status.RESERVE: "reserve=None (--no-reserve) requires the weight alone",
    Status.TORQUE: "check the hand's effort limits; torque_limit=None ignores them",
}
FAR_OFF = 0.1  # [m] farther off the object nobody asks how far
# Arrays with an entry for each contact.
_PADDED = ("links", "points_o", "normals_o", "gaps", "forces_o", "torsion")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Certificates:
    """The results of :func:`~pinograsp.certification.certify` for N grasps of one object by one hand.

    Each grasp has up to k contacts; entries beyond ``counts`` are zero. NaN means that the value does not exist, see
    ``reason``.

    Attributes:
        hand: the hand.
        object: the object, in its place.
        conditions: friction, limits and the reserve.
        q: postures (N, n) [rad or m], moved to the limits if they were slightly beyond.
        roots: oMh of the hand's root (N, 4, 4).
        reason: the code of a :class:`~pinograsp.errors.Status` for each grasp (N,); 0: held.
        counts: number of contacts (N,), without links that cannot reach the surface while the others stay there.
        links: of each contact (N, k), an index into ``link_names``.
        link_names: names of the links.
        points_o: contact points (N, k, 3), world [m].
        normals_o: inward unit normals (N, k, 3).
        gaps: distance of each contact's link from the surface (N, k) [m], negative inside.
        forces_o: contact forces on the object under its weight (N, k, 3), world [N].
        torsion: moments about the normals (N, k) [N m].
        torques: joint torques for these forces and the hand's own weight (N, n) [N m or N].
        reserve: multiple of the reserve's disturbances that these forces withstand before a contact slips (N,) [-];
            below 1 the largest that was found.
        weakest: the disturbance that the grasp withstands least (N, 6), of the size in the reserve: a wrench about the
            centre of mass, besides the weight [N, N m]; zero without forces. ``reserve`` times it makes a contact slip.
        least_mu: least friction coefficient with which some forces hold the weight (N,) [-]; infinity: none up to 2.
        antipodal_mu: for grasps by two links, the least friction coefficient with which they can squeeze the object
            (N,) [-]: tan of the larger angle between a normal and the line through both points (Nguyen 1988),
            GraspNet-1Billion's score for jaws; infinity if they do not face each other, and for all other grasps.
        largest_load: the largest weight that the hand certainly holds within its torque limits (N,) [N]; infinity
            without limits.
        effort: largest share of a joint's torque limit (N,) [-].
        producible: whether the hand's drives can produce holding forces, within its torque limits (N,).
        unproducible: share of the depths pressed that the hand's joints cannot choose (N,) [-].
        residual: of the balance (N,) [N, moments over the contacts' mean distance].
        depth: of the deepest link beyond the tolerance (N,) [m]; negative if no link touches: the distance of the
            nearest one, up to 0.1 m; 0: neither.
        excess: how far joints were beyond their limits (N, n) [rad or m].
        commanded: which grasps had commands that were tried (N,).
        held_as_commanded: which of them the hand holds as commanded under all loads (N,).
        moved: how far the object moves from its place before the hand closed, at most under any load (N,) [m].
        turned: how far it turns, in the same sense (N,) [rad].
        pressed: normal forces of all links (N, l) [N] after the squeeze as commanded, before any load.
        elapsed: computing time by stage [s].
    """

    hand: HandModel
    object: Body
    conditions: GraspConditions
    q: Array
    roots: Array
    reason: NDArray[Any]
    counts: IntArray
    links: IntArray
    link_names: tuple[str, ...]
    points_o: Array
    normals_o: Array
    gaps: Array
    forces_o: Array
    torsion: Array
    torques: Array
    reserve: Array
    weakest: Array
    least_mu: Array
    antipodal_mu: Array
    largest_load: Array
    effort: Array
    producible: BoolArray
    unproducible: Array
    residual: Array
    depth: Array
    excess: Array
    commanded: BoolArray
    held_as_commanded: BoolArray
    moved: Array
    turned: Array
    pressed: Array
    elapsed: dict[str, float]

    __repr__ = brief("hand", "object", "elapsed")

    def __len__(self) -> int:
        return len(self.q)

    @classmethod
    def join(cls, blocks: Sequence[Certificates]) -> Certificates:
        """Join certificates of one hand, object and conditions, one after the other.

        Raises:
            InvalidInput: none.
        """
        blocks = items_of("blocks", blocks, cls)
        if not blocks:
            raise InvalidInput("blocks: expected certificates, one block or more, got none")
        most = max(block.points_o.shape[1] for block in blocks)
        joined: dict[str, Any] = {}
        for one in fields(cls):
            values = [getattr(block, one.name) for block in blocks]
            if not isinstance(values[0], np.ndarray):
                joined[one.name] = values[0]
                continue
            if one.name in _PADDED:
                spare = [[(0, 0), (0, most - value.shape[1]), *[(0, 0)] * (value.ndim - 2)] for value in values]
                values = [np.pad(value, widths) for value, widths in zip(values, spare)]
            joined[one.name] = read_only(np.concatenate(values))
        joined["elapsed"] = {stage: sum(block.elapsed[stage] for block in blocks) for stage in blocks[0].elapsed}
        return cls(**joined)

    @property
    def held(self) -> BoolArray:
        """Which grasps hold the object with its reserve (N,)."""
        held: BoolArray = self.reason == Status.HELD.code
        return held

    @property
    def possible(self) -> BoolArray:
        """Which grasps can hold the object (N,): by certified forces, or as commanded, where links and fingers settle
        in another posture.
        """
        possible: BoolArray = self.held | self.held_as_commanded
        return possible

    @property
    def normal_forces(self) -> Array:
        """F_n of each contact (N, k) [N]."""
        forces: Array = np.einsum("nkx,nkx->nk", self.forces_o, self.normals_o)
        return forces

    @property
    def hint(self) -> str:
        """What to check if nearly all grasps are misplaced, otherwise empty: :func:`placement_hint`."""
        return placement_hint(self.reason, self.depth)

    def describe(self) -> str:
        """Describe how many hold, why the others do not, and the hint."""
        counts = Counter(sorted(self.reason.tolist())).most_common()
        lines = [f"{self.held.sum()} of {len(self)} grasps hold"]
        if self.commanded.any():
            lines = [
                f"{self.possible.sum()} of {len(self)} grasps are possible, {self.held_as_commanded.sum()} of "
                f"{self.commanded.sum()} hold as commanded"
            ]
        lines += [f"  {count}: {Status.from_code(code).words}" for code, count in counts]
        hints = [self.hint, decisive_hint({Status.from_code(code): count for code, count in counts})]
        return "\n".join([*lines, *(f"  hint: {hint}" for hint in hints if hint)])

    def __str__(self) -> str:
        return self.describe()

    def words(self, i: int) -> str:
        """Say why grasp i does not hold, or that it does, with its figures; :class:`~pinograsp.errors.InvalidInput` if
        there is no such grasp.
        """
        i = self._number(i)
        reason = Status.from_code(self.reason[i])
        figure = {
            Status.PENETRATES: f"{1e3 * self.depth[i]:.2g} mm",
            Status.NO_CONTACT: self._off(-float(self.depth[i])),
            Status.FRICTION: f"mu = {self.conditions.mu:g}, {self.least_mu[i]:.2g} is needed",
            Status.JOINT_LIMIT: self._beyond(i) if reason is Status.JOINT_LIMIT else "",
            Status.TORQUE: f"{self.effort[i]:.2g} times a joint's limit",
            Status.DRIVES: self._drives() if reason is Status.DRIVES else "",
        }.get(reason, "")
        words = f"{reason.words} ({figure})" if figure else reason.words
        if reason is not Status.JOINT_LIMIT and self.excess[i].max(initial=0.0) > BEYOND:
            words += f"; {self._beyond(i)} beyond its limit"
        if not self.commanded[i]:
            return words
        way = f"{1e3 * self.moved[i]:.2g} mm and {np.degrees(self.turned[i]):.2g} deg"
        verdict = f"held, the object moves by {way}" if self.held_as_commanded[i] else f"lost, after {way}"
        settled = bool(self.held_as_commanded[i] and not self.held[i])
        return f"{words}; as commanded: {verdict}{', from where fingers and object settle' * settled}"

    def _off(self, gap: float) -> str:
        """How far off the nearest link is."""
        return f"the nearest is {1e3 * gap:.2g} mm away{' or more' * (gap >= FAR_OFF)}" if gap > 0 else ""

    def _beyond(self, i: int) -> str:
        """Which joint is farthest beyond its limits, and how far."""
        worst = int(self.excess[i].argmax())
        joint = self.hand.joint_names[worst]
        return f"{joint} by {name_displacement(self.hand, joint, float(self.excess[i, worst]))}"

    def _number(self, i: int) -> int:
        return integer("number of the grasp", i, at_least=-len(self), at_most=len(self) - 1)

    def _drives(self) -> str:
        """What keeps the drives from making any forces."""
        return "; ".join(dict.fromkeys(ratio.why for ratio in self.hand.ratios)) or "links share joints"

    def contacts(self, i: int) -> ContactSet:
        """Return the contacts of grasp i, with its posture, for the rest of the package; they belong to
        ``hand.placed(roots[i])``.

        Raises:
            InvalidInput: it has none, or there is no such grasp.
        """
        i = self._number(i)
        count = int(self.counts[i])
        if not count:
            raise InvalidInput(
                f"grasp {i}: expected one that touches the object: {Status.from_code(self.reason[i]).words}"
            )
        hand = self.hand.placed(self.roots[i])
        data = hand.model.createData()
        pin.forwardKinematics(hand.model, data, np.array(self.q[i]))
        found = []
        for c in range(count):
            link = self.link_names[self.links[i, c]]
            finger = next((one for one in hand.fingers if link in one.links), None)
            joint = 0 if finger is None else finger.joint_of(link)
            local = data.oMi[joint].actInv(self.points_o[i, c])
            found.append(
                Contact(
                    finger=PALM if finger is None else finger.name,
                    link=link,
                    point_o=self.points_o[i, c],
                    rotation_oc=tangent_frame(self.normals_o[i, c], self.conditions.gravity_o),
                    length=float(np.linalg.norm(local)),
                    distance=0.0,
                    point_l=read_only(local),
                )
            )
        return ContactSet(contacts=tuple(found), com_o=self.object.com_o, posture=self.q[i])

    def problem(self, i: int) -> ForceProblem:
        """Return the force problem of grasp i, without the reserve, for :func:`~pinograsp.forces.optimize_grasp`."""
        return self.conditions.problem(self.object, self.contacts(i))


def decisive_hint(counts: Mapping[str, int]) -> str:
    """Say what would change the answer if one reason decides half of the grasps or more; empty if none does.

    ``counts``: number of grasps by reason.
    """
    total = sum(counts.values())
    for reason, way in _DECISIVE.items():
        count = counts.get(reason, 0)
        if total >= _FEWEST and count >= 0.5 * total:
            return f"{count} of {total} grasps are '{reason}': {way}"
    return ""


def placement_hint(reasons: ArrayLike, depths: ArrayLike, what: str = "the object") -> str:
    """Say what to check if nearly all grasps of an object penetrate it, miss it, or exceed the joints' limits.

    Args:
        reasons: the code of a :class:`~pinograsp.errors.Status` for each grasp (N,).
        depths: for each grasp, as in :class:`Certificates` (N,) [m].
        what: the object, in words.

    Returns:
        A sentence; empty if too many grasps are none of these, or there are fewer than five.
    """
    reason, depth = np.asarray(reasons), np.asarray(depths, dtype=float)
    inside = reason == Status.PENETRATES.code
    off = reason == Status.NO_CONTACT.code
    beyond = reason == Status.JOINT_LIMIT.code
    if len(reason) < _FEWEST or (inside | off | beyond).mean() < _NEARLY_ALL:
        return ""
    parts = []
    if inside.any():
        parts.append(f"{inside.sum()} are in {what}, {1e3 * np.median(depth[inside]):.3g} mm deep in the median")
    if off.any():
        gaps = -depth[off & (depth < 0)]
        gap = float(np.median(gaps)) if len(gaps) else 0.0
        least = " or more" * (gap >= FAR_OFF)
        by = f", {1e3 * gap:.3g} mm{least} away in the median" * (gap > 0)
        parts.append(f"{off.sum()} do not touch {what} with two links{by}")
    if beyond.any():
        parts.append(f"{beyond.sum()} have joints beyond their limits")
    return f"of {len(reason)} grasps, {'; '.join(parts)}: {_FRAMES}"
