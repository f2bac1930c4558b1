"""What there is to see of a run at every instant: the viewer's live page and its file draw the same record."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from pinograsp.checks import brief
from pinograsp.errors import InvalidInput
from pinograsp.hands.model import HandModel
from pinograsp.spatial import tangent_frame
from pinograsp.storage import Run, load_check
from pinograsp.viz.figures import COLOURS
from pinograsp.viz.scene_meshes import Links, Solid, Triangles, cloud_of, friction_cone, placed, sevens, solids_of
from pinograsp.words import (
    Answer,
    disturbance_held,
    does_it_hold,
    friction_model,
    friction_used,
    load_factor,
    number,
    shares,
    work,
)

# Instants shown in the approach, in the grasp phase, and after it: the shortest phase is the one to look at closely.
_APPROACH, _GRASP, _HOLD = 150, 100, 150
_ARROW = 0.3  # of the scene's size: length of the largest force's arrow, before it is rounded to a scale of 1, 2 or 5
_ELEVATION = np.radians(22.0)  # of the camera, unless something is in the way
_SAMPLES = 4000  # points on the hand that may hide contacts
_NEEDED = {
    "times",
    "impact",
    "q",
    "torques",
    "holding_torques",
    "forces_o",
    "normal_forces",
    "points_o",
    "rotations_oc",
    "com_o",
    "load",
    "gravity",
    "mu",
    "contact_links",
    "torque_limit",
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulated:
    """A simulation of the plan at the scene's f instants.

    Attributes:
        held, reason, engine: the verdict in words.
        release: when the object was let go [s]; None: never.
        link_poses: (f, l, 7), object_poses: (f, 7): position [m] and quaternion w, x, y, z.
        parts: of the hand that touch (p).
        planned: F_n at t_F (p,) [N].
        normal_forces: (f, p) [N].
        forces_o: (f, p, 3) [N].
        points_b: where they are drawn, in the body frame (p, 3) [m]: the mean of a part's planned contacts; NaN: not
            known.
        drift: of the object since t_F (f,) [m].
        beside: how far to move it so that it stands beside the plan (3,) [m].
    """

    held: bool
    reason: str
    engine: str
    release: float | None
    link_poses: np.ndarray
    object_poses: np.ndarray
    parts: tuple[str, ...]
    planned: np.ndarray
    normal_forces: np.ndarray
    forces_o: np.ndarray
    points_b: np.ndarray
    drift: np.ndarray
    beside: np.ndarray

    __repr__ = brief()

    def arrows(self, frame: int, scale: float) -> np.ndarray:
        """Start and end of the forces' arrows (p, 2, 3) [m] at ``scale`` [m/N]; of no length where it is not known
        where they act.
        """
        pose, known = self.object_poses[frame], np.isfinite(self.points_b).all(axis=1)[:, None]
        start = Rotation.from_quat(pose[[4, 5, 6, 3]]).apply(np.where(known, self.points_b, 0.0)) + pose[:3]
        return np.stack([start, start + scale * np.where(known, self.forces_o[frame], 0.0)], axis=1)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewScene:
    """A run as geometry and numbers, at f instants.

    Attributes:
        title, subtitle: of the run.
        answer: whether it holds.
        status, remedy: of the plan.
        facts: (what, value with its unit).
        cautions: in words.
        times: (f,) [s]; closer together where forces build up.
        touch, closed: t_I and t_F [s].
        solids: of hand and object.
        link_poses: (f, l, 7), object_pose: (7,) or None: position [m], quaternion w, x, y, z.
        contacts: names (k).
        colours: (k) ``#rrggbb``.
        points_o: (k, 3) [m].
        rotations_oc: (k, 3, 3).
        cones: (k) triangles in the contact frames, of ``cone_height`` [m].
        pyramids: whether they have edges.
        forces_o: on the object (f, k, 3) [N].
        normal, tangential: (f, k) [N].
        used: share of Coulomb's cone, mu F_n (f, k), NaN without force.
        load_o: weight and other loads (3,) [N].
        com_o: (3,) [m].
        joints: names (n).
        fingers: joints by finger, of those that move or bear torque; each joint once.
        sliding: (n,).
        q: (f, n) [rad, m].
        torques: (f, n), limits: (n,), infinity: none [N m, N].
        force_scale: length of arrows [m/N].
        up: (3,).
        ground: its height along ``up`` [m].
        centre: what to look at [m], from the direction ``view`` (3,); ``extent``: half the size of the scene to the
            right, upwards and along ``view`` [m].
        simulated: or None.
    """

    title: str
    subtitle: str
    answer: Answer
    status: str
    remedy: str
    facts: tuple[tuple[str, str], ...]
    cautions: tuple[str, ...]
    times: np.ndarray
    touch: float
    closed: float
    solids: tuple[Solid, ...]
    link_poses: np.ndarray
    object_pose: np.ndarray | None
    contacts: tuple[str, ...]
    colours: tuple[str, ...]
    points_o: np.ndarray
    rotations_oc: np.ndarray
    cones: tuple[Triangles, ...]
    cone_height: float
    pyramids: bool
    forces_o: np.ndarray
    normal: np.ndarray
    tangential: np.ndarray
    used: np.ndarray
    load_o: np.ndarray
    com_o: np.ndarray
    joints: tuple[str, ...]
    fingers: dict[str, list[int]]
    sliding: np.ndarray
    q: np.ndarray
    torques: np.ndarray
    limits: np.ndarray
    force_scale: float
    up: np.ndarray
    ground: float
    centre: np.ndarray
    view: np.ndarray
    extent: np.ndarray
    simulated: Simulated | None

    __repr__ = brief("title", "status", "answer", "contacts", "times", "simulated")

    @property
    def cell(self) -> float:
        """Side of the ground's squares [m]."""
        return 0.01 if self.extent[1:].max() < 0.3 else 0.05

    def frame_at(self, time: float) -> int:
        """The instant nearest to ``time`` [s]."""
        return int(np.abs(self.times - time).argmin())

    def arrows(self, frame: int, scale: float | None = None) -> np.ndarray:
        """Start and end of the contact forces' arrows (k, 2, 3) [m] at ``scale`` [m/N]: from the contact along the
        force.
        """
        scale = self.force_scale if scale is None else scale
        return np.stack([self.points_o, self.points_o + scale * self.forces_o[frame]], axis=1)

    def colour_of(self, part: str, i: int) -> str:
        """The colour of the simulation's part ``i``: its contact's, where one has its name."""
        return self.colours[self.contacts.index(part)] if part in self.contacts else COLOURS[i % len(COLOURS)]

    def phase(self, frame: int) -> str:
        """What happens then, in a sentence."""
        time = self.times[frame]
        if time < self.touch:
            return "Approach: the fingers close. Until the grasp is complete, something else carries the object."
        if time < self.closed:
            return "Grasp: the fingers press in, and the contact forces build up."
        if self.simulated is None or time == self.closed:
            return "Grasp complete: the contact forces carry the load."
        return "Simulated hold: the object is let go, only the fingers hold it."


