"""The scene of a run at every instant, as one record for the live page and the HTML file."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from pinograsp.checks import brief, instance_of
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.plan import Motion, PlanRecord, Simulation
from pinograsp.plan.answer import (
    Answer,
    describe_robustness,
    does_it_hold,
    friction_model,
    list_forces,
    list_margins,
    planned_reserve,
)
from pinograsp.spatial import Array, BoolArray, IntArray
from pinograsp.viz.scene_meshes import Triangles, friction_cone
from pinograsp.viz.simulated import Simulated, sample_simulation
from pinograsp.viz.solids import Links, Solid, make_solids, to_sevens
from pinograsp.viz.stage import Held, Stage, choose_scale
from pinograsp.viz.style import contact_colours
from pinograsp.words import format_number

# Number of instants in the approach, in the grasp phase, and after it: the grasp phase is short but needs a close look.
_APPROACH, _GRASP, _HOLD = 150, 100, 150
_RATE = 30.0  # of them per second
THICKNESS = 0.011  # of arrows, over half the height or depth of the scene


class Phase(NamedTuple):
    """Its name, first and last instant."""

    name: str
    first: int
    last: int


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewScene:
    """A run as geometry and numbers, at f instants.

    Attributes:
        title: of the run.
        subtitle: hand and object.
        answer: whether the grasp holds.
        status: of the plan.
        remedy: of the plan; empty: none needed.
        heading: of the facts.
        facts: name and value with its unit.
        cautions: of the plan, in words.
        unseen: shapes that cannot be shown, in words.
        times: (f,) [s]; of a grasp closer together where forces build up.
        rate: instants per second at play speed 1.
        touch: t_I [s].
        closed: t_F [s], from when on the object is held; pages begin there.
        phases: name, first and last instant of each.
        told: what happens at each instant (f,), in a sentence.
        solids: of hand and object.
        link_poses: position [m] and quaternion w, x, y, z (f, l, 7).
        object_pose: likewise (7,); None: the plan has no object.
        carried: where the palm has carried object, contacts and forces, from where they were planned (f, 7), likewise;
            None: they stay there.
        contacts: their names (k).
        colours: of the contacts (k), ``#rrggbb``.
        points_o: contact points (k, 3) [m].
        rotations_oc: (k, 3, 3).
        cones: triangles in the contact frames (k).
        cone_height: [m].
        pyramids: whether the cones have edges.
        forces_o: on the object (f, k, 3) [N].
        normal: normal forces (f, k) [N].
        tangential: tangential forces (f, k) [N].
        used: share of Coulomb's cone, mu F_n, that is used (f, k); NaN without force.
        load_o: weight, inertia and other loads (f, 3) [N].
        com_o: centre of mass (3,) [m].
        joints: their names (n).
        fingers: joints by finger, for fingers that move or bear torque; each joint once.
        sliding: which joints slide (n,).
        q: joint positions (f, n) [rad or m].
        torques: (f, n) [N m or N].
        limits: of the torques (n,) [N m or N]; infinity: none.
        force_scale: length of arrows [m/N].
        up: direction against gravity (3,).
        ground: height of the ground along ``up`` [m].
        centre: point that the camera looks at (3,) [m].
        view: direction from there to the camera (3,).
        extent: half the size of the scene to the right, upwards and along ``view`` (3,) [m].
        thickness: radius of the arrows [m].
        simulated: the simulation; None: there is none.
    """

    title: str
    subtitle: str
    answer: Answer
    status: str
    remedy: str
    heading: str
    facts: tuple[tuple[str, str], ...]
    cautions: tuple[str, ...]
    unseen: tuple[str, ...]
    times: Array
    rate: float
    touch: float
    closed: float
    phases: tuple[Phase, ...]
    told: tuple[str, ...]
    solids: tuple[Solid, ...]
    link_poses: Array
    object_pose: Array | None
    carried: Array | None
    contacts: tuple[str, ...]
    colours: tuple[str, ...]
    points_o: Array
    rotations_oc: Array
    cones: tuple[Triangles, ...]
    cone_height: float
    pyramids: bool
    forces_o: Array
    normal: Array
    tangential: Array
    used: Array
    load_o: Array
    com_o: Array
    joints: tuple[str, ...]
    fingers: dict[str, list[int]]
    sliding: BoolArray
    q: Array
    torques: Array
    limits: Array
    force_scale: float
    up: Array
    ground: float
    centre: Array
    view: Array
    extent: Array
    thickness: float
    simulated: Simulated | None

    __repr__ = brief("title", "status", "answer", "contacts", "times", "simulated")

    @property
    def has_collision_shapes(self) -> bool:
        """Whether collision shapes can be drawn in place of what is seen."""
        return any(solid.look == "collision" for solid in self.solids)

    @property
    def cell(self) -> float:
        """Side of the ground's squares [m]."""
        return 0.01 if self.extent[1:].max() < 0.3 else 0.05

    def frame_at(self, time: float) -> int:
        """The instant nearest to ``time`` [s]."""
        return int(np.abs(self.times - time).argmin())

    def arrows(self, frame: int, scale: float | None = None) -> Array:
        """Start and end of the contact forces' arrows (k, 2, 3) [m] at ``scale`` [m/N], from the contacts.

        As planned, before anything is carried.
        """
        scale = self.force_scale if scale is None else scale
        return np.stack([self.points_o, self.points_o + scale * self.forces_o[frame]], axis=1)

    def load_arrow(self, frame: int, scale: float | None = None) -> Array:
        """Start and end of the load's (2, 3) [m], likewise."""
        scale = self.force_scale if scale is None else scale
        return np.stack([self.com_o, self.com_o + scale * self.load_o[frame]])

    def carry_points(self, points_o: Array, frame: int) -> Array:
        """Where planned points (..., 3) [m] are at an instant."""
        if self.carried is None:
            return points_o
        x, y, z, *turn = self.carried[frame]
        turned: Array = Rotation.from_quat(np.roll(turn, -1)).apply(np.array(points_o.reshape(-1, 3)))
        return np.asarray(turned.reshape(points_o.shape) + [x, y, z])

    def object_at(self, frame: int) -> Array | None:
        """Where the object is at an instant (7,)."""
        if self.carried is None or self.object_pose is None:
            return self.object_pose
        turn, own = (Rotation.from_quat(np.roll(pose[3:], -1)) for pose in (self.carried[frame], self.object_pose))
        return np.concatenate([self.carry_points(self.object_pose[:3], frame), np.roll((turn * own).as_quat(), 1)])

    def colour_of(self, part: str) -> str:
        """Colour of a part of the simulation: that of the contact with the same name, or of its own."""
        return self.colours[self.contacts.index(part)] if part in self.contacts else contact_colours([part])[0]


