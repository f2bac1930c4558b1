"""The record of a closed hand: which links touch an object, where, and what stopped each joint."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, read_only
from pinograsp.contacts.clearance import PALM
from pinograsp.contacts.contact_set import Contact, ContactSet
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array, tangent_frame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Touch:
    """The first touch of a link.

    Attributes:
        finger: its name; ``"palm"``; or "" for moving links of no finger.
        link: the link.
        joint_id: Pinocchio's index of the joint that carries it (0: the palm).
        at: share of the path at which it happened (0 open, 1 closed).
        point_o: on the object's surface, world (3,) [m].
        normal_o: inward unit normal (3,), common to both surfaces: on an edge of the object, the link's.
        gap: distance left [m].
        point_l: the link's own point in its joint's frame (3,) [m].
        length: l_c, distance of that point from the link's joint [m].
        patch_o: corners (p, 3) of the contact area if both surfaces are flat [m], and ``point_o`` and ``point_l`` are
            then their mean; otherwise the point alone.
        sharp: whether a millimetre along the surface turns the normal by more than 25 deg.
    """

    finger: str
    link: str
    joint_id: int
    at: float
    point_o: Array
    normal_o: Array
    gap: float
    point_l: Array
    length: float
    patch_o: Array
    sharp: bool

    __repr__ = brief()


class TouchingHand:
    """What records of a hand that touches an object at a posture share."""

    __slots__ = ()
    hand: HandModel
    object: Body
    q: Array
    touches: tuple[Touch, ...]

    def contacts(
        self, *, gravity_o: ArrayLike = (0.0, 0.0, -9.81), palm: bool = True, patches: bool = True
    ) -> ContactSet:
        """The touches as contacts, base to tip by finger, with the posture they belong to.

        Args:
            gravity_o: orients the tangent axes.
            palm: with the palm's contact.
            patches: a contact at every corner of a flat area; else one in its middle.

        Raises:
            InvalidInput: nothing touches.
        """
        flag("palm", palm)
        flag("patches", patches)
        gravity = array_of("gravity", gravity_o, (3,))
        order = {finger.name: i for i, finger in enumerate(self.hand.fingers)} | {PALM: len(self.hand.fingers)}
        own = [touch for touch in self.touches if touch.finger and (palm or touch.finger != PALM)]
        if not own:
            raise InvalidInput("the hand touches nothing with its fingers or palm: there are no contacts (see notes)")
        own.sort(key=lambda touch: (order[touch.finger], touch.joint_id))
        data = self.hand.model.createData()
        pin.forwardKinematics(self.hand.model, data, np.array(self.q))
        contacts = []
        for touch in own:
            for point in touch.patch_o if patches else touch.point_o[None]:
                local = data.oMi[touch.joint_id].actInv(point)
                contacts.append(
                    Contact(
                        finger=touch.finger,
                        link=touch.link,
                        point_o=read_only(point),
                        rotation_oc=read_only(tangent_frame(touch.normal_o, gravity)),
                        length=float(np.linalg.norm(local)),
                        distance=0.0,
                        point_l=read_only(local),
                        sharp=touch.sharp,
                    )
                )
        return ContactSet(contacts=tuple(contacts), com_o=read_only(self.object.com_o), posture=self.q)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosingPath:
    """How a hand closed; the motion is piecewise linear between the e samples.

    Attributes:
        shares: of the path (e,), 0 open, 1 closed: at the start, at every touch, when joints stop, and at the end.
        postures: at these shares (e, n) [rad].
    """

    shares: Array
    postures: Array

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Closure(TouchingHand):
    """A hand closed on an object.

    Attributes:
        hand: the hand that closed.
        object: the object, in the place to which jaws that share an actuator have pushed it.
        q: final posture (n,) [rad].
        start: posture at the beginning of the path (n,) [rad].
        target: posture at its end, without contacts (n,) [rad].
        touches: in the order they happened. Fingers without any are at ``start``.
        stops: ``{joint: reason}``, ``"touch of <link>"``, ``"joint limit"`` or ``"end of path"``.
        path: the motion, sample by sample.
        self_collisions: pairs of links that overlap at the end and did not at the start.
        pushed: motion (4, 4) of the object in the world by jaws that share an actuator; identity if none.
        notes: remarks for the caller.
    """

    hand: HandModel
    object: Body
    q: Array
    start: Array
    target: Array
    touches: tuple[Touch, ...]
    stops: dict[str, str]
    path: ClosingPath
    self_collisions: tuple[tuple[str, str], ...]
    pushed: Array
    notes: tuple[str, ...]

    __repr__ = brief("hand", "object", "touches", "self_collisions", "notes")
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        return self.describe()

    def summary(self) -> dict[str, Any]:
        """The closure as plain values, for files and machines."""
        return {
            "hand": self.hand.name,
            "hand_pose": np.asarray(self.hand.pose).tolist(),
            "object_pose": np.asarray(self.object.pose).tolist(),
            "pushed": np.asarray(self.pushed).tolist(),
            "q": dict(zip(self.hand.joint_names, self.q.tolist())),
            "touches": [
                {
                    "finger": touch.finger,
                    "link": touch.link,
                    "at": touch.at,
                    "point_o": touch.point_o.tolist(),
                    "normal_o": touch.normal_o.tolist(),
                    "length": touch.length,
                    "corners": len(touch.patch_o),
                }
                for touch in self.touches
            ],
            "stops": dict(self.stops),
            "self_collisions": [list(pair) for pair in self.self_collisions],
            "notes": list(self.notes),
        }

    def describe(self) -> str:
        """Contacts, stops and notes as readable text."""
        lines = [f"{self.hand.name} closed: {len(self.touches)} contacts"]
        for touch in self.touches:
            point = ", ".join(f"{1e3 * v:.2f}" for v in touch.point_o)
            lines.append(
                f"  {touch.finger or '(no finger)'}/{touch.link} at ({point}) mm, l_c {1e3 * touch.length:.2f} mm, "
                f"{100 * touch.at:.1f} % of the way"
            )
        lines += [f"  {joint} stopped: {reason}" for joint, reason in self.stops.items()]
        lines += [f"  self-collision: {one} and {two}" for one, two in self.self_collisions]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])