def scene_of(run: Run, simulation=None) -> ViewScene:
    """The scene of a run, with a simulation of it: a :class:`~pinograsp.referee.simulation.Simulation`, or a check's
    folder.

    Raises:
        InvalidInput: a run without a plan or without its hand, or a simulation that is not one of this run.
    """
    if not isinstance(run, Run):
        raise InvalidInput(f"viewer: expected a run (pinograsp.load_run, pinograsp.run_of), got {type(run).__name__}")
    if missing := sorted(_NEEDED - run.arrays.keys()):
        why = run.summary.get("status", "unknown")
        raise InvalidInput(
            f"viewer: expected a run with a plan, got one without {', '.join(missing)} (status {why}): plan it again"
        )
    hand, thing = run.hand(), run.object() if run.scene.get("object") is not None else None
    arrays, layout = run.arrays, run.layout
    if arrays["q"].shape[1] != hand.n or len(layout["contacts"]) != len(arrays["points_o"]):
        raise InvalidInput(
            f"viewer: expected a run whose arrays are those of its hand ({hand.n} joints): plan it again"
        )
    try:
        facts = tuple(_facts(run))
    except (KeyError, TypeError) as error:
        raise InvalidInput(f"viewer: expected the summary of a plan, got one without {error}: plan it again") from error
    check = None if simulation is None else _check_of(simulation, hand.n)
    times, plan = _instants(arrays, check)
    links = Links(hand)
    colours = tuple(COLOURS[i % len(COLOURS)] for i in range(len(arrays["points_o"])))
    solids = solids_of(hand, thing, links, dict(zip((str(link) for link in arrays["contact_links"]), colours)))
    link_poses = links.poses(arrays["q"][plan])
    object_pose = None if thing is None else sevens(thing.pose)
    forces = arrays["forces_o"][plan]
    normal, tangential, used = _friction_used(run, forces)

    gravity = arrays["gravity"]
    up = -gravity / np.linalg.norm(gravity) if np.any(gravity) else np.array([0.0, 0.0, 1.0])
    cloud = np.concatenate(
        [cloud_of(solids, link_poses[i], object_pose) for i in np.linspace(0, len(times) - 1, 8).astype(int)]
    )
    view = _view(
        up, arrays["points_o"], arrays["rotations_oc"][:, :, 2], _spread(solids, link_poses[-1]), arrays["com_o"]
    )
    size = float(np.ptp(cloud, axis=0).max())
    right = np.cross(up, view) / np.linalg.norm(np.cross(up, view))
    simulated = None
    if check is not None:
        simulated = _simulated(run, check, times, links, hand, thing, 1.15 * np.ptp(cloud @ right) * right)
        cloud = np.concatenate([cloud, cloud + simulated.beside])
    axes = np.stack([right, np.cross(view, right), view])
    low, high = (cloud @ axes.T).min(axis=0), (cloud @ axes.T).max(axis=0)
    largest = np.linalg.norm(np.vstack([arrays["forces_o"][-1], arrays["load"][:3]]), axis=1).max()
    scale = _rounded(_ARROW * size / max(float(largest), 1e-9))
    friction, height = run.summary["friction"], 0.16 * size
    edges = friction["edges"] if friction["model"] == "pyramid" else None
    held = times > arrays["times"][-1]
    q, torques = arrays["q"][plan], np.where(held[:, None], arrays["holding_torques"], arrays["torques"][plan])
    return ViewScene(
        title=str(run.settings.get("name", layout["hand"])),
        subtitle=f"{hand.name}, {hand.n} joints" + ("" if thing is None else f"; {_in_words(thing)}"),
        answer=does_it_hold(run.summary, check),
        status=str(run.summary["status"]),
        remedy=str(run.summary.get("remedy", "")),
        facts=facts,
        cautions=tuple(map(str, run.summary.get("cautions", ()))),
        times=times,
        touch=float(arrays["times"][int(arrays["impact"])]),
        closed=float(arrays["times"][-1]),
        solids=solids,
        link_poses=link_poses,
        object_pose=object_pose,
        contacts=tuple(map(str, layout["contacts"])),
        colours=colours,
        points_o=arrays["points_o"],
        rotations_oc=arrays["rotations_oc"],
        cones=tuple(friction_cone(float(mu), height, edges) for mu in arrays["mu"]),
        cone_height=height,
        pyramids=edges is not None,
        forces_o=forces,
        normal=normal,
        tangential=tangential,
        used=used,
        load_o=arrays["load"][:3],
        com_o=arrays["com_o"],
        joints=tuple(map(str, layout["joints"])),
        fingers=_busy(layout["fingers"], q, torques),
        sliding=np.array([hand.is_prismatic(hand.model.getJointId(name)) for name in hand.joint_names]),
        q=q,
        torques=torques,
        limits=arrays["torque_limit"],
        force_scale=scale,
        up=up,
        ground=float((cloud @ up).min()),
        centre=(low + high) / 2 @ axes,
        view=view,
        extent=(high - low) / 2,
        simulated=simulated,
    )


