"""The parts of a plan's record: contacts, forces with their certificate, margins. Numbers and names alone."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal, NamedTuple

import numpy as np

from pinograsp.checks import brief, number
from pinograsp.errors import Status
from pinograsp.plan.plain_fields import Plain, by_contact, plain_fields
from pinograsp.spatial import Array

FrictionModel = Literal["pyramid", "cone", "soft"]


class FrictionTraits(NamedTuple):
    """What the name of a friction model says; its limits are those of :class:`~pinograsp.contacts.Friction`.

    Attributes:
        words: in prose.
        polygon: whether tangential forces are bounded by a polygon with edges.
        elliptic: whether one limit bounds tangential forces and torsion together, so that there must be torsion.
    """

    words: str
    polygon: bool = False
    elliptic: bool = False


FRICTION_TRAITS: dict[FrictionModel, FrictionTraits] = {
    "pyramid": FrictionTraits("pyramid", polygon=True),
    "cone": FrictionTraits("cone"),
    "soft": FrictionTraits("soft finger", elliptic=True),
}
Balance = Literal["force", "wrench"]
Measure = Literal["impulse", "work"]

INFINITE = "infinite"  # beside the sizes of an array: its numbers may be


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Layout:
    """Names of a hand's parts.

    Attributes:
        hand: its name.
        joints: actuated joints (n,), in the order of q.
        fingers: indices of the joints of each finger.
    """

    hand: str
    joints: Annotated[tuple[str, ...], "n"]
    fingers: Mapping[str, tuple[int, ...]]

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanContacts:
    """Where the hand touches, k contacts.

    Attributes:
        names: (k,).
        links: the links that touch (k,); empty if the contacts were made without a hand.
        points_o: (k, 3) [m].
        rotations_oc: contact frames, z into the object (k, 3, 3).
        com_o: the object's centre of mass (3,) [m].
    """

    names: Annotated[tuple[str, ...], "k"]
    links: Annotated[tuple[str, ...], "k"]
    points_o: Annotated[Array, "k 3"]
    rotations_oc: Annotated[Array, "k 3 3"]
    com_o: Annotated[Array, "3"]

    __repr__ = brief("names", "links")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanFriction:
    """The friction of the plan.

    Attributes:
        mu: friction coefficients (k,) [-].
        model: ``"pyramid"``, ``"cone"`` or ``"soft"``.
        edges: number of edges of a pyramid; None: no pyramid.
        safety: friction is used up to mu / safety [-].
        torsion: largest moment about a normal per newton [m]; 0: none.
    """

    mu: Annotated[Array, "k"]
    model: FrictionModel
    edges: int | None
    safety: float
    torsion: float

    __repr__ = brief()

    @property
    def traits(self) -> FrictionTraits:
        """The properties of the model."""
        return FRICTION_TRAITS[self.model]

    def summary(self) -> Plain:
        """As plain JSON values."""
        return plain_fields(self, torsion="torsion_m")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ContactLaw:
    """A contact law by its numbers: F_n = (lambda d(delta)/dt + K) delta^rho (Eq. 4), or a table instead of delta^rho.

    Attributes:
        stiffness: K [N/m^rho]; with a table the factor on its forces [-].
        damping: lambda [N s/m^(rho+1)]; with a table [s/m].
        exponent: rho [-]; 0 with a table.
        table: depths [m], rising from 0, and the forces [N] there (l, 2), to be joined by monotone cubics (Fritsch and
            Carlson) and continued by a straight line; empty: no table.
    """

    stiffness: float
    damping: float
    exponent: float
    table: Annotated[Array, "l 2"] = field(default_factory=lambda: np.zeros((0, 2)))

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanReserve:
    """What the squeeze withstands besides the weight; it was planned for all of it at once.

    Attributes:
        disturbance: force in any direction, as share of the weight [-].
        force: that force [N].
        moment: or a moment about any axis [N m].
        mass: the object may be lighter or heavier by this share [-].
        friction: share of friction on which the plan does not rely [-]; part of the friction's safety factor.
        normal_force: least normal force of each contact [N].
        torque: share of each torque limit that is kept free [-].
        softer: the contacts may be softer by this factor [-], with the hand's own servos.
        stiffer: or stiffer by this factor [-].
        drive: share by which the drives' efforts may differ [-], with the hand's own servos.
        tasks: what is done with the object, in words.
        loads: number of loads that stand for all of these.
        impact_times: number that a search tried; the forces are the proven optimum at the chosen one.
        above_unrestricted: share [-] by which the objective is above the proven least of a hand whose contacts and
            joints could all be chosen freely: at most this share is lost to couplings and shared motors.
    """

    disturbance: float
    force: float
    moment: float
    mass: float
    friction: float
    normal_force: float
    torque: float
    loads: int
    impact_times: int
    above_unrestricted: float = 0.0
    softer: float = 1.0
    stiffer: float = 1.0
    drive: float = 0.0
    tasks: tuple[str, ...] = ()

    __repr__ = brief()

    def summary(self) -> Plain:
        """As plain JSON values."""
        return plain_fields(self, force="force_N", moment="moment_Nm", normal_force="normal_force_N")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanCertificate:
    """Why the forces can be trusted, and how close to the optimum they are.

    Attributes:
        weights: what is minimised, ``{name: weight}``.
        objective: its value at the forces.
        lower_bound: proven for any admissible forces, in the same unit.
        relative_gap: their difference, relative to the objective's size [-].
        violation: largest violation of a limit [N].
        active: limits that the forces reach, in words.
        branches: intervals of t_I that were searched (b, 4): start [s], end [s], proven bound, best objective then.
    """

    weights: Mapping[str, float]
    objective: float
    lower_bound: float
    relative_gap: float
    violation: float
    active: tuple[str, ...]
    branches: Annotated[Array, "b 4", INFINITE]

    __repr__ = brief()

    def summary(self) -> Plain:
        """As plain JSON values, with the number of branches only."""
        return plain_fields(self, violation="violation_N") | {"branches": len(self.branches)}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanGrid:
    """What a grid search covered.

    Attributes:
        points: size of the grid.
        cells: its points in (t_I, A) alone.
        rejections: cells rejected, by constraint.
        qp_solves: QPs solved.
    """

    points: int
    cells: int
    rejections: Mapping[str, int]
    qp_solves: int

    __repr__ = brief()

    def summary(self) -> Plain:
        """As plain JSON values."""
        return plain_fields(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanForces:
    """Contact forces at t_F, and how they build up.

    Attributes:
        status: of the force search.
        search: its name.
        solver: which solver ran; empty: none.
        impact_time: t_I [s].
        final_time: t_F [s].
        forces_c: on the object, in the contact frames (k, 3) [N].
        multipliers: (k1, k2) of the paper's pyramid (k, 2) [-]; none (0, 2) with other friction.
        torsion: moments about the contact normals (k,) [N m].
        acceleration: decelerations A (k,) [m/s^2].
        work: grasp energy by Eq. (9) [J].
        impulse: grasp energy by Eq. (11) [N s].
        residual_force: norm of the residual force [N].
        residual_moment: norm of the residual moment [N m].
        depths: penetration over the motion's times (m, k) [m].
        rates: its rate (m, k) [m/s].
        normal_history: normal forces over the motion's times (m, k) [N].
        certificate: of a convex search; None: a grid search.
        grid: what a grid search covered; None: a convex search.
    """

    status: Status
    search: str
    solver: str
    impact_time: float
    final_time: float
    forces_c: Annotated[Array, "k 3"]
    multipliers: Annotated[Array, "* 2"]
    torsion: Annotated[Array, "k"]
    acceleration: Annotated[Array, "k"]
    work: float
    impulse: float
    residual_force: float
    residual_moment: float
    depths: Annotated[Array, "m k"]
    rates: Annotated[Array, "m k"]
    normal_history: Annotated[Array, "m k"]
    certificate: PlanCertificate | None
    grid: PlanGrid | None

    __repr__ = brief("status", "search", "solver", "impact_time", "normal_forces", "certificate")

    @property
    def normal_forces(self) -> Array:
        """F_n at t_F (k,) [N]."""
        return self.forces_c[:, 2]

    @property
    def final_depths(self) -> Array:
        """Penetration at t_F (k,) [m]."""
        last: Array = self.depths[-1]
        return last


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StiffnessBand:
    """The squeeze if contacts are softer or stiffer than planned, with the servos' positions as commanded.

    Attributes:
        servos: the servos that hold the joints, in words.
        factors: real over planned contact stiffness (s,) [-].
        normal_forces: resulting F_n (s, k) [N].
        remarks: per factor why the object is not held, in words; empty if it is.
    """

    servos: str
    factors: Annotated[Array, "s"]
    normal_forces: Annotated[Array, "s k"]
    remarks: Annotated[tuple[str, ...], "s"]

    __repr__ = brief("servos", "factors", "remarks")

    @property
    def lowest(self) -> Array:
        """Least F_n of each contact (k,) [N]."""
        least: Array = self.normal_forces.min(axis=0)
        return least

    @property
    def highest(self) -> Array:
        """Largest F_n of each contact (k,) [N]."""
        largest: Array = self.normal_forces.max(axis=0)
        return largest

    def summary(self, names: tuple[str, ...]) -> Plain:
        """As plain JSON values by the contacts' ``names``."""
        return plain_fields(self) | {"normal_forces_N": by_contact(names, self.normal_forces.T)}