def make_scene(plan: PlanRecord, simulation: Simulation | None = None) -> ViewScene:
    """The scene of a plan, with a simulation of it.

    Raises:
        InvalidInput: a plan without its hand, or a simulation that is not one of this plan.
    """
    hand = instance_of("plan", plan, PlanRecord).require_hand()
    motion, contacts, body = plan.motion, plan.contacts, plan.body
    instance_of("simulation", simulation, Simulation, type(None))
    if simulation is not None and simulation.q.shape[1] != hand.n:
        raise InvalidInput(
            f"simulation: expected one of this plan's hand, {hand.n} joints, got {simulation.q.shape[1]}"
        )
    times, at = _instants(motion, simulation)
    links = Links(hand)
    colours = contact_colours(contacts.names, plan.layout.fingers)
    solids, unseen = make_solids(hand, body, links, dict(zip(contacts.links, colours)))
    link_poses, object_pose = links.poses(motion.q[at]), None if body is None else to_sevens(body.pose)
    stage = Stage(
        Held(plan.gravity_o, contacts.points_o, contacts.rotations_oc[:, :, 2], contacts.com_o),
        solids,
        link_poses,
        None if object_pose is None else np.tile(object_pose, (len(times), 1)),
    )
    largest = float(np.linalg.norm(np.vstack([motion.forces_o[-1], plan.load[:3]]), axis=1).max())
    simulated = None
    if simulation is not None:
        simulated = sample_simulation(plan, simulation, times, links, stage.beside)
        stage.add(simulated.beside)
    normal, tangential, used = split_forces(contacts.rotations_oc, plan.friction.mu, motion.forces_o[at])
    held, height = times > motion.times[-1], 0.16 * stage.size
    q, torques = motion.q[at], np.where(held[:, None], motion.holding_torques, motion.torques[at])
    centre, extent = stage.frame()
    touch, closed = float(motion.times[motion.impact]), float(motion.times[-1])
    return ViewScene(
        title=plan.name,
        subtitle=f"{hand.name}, {hand.n} joints" + ("" if body is None else f"; {name_object(body)}"),
        answer=does_it_hold(plan, simulation),
        status=str(plan.status),
        remedy=plan.remedy,
        heading="Margins of the grasp",
        facts=tuple(_list_facts(plan)),
        cautions=plan.cautions,
        unseen=tuple(unseen),
        times=times,
        rate=_RATE,
        touch=touch,
        closed=closed,
        phases=_phases(times, touch, closed),
        told=tuple(_tell(time, touch, closed, simulated is not None) for time in times.tolist()),
        solids=solids,
        link_poses=link_poses,
        object_pose=object_pose,
        carried=None,
        contacts=contacts.names,
        colours=colours,
        points_o=contacts.points_o,
        rotations_oc=contacts.rotations_oc,
        cones=tuple(friction_cone(float(mu), height, plan.friction.edges) for mu in plan.friction.mu),
        cone_height=height,
        pyramids=plan.friction.edges is not None,
        forces_o=motion.forces_o[at],
        normal=normal,
        tangential=tangential,
        used=used,
        load_o=np.tile(plan.load[:3], (len(times), 1)),
        com_o=contacts.com_o,
        joints=plan.layout.joints,
        fingers=list_busy_joints(plan.layout.fingers, q, torques),
        sliding=hand.slides,
        q=q,
        torques=torques,
        limits=plan.torque_limit,
        force_scale=choose_scale(stage.size, largest),
        up=stage.up,
        ground=stage.ground,
        centre=centre,
        view=stage.view,
        extent=extent,
        thickness=THICKNESS * float(extent[1:].max()),
        simulated=simulated,
    )