# -- time --------------------------------------------------------------------------------------------------------------


def _busy(fingers: dict, q: np.ndarray, torques: np.ndarray) -> dict[str, list[int]]:
    """Joints by finger, of the fingers that move or bear torque; each joint once."""
    busy, seen = {}, set()
    for name, dofs in fingers.items():
        own = [int(i) for i in dofs if i not in seen]
        seen.update(own)
        if own and max(np.ptp(q[:, own], axis=0).max(), np.abs(torques[:, own]).max()) > 1e-6:
            busy[str(name)] = own
    return busy


def _instants(arrays, check) -> tuple[np.ndarray, np.ndarray]:
    """The instants shown (f,) [s], and the plan's sample at each; after its end it stays as it is."""
    times, impact = arrays["times"], int(arrays["impact"])
    last = len(times) - 1
    shown = np.unique(np.round(np.r_[np.linspace(0, impact, _APPROACH), np.linspace(impact, last, _GRASP)]).astype(int))
    after = np.zeros(0)
    if check is not None and (later := check["times"][check["times"] > times[-1]]).size:
        after = later[np.unique(np.linspace(0, later.size - 1, _HOLD).astype(int))]
    return np.r_[times[shown], after], np.r_[shown, np.full(after.size, last)]


# -- the view ----------------------------------------------------------------------------------------------------------