WEAK = 0.02  # share of the weight: next to nothing


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlanMargins:
    """What the grasp withstands beyond its load with these normal forces, and its quality.

    Friction alone reacts; in a plan with a reserve the contacts give way as equal springs, too.

    Attributes:
        friction_used: share of the friction model's limit (k,) [-]; infinite: it slips.
        least_mu: friction coefficient with which the contact just holds (k,) [-].
        slip_distance: force to the friction limit (k,) [N].
        load_factor: multiple of the load that is held; infinite: any.
        disturbance: largest wrench that is held in any direction, moments over the moment length [N].
        weakest_direction: the direction of the least one (6,), or (3,) in force balance.
        disturbance_force: largest force that is held in any direction [N].
        disturbance_moment: largest moment about any axis [N m]; None where moments are not balanced.
        force_closure: whether the contacts can balance every wrench.
        ferrari_canny: epsilon (L1), certified from below.
        min_singular_value: smallest singular value of the grasp map.
        isotropy: of the grasp map.
        stiffness: of the grasp, 6 x 6, linear first [N/m, N, N m].
        band: forces on contacts softer or stiffer than planned; None: not computed, as in plans of older versions.
    """

    friction_used: Annotated[Array, "k", INFINITE]
    least_mu: Annotated[Array, "k"]
    slip_distance: Annotated[Array, "k"]
    load_factor: float
    disturbance: float
    weakest_direction: Annotated[Array, "w"]
    disturbance_force: float
    disturbance_moment: float | None
    force_closure: bool
    ferrari_canny: float
    min_singular_value: float
    isotropy: float
    stiffness: Annotated[Array, "6 6"]
    band: StiffnessBand | None = None

    __repr__ = brief("friction_used", "load_factor", "disturbance_force", "force_closure", "ferrari_canny")

    def spares_nothing(self, weight: float) -> bool:
        """Whether the weakest direction withstands next to nothing besides the load, compared with a weight [N]."""
        return self.disturbance < WEAK * number("weight", weight, at_least=0, unit="N")

    def summary(self, names: tuple[str, ...]) -> Plain:
        """As plain JSON values by the contacts' ``names``; None if a figure is infinite."""
        units = {
            "disturbance": "disturbance_any_N",
            "disturbance_force": "disturbance_force_N",
            "disturbance_moment": "disturbance_moment_Nm",
            "ferrari_canny": "ferrari_canny_L1",
            "slip_distance": "slip_distance_N",
            "stiffness": "stiffness_N_m",
        }
        return plain_fields(self, **units) | {
            "friction_used": by_contact(names, self.friction_used),
            "least_mu": by_contact(names, self.least_mu),
            "slip_distance_N": by_contact(names, self.slip_distance),
            "band": None if self.band is None else self.band.summary(names),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Reach:
    """Forces that the grasp withstands besides the load with the same squeeze, in the planes xy, xz, yz.

    Attributes:
        directions: unit vectors (3, d, 3).
        forces: the largest force along each (3, d) [N].
    """

    directions: Annotated[Array, "3 d 3"]
    forces: Annotated[Array, "3 d"]

    __repr__ = brief()


@dataclass(frozen=True, slots=True, kw_only=True)
class ComparisonRow:
    """A published figure beside ours.

    Attributes:
        quantity: its name.
        unit: of both figures.
        published: None if the publication prints nothing.
        ours: None if there is none.
        note: a remark.
    """

    quantity: str
    unit: str
    published: float | None
    ours: float | None
    note: str = ""

    __repr__ = brief()

    @property
    def difference(self) -> float | None:
        """ours - published."""
        return None if self.published is None or self.ours is None else self.ours - self.published

    def summary(self) -> Plain:
        """As plain JSON values."""
        return plain_fields(self) | {"difference": self.difference}