# -- time --------------------------------------------------------------------------------------------------------------


def list_busy_joints(fingers: Mapping[str, tuple[int, ...]], q: Array, torques: Array) -> dict[str, list[int]]:
    """Joints by finger, for fingers that move or bear torque; each joint once."""
    found: dict[str, list[int]] = {}
    seen: set[int] = set()
    for name, dofs in fingers.items():
        own = [int(i) for i in dofs if i not in seen]
        seen.update(own)
        if own and max(np.ptp(q[:, own], axis=0).max(), np.abs(torques[:, own]).max()) > 1e-6:
            found[str(name)] = own
    return found


def _instants(motion: Motion, simulation: Simulation | None) -> tuple[Array, IntArray]:
    """The instants shown (f,) [s], and the plan's sample for each: after its end, the last one."""
    times, last = motion.times, len(motion.times) - 1
    phases = np.r_[np.linspace(0, motion.impact, _APPROACH), np.linspace(motion.impact, last, _GRASP)]
    shown = np.unique(np.round(phases).astype(int))
    after = np.zeros(0)
    if simulation is not None and (later := simulation.times[simulation.times > times[-1]]).size:
        after = later[np.unique(np.linspace(0, later.size - 1, _HOLD).astype(int))]
    return np.r_[times[shown], after], np.r_[shown, np.full(after.size, last)]


def _phases(times: Array, touch: float, closed: float) -> tuple[Phase, ...]:
    """Those that are not empty."""
    i, j, last = int(np.abs(times - touch).argmin()), int(np.abs(times - closed).argmin()), len(times) - 1
    phases = (Phase("approach", 0, i), Phase("grasp", i, j), Phase("simulated hold", j, last))
    return tuple(phase for phase in phases if phase.first < phase.last)


def _tell(time: float, touch: float, closed: float, simulated: bool) -> str:
    """What happens at an instant [s], in a sentence."""
    if time < touch:
        return "Approach: the fingers close. Until the grasp is complete, something else carries the object."
    if time < closed:
        return "Grasp: the fingers press in, and the contact forces build up."
    if not simulated or time == closed:
        return "Grasp complete: the contact forces carry the load."
    return "Simulated hold: the object is let go, only the fingers hold it."


# -- forces ------------------------------------------------------------------------------------------------------------


def split_forces(rotations_oc: Array, mu: Array, forces_o: Array) -> tuple[Array, Array, Array]:
    """Normal forces, tangential forces (f, k) [N], and the share of Coulomb's cone, mu F_n, that they use (f, k)."""
    local = np.einsum("kji,fkj->fki", rotations_oc, forces_o)
    normal, tangential = local[..., 2], np.linalg.norm(local[..., :2], axis=2)
    pressing = normal > 1e-9 * max(float(normal.max(initial=0.0)), 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        used = tangential / (mu * normal)
    return normal, tangential, np.where(pressing & np.isfinite(used), used, np.nan)


def _list_facts(plan: PlanRecord) -> Iterator[tuple[str, str]]:
    """The plan in a few lines: energy, friction, margins."""
    yield "balance", {"wrench": "forces and moments", "force": "forces only"}[plan.balance]
    yield "friction", friction_model(plan.friction)
    yield "reserve planned", planned_reserve(plan.reserve)
    yield from list_forces(plan)
    if plan.forces.certificate is not None:
        yield "proven optimal", f"gap {plan.forces.certificate.relative_gap:.1e}"
    if plan.margins is not None:
        yield "it withstands", describe_robustness(plan)
        yield from list_margins(plan)
        least = round(float(plan.margins.slip_distance.min()), 6) + 0.0  # -0 becomes 0
        yield "least slip margin", f"{format_number(least, 3)} N"


def name_object(body: Body) -> str:
    """An object, for people."""
    return f"{type(body).__name__.lower()} of {body.mass:.4g} kg"