def _view(up, points, normals, samples, com) -> np.ndarray:
    """Unit direction (3,) towards the camera.

    Of a ring of directions the one from which the hand hides the least around the contacts, and from which normals are
    seen from the side: there arrows and cones are long.

    Args:
        up: (3,).
        points: of the contacts (k, 3).
        normals: (k, 3).
        samples: points spread evenly over the hand's surface (s, 3), and the area each stands for [m^2].
        com: of the object (3,).
    """
    on_hand, area = samples
    x, y = tangent_frame(up, np.zeros(3)).T[:2]
    turn, lift = (
        part.ravel()[:, None] for part in np.meshgrid(np.radians(np.arange(0, 360, 10)), np.radians([10.0, 22.0, 35.0]))
    )
    views = np.cos(lift) * (np.cos(turn) * x + np.sin(turn) * y) + np.sin(lift) * up
    targets = np.vstack([points, com])
    radius = 0.06 * np.ptp(on_hand, axis=0).max(initial=1e-3)
    hidden = np.empty(len(views))
    for i, view in enumerate(views):
        offset = on_hand[None] - targets[:, None]
        depth = offset @ view
        aside = (offset**2).sum(axis=2) - depth**2
        # Half of a closed surface faces away: what is in front covers with half its area.
        covered = ((aside < radius**2) & (depth > 0.1 * radius)).sum(axis=1) * area / 2 / (np.pi * radius**2)
        hidden[i] = np.minimum(covered, 1.0).mean()
    along = ((views @ normals.T) ** 2).mean(axis=1)
    return views[(hidden + 0.35 * along + 0.3 * np.abs(lift[:, 0] - _ELEVATION)).argmin()]


def _spread(solids, link_poses: np.ndarray) -> tuple[np.ndarray, float]:
    """Points (s, 3) spread evenly over the hand [m], and the area that each stands for [m^2]."""
    corners = [placed(solid, link_poses[solid.link])[solid.faces] for solid in solids if solid.link is not None]
    corners = np.concatenate([np.zeros((0, 3, 3)), *corners])
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) / 2
    if not area.sum() > 0:
        return np.zeros((0, 3)), 0.0
    rng = np.random.default_rng(0)
    chosen = corners[rng.choice(len(corners), _SAMPLES, p=area / area.sum())]
    weights = rng.dirichlet(np.ones(3), _SAMPLES)
    return np.einsum("si,sij->sj", weights, chosen), float(area.sum() / _SAMPLES)


def _rounded(scale: float) -> float:
    """The nearest of 1, 2, 5 times a power of ten."""
    powers = 10.0 ** np.arange(-9, 10)
    nice = np.outer(powers, [1.0, 2.0, 5.0]).ravel()
    return float(nice[np.abs(np.log(nice / scale)).argmin()])


# -- forces ------------------------------------------------------------------------------------------------------------


