"""What all postures of a certification have in common: the hand, the object, and what is asked of a grasp."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TypedDict

import numpy as np

from pinograsp import defaults
from pinograsp.certification.protocols import Protocol, find_protocol
from pinograsp.checks import flag, instance_of, integer, number, read_only
from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.commanded import Loading, Motors
from pinograsp.contacts.friction import CONE, SOFT
from pinograsp.errors import InvalidInput
from pinograsp.forces import GraspConditions, Reserve
from pinograsp.forces.bulk.squeeze import Holding
from pinograsp.hands import HandModel
from pinograsp.motion import effort_of
from pinograsp.objects.body import Body
from pinograsp.plan.simulation import MOVED, TURNED
from pinograsp.spatial import Array, IntArray

_PRESSED = 1.0  # [N] at which contacts are as stiff as springs are taken to be


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """What counts as a contact and as held; fields as the arguments of :func:`~pinograsp.certification.certify`."""

    tolerance: float = defaults.TOUCHES
    palm: bool = True
    patches: bool = True
    exact: bool = True
    drives: bool = True
    threads: int | None = None
    protocol: Protocol | str | None = None
    commanded: bool = False

    def __post_init__(self) -> None:
        object.__setattr__(self, "tolerance", number("tolerance", self.tolerance, at_least=1e-7, unit="m"))
        for name in ("palm", "patches", "exact", "drives", "commanded"):
            flag(name, getattr(self, name))
        if self.threads is not None:
            object.__setattr__(self, "threads", integer("threads", self.threads, at_least=1))
        instance_of("protocol", self.protocol, Protocol, str, type(None))
        object.__setattr__(self, "protocol", find_protocol(self.protocol))


class CertifyArguments(TypedDict, total=False):
    """:class:`Options` as arguments."""

    tolerance: float
    palm: bool
    patches: bool
    exact: bool
    drives: bool
    threads: int | None
    protocol: Protocol | str | None
    commanded: bool


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CertifySetup:
    """Prepared once for any number of postures (n joints).

    Attributes:
        hand, body, conditions, options: as given.
        scene: finds contacts.
        idle: joints that move no finger.
        limit: torque limits (n,) [N m or N].
        reserve: what grasps must withstand; none where the conditions have none.
        wrenches: that are added to the weight (m, 6) [N, N m].
        holding: the weight, and with what friction it is held.
        ratios: what drives of several joints leave out of their torques (p, n).
        motors: of the hand.
        loading: what grasps that are commanded must withstand.
    """

    hand: HandModel
    body: Body
    conditions: GraspConditions
    options: Options
    scene: BulkScene
    idle: IntArray
    limit: Array
    reserve: Reserve
    wrenches: Array
    holding: Holding
    ratios: Array
    motors: Motors
    loading: Loading


def prepare(hand: HandModel, body: Body, conditions: GraspConditions, options: Options) -> CertifySetup:
    """The set-up of a hand and an object.

    Raises:
        InvalidInput: a hand without geometry, or conditions that cannot be used.
    """
    instance_of("hand", hand, HandModel)
    instance_of("body", body, Body)
    instance_of("conditions", conditions, GraspConditions)
    if conditions.balance != "wrench":
        raise InvalidInput("conditions: expected balance='wrench': a free object turns if moments are not balanced")
    if conditions.reserve is not None and conditions.reserve.has_scenarios:
        raise InvalidInput(
            "conditions: expected a reserve with softer=1, stiffer=1 and drive=0: servos are not considered here"
        )
    protocol = find_protocol(options.protocol)
    reserve = Reserve.none() if conditions.reserve is None or protocol else conditions.reserve
    if protocol:  # its programs would take the weight
        loads, hand = protocol.loads_on(body.mass), protocol.hand(hand)
        weight, wrenches = loads[0], loads - loads[0]
        options = replace(options, exact=False)
    else:
        weight = np.concatenate([body.mass * conditions.gravity_o, np.zeros(3)])
        wrenches = reserve.load_set(body, conditions.gravity_o).loads - weight
    law = conditions.compliance
    cap = np.inf if conditions.max_normal_force is None else conditions.max_normal_force
    deepest = float(law.force(conditions.max_depth))
    return CertifySetup(
        hand=hand,
        body=body,
        conditions=conditions,
        options=options,
        scene=BulkScene(hand, body),
        idle=np.setdiff1d(np.arange(hand.n), np.concatenate([finger.dofs for finger in hand.fingers])),
        limit=read_only(effort_of(hand, conditions.torque_limit)),
        reserve=reserve,
        wrenches=read_only(wrenches[np.abs(wrenches).max(axis=1) > 0]),
        holding=Holding(friction=CONE, mu=conditions.mu, weight=weight, cap=min(cap, deepest)),
        ratios=read_only(np.array([ratio.row for ratio in hand.ratios]).reshape(-1, hand.n)),
        motors=Motors.of(hand),
        loading=_loading(conditions, body.mass, weight, reserve, protocol),
    )


def _loading(
    conditions: GraspConditions, mass: float, weight: Array, reserve: Reserve, protocol: Protocol | None
) -> Loading:
    """The loads of a protocol; else the weight, alone and with the reserve's force along each axis."""
    if protocol:
        return Loading(
            loads=protocol.loads_on(mass),
            distance=protocol.distance,
            angle=protocol.angle,
            stiffness=protocol.stiffness,
            mu=protocol.mu,
            torsion=protocol.torsion,
        )
    axes = np.concatenate([np.zeros((1, 6)), np.eye(6)[:3], -np.eye(6)[:3]])
    law, friction = conditions.compliance, conditions.friction or SOFT
    return Loading(
        loads=weight + reserve.disturbance * np.linalg.norm(weight) * axes[: 7 if reserve.disturbance else 1],
        distance=MOVED,
        angle=float(np.radians(TURNED)),
        stiffness=float(law.slope(law.depth(_PRESSED))),
        mu=float(np.mean(conditions.mu)),
        torsion=friction.torsion or SOFT.torsion,
    )