def _friction_used(run: Run, forces: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Normal and tangential forces (f, k) [N] and the share of Coulomb's cone, mu F_n, that they use."""
    local = np.einsum("kji,fkj->fki", run.arrays["rotations_oc"], forces)
    normal, tangential = local[..., 2], np.linalg.norm(local[..., :2], axis=2)
    pressing = normal > 1e-9 * max(float(normal.max(initial=0.0)), 1e-9)
    with np.errstate(divide="ignore", invalid="ignore"):
        used = tangential / (run.arrays["mu"] * normal)
    return normal, tangential, np.where(pressing & np.isfinite(used), used, np.nan)


def _facts(run: Run):
    """The plan in a few lines: energy, friction, margins."""
    s, law = run.summary, run.arrays.get("contact_law")
    yield "balance", {"wrench": "forces and moments", "force": "forces only"}.get(s["balance"], s["balance"])
    yield "friction", friction_model(s["friction"])
    yield "grasp energy (work)", work(s["work_J"], None if law is None else float(law[2]))
    if s.get("certificate"):
        yield "proven optimal", f"gap {s['certificate']['relative_gap']:.1e}"
    yield "net force, moment", f"{s['residual_N']:.1e} N, {s['residual_Nm']:.1e} N m"
    yield "largest penetration", f"{1e3 * s['max_penetration_m']:.3g} mm"
    yield "peak joint torque", f"{s['peak_torque_Nm']:.3g} N m"
    if margins := s.get("margins"):
        for what, values in friction_used(s):
            yield what, shares(values)
        yield "load held by these forces", load_factor(margins)
        yield "disturbance held besides", disturbance_held(margins, s["friction"]["safety"])
        least = round(min(margins["slip_distance_N"].values()), 6) + 0.0  # forces on the limit: -0 is 0
        yield "least slip margin", f"{number(least, 3)} N"
        closed = "force closure" if margins["force_closure"] else "no force closure"
        yield "grasp", f"{closed}, Ferrari-Canny epsilon {number(margins['ferrari_canny_L1'], 3)}"


# -- the simulation ----------------------------------------------------------------------------------------------------


def _check_of(simulation, n: int) -> dict:
    """Summary and arrays of a simulation, or of the folder that ``pinograsp check`` wrote."""
    if isinstance(simulation, str | Path):
        summary, arrays = load_check(simulation)
    elif hasattr(simulation, "summary") and hasattr(simulation, "arrays"):
        summary, arrays = simulation.summary(), simulation.arrays()
    else:
        raise InvalidInput(
            f"simulation: expected a simulation or the folder of a check, got {type(simulation).__name__}"
        )
    check = {**summary, **arrays}
    parts = len(check.get("planned_forces_N", ()))
    wanted = {"q": (n,), "object_poses": (4, 4), "normal_forces": (parts,), "forces_o": (parts, 3)}
    samples = len(check.get("times", ()))
    for name, shape in wanted.items():
        if samples == 0 or np.shape(check.get(name)) != (samples, *shape):
            raise InvalidInput(
                f"simulation: expected one of this run's hand ({name} of shape {(samples, *shape)}), got "
                f"{np.shape(check.get(name))}"
            )
    return check


def _simulated(run: Run, check: dict, times, links: Links, hand: HandModel, thing, beside) -> Simulated:
    at = np.clip(np.searchsorted(check["times"], times - 1e-9), 0, len(check["times"]) - 1)
    poses, parts = check["object_poses"], tuple(check["planned_forces_N"])
    pose = poses[0] if thing is None else thing.pose
    points_b = (run.arrays["points_o"] - pose[:3, 3]) @ pose[:3, :3]
    joints = np.array([_joint(hand, str(link)) for link in run.arrays["contact_links"]])
    where = np.full((len(parts), 3), np.nan)
    for i, part in enumerate(parts):
        own = np.array([name == part for name in run.layout["contacts"]])
        own = own if own.any() else (joints == _joint(hand, part)) & (joints >= 0)
        if own.any():
            where[i] = points_b[own].mean(axis=0)
    complete = int(np.abs(check["times"] - run.arrays["times"][-1]).argmin())
    drift = np.linalg.norm(poses[:, :3, 3] - poses[complete, :3, 3], axis=1)
    drift[:complete] = 0.0
    return Simulated(
        held=bool(check["held"]),
        reason=str(check["reason"]),
        engine=str(check["engine"]),
        release=check["release_s"],
        link_poses=links.poses(check["q"][at]),
        object_poses=sevens(poses[at]),
        parts=parts,
        planned=np.array(list(check["planned_forces_N"].values())),
        normal_forces=check["normal_forces"][at],
        forces_o=check["forces_o"][at],
        points_b=where,
        drift=drift[at],
        beside=beside,
    )


def _joint(hand: HandModel, link: str) -> int:
    """Index of the joint that carries a link; -1 where the hand has no such link."""
    return hand.model.frames[hand.frame_id(link)].parentJoint if hand.model.existFrame(link) else -1


def _in_words(thing) -> str:
    return f"{type(thing).__name__.lower()} of {thing.mass:.4g} kg"
