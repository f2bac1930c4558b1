"""The viewer: what it draws is where and as large as it should be, and real browsers show it."""

from __future__ import annotations

import base64
import contextlib
import io
import itertools
import json
import re
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import coal
import numpy as np
import pinocchio as pin
import pytest
from marks import slow_except
from matplotlib.image import imread
from panda_path import JOINTS, START, WAYPOINTS
from scipy.spatial.transform import Rotation
from shipped_hands import SOME_HANDS, loaded

from pinograsp.carry import plan_carry
from pinograsp.carry.scene import carry_scene
from pinograsp.cases import load_case
from pinograsp.contacts.friction import Friction
from pinograsp.errors import ExtraMissing, InvalidInput, ResultsNotWritten, Status
from pinograsp.forces import GraspConditions
from pinograsp.hands import load_hand
from pinograsp.hands.catalogue import CATALOGUE, file_of
from pinograsp.objects import Box, Cylinder, Mesh
from pinograsp.plan import (
    ContactLaw,
    Layout,
    Motion,
    PlanContacts,
    PlanForces,
    PlanFriction,
    PlanGrid,
    PlanRecord,
)
from pinograsp.planner import GraspPlan, plan_grasp, plan_grasp_on, save_run
from pinograsp.report import write_report
from pinograsp.simulation import simulate
from pinograsp.spatial import pose_of, tangent_frame
from pinograsp.storage import newest_check, read_check, write_simulation
from pinograsp.viz.figures import save_figures
from pinograsp.viz.page import render_page
from pinograsp.viz.scene import make_scene
from pinograsp.viz.scene_meshes import friction_cone, triangulate
from pinograsp.viz.solids import to_sevens
from pinograsp.viz.still import draw_picture
from pinograsp.viz.style import encode_figure
from pinograsp.viz.viewer import save_html, view


@pytest.fixture(scope="module")
def plan():
    return load_case(
        "paper",
        {"forces.search": "convex", "forces.balance": "wrench", "friction.safety": 1.1, "motion.touch": "surface"},
    ).plan()


@pytest.fixture(scope="module")
def run(plan) -> GraspPlan:
    return plan.with_margins().with_reach()


@pytest.fixture(scope="module")
def simulation(plan):
    return simulate(plan, hold=0.1)


def run_with(hand, seed: int = 0) -> PlanRecord:
    """A plan of a hand that closes and presses with three fingertips' worth of made-up forces on a cylinder."""
    rng = np.random.default_rng(seed)
    times = np.linspace(0, 1, 60)
    lower, upper = np.maximum(hand.lower, -2.0), np.minimum(hand.upper, 2.0)
    q = lower + (0.2 + 0.5 * times[:, None]) * (upper - lower)
    links = [finger.links[-1] for finger in hand.fingers]
    points = hand.frame_placements(q[-1], links)[:, :3, 3]
    thing = Cylinder(radius=0.02, height=0.1, mass=0.3, pose=pose_of(points.mean(axis=0) + 1e-3))
    normals = thing.com_o - points
    rotations = np.array([tangent_frame(normal) for normal in normals])
    strength = np.where(times[:, None] > 0.8, times[:, None] - 0.8, 0.0) * rng.uniform(5, 20, len(links))
    forces = np.einsum("mk,kij,j->mki", strength, rotations, [0.2, 0.1, 1.0])
    mu, k = np.full(len(links), 0.5), len(links)
    motion = Motion(
        status=Status.OK,
        notes=(),
        times=times,
        impact=48,
        q=q,
        dq=np.gradient(q, times, axis=0),
        ddq=np.zeros_like(q),
        torques=0.1 * q,
        holding_torques=0.1 * q[-1],
        settled_forces=strength[-1],
        forces_o=forces,
        contact_velocities=np.zeros_like(forces),
        tracking_error=np.zeros(k),
        slip=np.zeros(k),
        postures={},
        peak_torque=0.2,
    )
    pressed = PlanForces(
        status=Status.OK,
        search="hybrid",
        solver="",
        impact_time=times[48],
        final_time=1.0,
        forces_c=strength[-1][:, None] * [0.2, 0.1, 1.0],
        multipliers=np.zeros((0, 2)),
        torsion=np.zeros(k),
        acceleration=np.ones(k),
        work=0.01,
        impulse=0.5,
        residual_force=0.0,
        residual_moment=0.0,
        depths=1e-4 * strength,
        rates=np.zeros_like(strength),
        normal_history=strength,
        certificate=None,
        grid=PlanGrid(points=1, cells=1, rejections={}, qp_solves=0),
    )
    return PlanRecord(
        layout=Layout(
            hand=hand.name,
            joints=tuple(hand.joint_names),
            fingers={finger.name: tuple(finger.dofs.tolist()) for finger in hand.fingers},
        ),
        hand=hand,
        body=thing,
        contacts=PlanContacts(
            names=tuple(links), links=tuple(links), points_o=points, rotations_oc=rotations, com_o=thing.com_o
        ),
        friction=PlanFriction(mu=mu, model="cone", edges=None, safety=1.0, torsion=0.0),
        law=ContactLaw(stiffness=5e4, damping=100.0, exponent=1.5),
        load=np.array([0, 0, -2.943, 0, 0, 0]),
        gravity_o=np.array([0, 0, -9.81]),
        body_mass=0.3,
        balance="wrench",
        measure="work",
        torque_limit=hand.effort_or_infinity,
        forces=pressed,
        motion=motion,
    )


# -- geometry ----------------------------------------------------------------------------------------------------------


def volume(vertices, faces) -> float:
    """By the divergence theorem: positive where faces wind outwards."""
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    return float((a * np.cross(b, c)).sum() / 6)


def hull_points(count: int = 60) -> np.ndarray:
    return np.random.default_rng(3).normal(size=(count, 3))


def hull_of_points():
    from scipy.spatial import ConvexHull

    return Mesh(
        vertices=hull_points(), faces=ConvexHull(hull_points()).simplices, mass=1.0, convex=True
    ).collision_geometry


@pytest.mark.parametrize(
    "shape, least",
    [
        (coal.Box(0.1, 0.2, 0.3), 1.0),
        (coal.Sphere(0.1), 0.98),
        (coal.Ellipsoid(0.1, 0.02, 0.3), 0.98),
        (coal.Capsule(0.05, 0.2), 0.98),
        (coal.Cylinder(0.05, 0.2), 0.99),
        (hull_of_points(), 1.0),
    ],
    ids=lambda value: type(value).__name__ if not isinstance(value, float) else "",
)
def test_triangles_fill_the_shape_they_stand_for(shape, least):
    """Inscribed, so slightly less volume; outwards, or it would be negative."""
    vertices, faces = triangulate(shape)
    assert least * shape.computeVolume() * (1 - 1e-9) <= volume(vertices, faces) <= shape.computeVolume() * (1 + 1e-9)
    shape.computeLocalAABB()
    assert np.allclose(vertices.min(axis=0), np.ravel(shape.aabb_local.min_), atol=2e-3)
    assert np.allclose(vertices.max(axis=0), np.ravel(shape.aabb_local.max_), atol=2e-3)


def test_creases_are_sharp_and_round_parts_smooth():
    box, _ = triangulate(coal.Box(1, 1, 1))
    assert len(box) == 24  # a corner for each of three faces
    ball, _faces = triangulate(coal.Sphere(1.0))
    assert len(ball) == len(np.unique(ball.round(9), axis=0))  # no vertex twice
    cylinder, _ = triangulate(coal.Cylinder(1.0, 2.0))
    rim = cylinder[np.abs(np.linalg.norm(cylinder[:, :2], axis=1) - 1) < 1e-9]
    assert len(rim) == 2 * len(np.unique(rim.round(9), axis=0))  # rims twice: for the side and for the cap


def test_unknown_shapes_are_refused():
    with pytest.raises(InvalidInput, match="got Halfspace"):
        triangulate(coal.Halfspace(np.array([0, 0, 1.0]), 0.0))


@pytest.mark.parametrize("mu", [0.1, 0.7, 1.5])
@pytest.mark.parametrize("edges", [None, 4, 8])
def test_friction_cones_have_the_half_angle_of_mu(mu, edges):
    vertices, faces = friction_cone(mu, 0.03, edges)
    rim = np.unique(vertices[vertices[:, 2] > 0].round(12), axis=0)
    assert np.allclose(rim[:, 2], 0.03)
    assert np.allclose(np.arctan2(np.linalg.norm(rim[:, :2], axis=1), rim[:, 2]), np.arctan(mu))
    assert len(rim) == (edges or len(rim)) and len(faces) == len(rim)
    if edges:  # its edges are where the problem's are
        wanted = mu * 0.03 * Friction(model="pyramid", edges=edges).vertices
        assert np.allclose(sorted(rim[:, :2].round(9).tolist()), sorted(wanted.round(9).tolist()))


@pytest.fixture(scope="module", params=slow_except(CATALOGUE, *SOME_HANDS))
def drawn(request):
    """A hand of the catalogue: its name, a plan of it, what is drawn of that."""
    run = run_with(loaded(request.param))
    return request.param, run, make_scene(run)


def test_every_hand_of_the_catalogue_can_be_drawn(drawn):
    """Each part lies where Pinocchio places its geometry, at the start and at the end; coal knows how large it is."""
    _, run, scene = drawn
    hand = run.hand
    parts = hand.geometry.geometryObjects
    solids = [solid for solid in scene.solids if solid.look != "visual"]
    assert [solid.name for solid in solids] == [one.name for one in parts] + ["object"]
    data, geometry = hand.model.createData(), pin.GeometryData(hand.geometry)
    for frame, q in ((0, run.motion.q[0]), (-1, run.motion.q[-1])):
        pin.updateGeometryPlacements(hand.model, data, hand.geometry, geometry, q)
        for solid, one, place in zip(solids, parts, geometry.oMg):
            pose = scene.link_poses[frame, solid.link]
            drawn = solid.vertices @ pin.Quaternion(*pose[3:]).toRotationMatrix().T + pose[:3]
            own = (drawn - place.translation) @ place.rotation
            one.geometry.computeLocalAABB()
            box = np.array([np.ravel(one.geometry.aabb_local.min_), np.ravel(one.geometry.aabb_local.max_)])
            assert (
                np.abs(np.array([own.min(axis=0), own.max(axis=0)]) - box).max()
                < 2e-3 * np.ptp(box, axis=0).max() + 1e-6
            )
    assert np.ptp(scene.link_poses, axis=0).max() > 1e-3  # it moves
    assert np.isfinite(scene.extent).all() and scene.extent.min() > 0


def test_links_are_drawn_as_they_are_hulls_where_nothing_else_is_known():
    hand = replace(load_hand("psyonic_right"), visuals=())
    for solid, own in zip(make_scene(run_with(hand)).solids, hand.own_shapes):
        assert volume(solid.vertices, solid.faces) == pytest.approx(own.computeVolume(), rel=1e-6)
    hand = replace(hand, own_shapes=())
    for solid, one in zip(make_scene(run_with(hand)).solids, hand.geometry.geometryObjects):
        assert volume(solid.vertices, solid.faces) == pytest.approx(one.geometry.computeVolume(), rel=1e-6)


def test_every_hand_of_the_catalogue_is_seen(drawn, tmp_path):
    """What is seen of a link lies where its collision shapes do, and the page is small."""
    name, run, scene = drawn
    assert not scene.unseen
    shapes = [solid for solid in scene.solids if solid.link is not None]
    looks = {solid.look for solid in shapes} - {"always"}  # the paper's hand is seen as it touches
    assert looks == (set() if name == "humanoid" else {"visual", "collision"})
    for link in {solid.link for solid in shapes if solid.look == "visual"}:
        seen, solid = (
            np.concatenate([one.vertices for one in shapes if one.link == link and one.look == look])
            for look in ("visual", "collision")
        )
        apart = np.abs(seen.mean(axis=0) - solid.mean(axis=0)).max()
        assert apart < 0.6 * np.ptp(solid, axis=0).max()
        assert 0.3 < np.linalg.norm(np.ptp(seen, axis=0)) / np.linalg.norm(np.ptp(solid, axis=0)) < 2
    assert save_html(run, tmp_path / "a.html").stat().st_size < 2e6


def test_links_that_touch_take_the_colour_of_their_contact():
    hand = load_hand("allegro_right")
    scene = make_scene(run_with(hand))
    tip = hand.fingers[0].links[-1]
    colours = {solid.name.rpartition(" seen")[0]: solid.colour for solid in scene.solids if solid.look == "visual"}
    assert colours[tip] not in (colours["link_1.0"], colours[hand.fingers[1].links[-1]])
    assert colours["link_1.0"] == colours["link_5.0"]  # black, as the file says, so that shading is seen
    assert 30 < int(colours["link_1.0"][1:3], 16) < 120


def test_a_run_whose_pictures_are_gone_shows_collision_shapes(tmp_path):
    hand = load_hand("panda")
    gone = tuple(replace(one, path=str(tmp_path / "gone.dae")) for one in hand.visuals)
    scene = make_scene(run_with(replace(hand, visuals=gone)))
    assert {solid.look for solid in scene.solids} == {"always"}
    assert any("gone.dae' is not there" in one for one in scene.unseen)
    some = make_scene(run_with(replace(hand, visuals=(*hand.visuals[:1], *gone[1:]))))
    looks = {solid.link: set() for solid in some.solids}
    for solid in some.solids:
        looks[solid.link].add(solid.look)
    assert sorted(map(sorted, looks.values())) == [["always"], ["always"], ["always"], ["collision", "visual"]]


# -- forces and numbers ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_arrows_are_in_proportion_to_the_forces(run):
    scene = make_scene(run)
    for instant in (0.3, 0.95, 1.0):
        i = scene.frame_at(instant)
        arrows = scene.arrows(i)
        sample = int(np.abs(run.motion.times - scene.times[i]).argmin())
        forces = run.motion.forces_o[sample]
        assert np.allclose(arrows[:, 0], run.contacts.points_o)
        assert np.allclose(arrows[:, 1] - arrows[:, 0], scene.force_scale * forces, atol=1e-12)
        assert np.allclose(scene.arrows(i, 0.002)[:, 1] - arrows[:, 0], 0.002 * forces, atol=1e-12)
    assert np.all(scene.arrows(scene.frame_at(0.3))[:, 0] == scene.arrows(scene.frame_at(0.3))[:, 1])
    longest = np.linalg.norm(scene.arrows(-1)[:, 1] - scene.arrows(-1)[:, 0], axis=1).max()
    assert 0.1 < longest / (2 * scene.extent.max()) < 0.6  # neither lost nor all over the picture


@pytest.mark.slow
def test_friction_used_is_that_of_the_margins(run, make_problem, hand):
    """Of Coulomb's cone; the share of the model's own limit stands beside it."""
    soft = make_problem(balance="wrench", friction=Friction(model="soft", torsion=5e-3, safety=1.2))
    for one in (run, plan_grasp(hand, soft).with_margins()):
        scene, least = make_scene(one), one.margins.least_mu
        assert np.allclose(scene.used[scene.frame_at(1.0)], least / one.friction.mu, rtol=1e-6)
        assert np.isnan(scene.used[0]).all()
        own = [value for what, value in scene.facts if what in ("of the pyramid", "of the soft finger")]
        shares = zip(one.contacts.names, one.margins.friction_used)
        assert own == [", ".join(f"{name} {100 * used:.0f} %" for name, used in shares)]


def test_torques_and_forces_are_the_runs_at_every_instant(run):
    scene = make_scene(run)
    at = np.searchsorted(run.motion.times, scene.times)
    assert np.array_equal(run.motion.times[at], scene.times)
    assert np.array_equal(scene.torques, run.motion.torques[at]) and np.array_equal(scene.q, run.motion.q[at])
    assert np.allclose(scene.normal, run.forces.normal_history[at], atol=1e-9)
    steps = np.diff(scene.times)
    touch = scene.frame_at(scene.touch)
    assert np.median(steps[touch:]) < 0.3 * np.median(steps[:touch])  # forces build up in slow motion
    assert scene.told[0].startswith("Approach") and scene.told[-1].startswith("Grasp complete")


def test_the_camera_sees_everything(run):
    scene = make_scene(run)
    right = np.cross(scene.up, scene.view)
    axes = np.stack([right / np.linalg.norm(right), np.cross(scene.view, right) / np.linalg.norm(right), scene.view])
    assert np.allclose(axes @ axes.T, np.eye(3))
    for i in (0, len(scene.times) - 1):
        for solid in scene.solids:
            pose = scene.object_pose if solid.link is None else scene.link_poses[i, solid.link]
            seen = (solid.vertices @ pin.Quaternion(*pose[3:]).toRotationMatrix().T + pose[:3] - scene.centre) @ axes.T
            assert np.all(np.abs(seen) <= scene.extent + 1e-3)


# -- what is refused ---------------------------------------------------------------------------------------------------


def test_runs_without_a_plan_or_a_hand_are_refused(run, tmp_path):
    with pytest.raises(InvalidInput, match="plan with its hand"):
        make_scene(replace(run, hand=None))
    with pytest.raises(InvalidInput, match="plan: expected a PlanRecord, got 'runs/paper'"):
        save_html("runs/paper", tmp_path / "a.html")
    with pytest.raises(InvalidInput, match="port"):
        view(run, port=-1, open_browser=False)
    with pytest.raises(ResultsNotWritten):
        save_html(run, "/proc/nothing/here.html")
    assert not list(tmp_path.iterdir())


def test_a_run_without_its_object_shows_the_hand(run):
    scene = make_scene(replace(run, body=None))
    assert scene.object_pose is None and all(solid.link is not None for solid in scene.solids)


@pytest.mark.slow
def test_simulations_of_something_else_are_refused(run, simulation, tmp_path):
    with pytest.raises(InvalidInput, match="pinograsp check"):
        read_check(tmp_path)
    for other in (tmp_path, 3):
        with pytest.raises(InvalidInput, match="simulation: expected a Simulation or None"):
            make_scene(run, other)
    with pytest.raises(InvalidInput, match="this plan's hand"):
        make_scene(run, replace(simulation, q=simulation.q[:, :7]))


@pytest.mark.slow
def test_without_viser_the_extra_is_named(run, monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "viser", None)
    with pytest.raises(ExtraMissing, match=re.escape("pip install 'pinograsp[viz]'")):
        view(run, open_browser=False)
    save_html(run, tmp_path / "still.html")


# -- the simulation ----------------------------------------------------------------------------------------------------


def stored(simulation, folder: Path) -> Path:
    folder.mkdir(parents=True)
    write_simulation(simulation, folder, {})
    return folder


@pytest.mark.slow
def test_the_simulation_stands_beside_the_plan_at_the_same_instants(run, simulation, tmp_path):
    scene = make_scene(run, simulation)
    shown = scene.simulated
    assert shown.held and scene.times[-1] == pytest.approx(simulation.times[-1], abs=2e-3)
    assert len(shown.link_poses) == len(scene.link_poses) == len(scene.times)
    assert np.allclose(shown.object_poses[-1, :3], simulation.object_poses[-1][:3, 3], atol=1e-9)
    assert np.allclose(shown.drift[-1], simulation.drift[-1], atol=1e-9)
    # Contact points of the parts, through the object's pose in the simulation: at t_F they are the plan's but for the
    # drift.
    i = scene.frame_at(1.0)
    arrows = shown.arrows(i, 0.003)
    planned = {name: point for name, point in zip(scene.contacts, scene.points_o)}
    assert np.allclose(arrows[:, 0], [planned[part] for part in shown.parts], atol=1e-3)
    assert np.allclose(arrows[:, 1] - arrows[:, 0], 0.003 * shown.forces_o[i])
    # After t_F the plan stays as it is, with the torques that hold.
    assert np.array_equal(scene.q[-1], run.motion.q[-1]) and np.array_equal(
        scene.torques[-1], run.motion.holding_torques
    )
    assert abs(shown.beside @ scene.up) < 1e-12 and abs(shown.beside @ scene.view) < 1e-12  # to the right
    again = make_scene(run, read_check(stored(simulation, tmp_path / "check")))
    assert np.array_equal(again.simulated.link_poses, shown.link_poses) and again.simulated.reason == shown.reason


# -- what the palm carries ---------------------------------------------------------------------------------------------


def record_of(scene):
    text = render_page(scene)
    return json.loads(text.split('id="data">')[1].split("</script>")[0])


def array_in(record, place):
    """An array in the bytes of a page's record."""
    kind, offset, shape = record[place]
    content = base64.b64decode(record["bytes"])
    return np.frombuffer(content, dtype=f"<{kind}", count=int(np.prod(shape)), offset=offset).reshape(shape)


@pytest.mark.slow
def test_grasps_stay_where_they_are(run, simulation):
    """Nothing of a grasp's page is carried."""
    scene = make_scene(run)
    record = record_of(scene)
    assert scene.carried is None and record["carried"] is None and record["rate"] == 30
    assert np.array_equal(scene.object_at(7), scene.object_pose)
    assert scene.carry_points(scene.points_o, 7) is scene.points_o
    touch, closed = scene.frame_at(scene.touch), scene.frame_at(scene.closed)
    assert record["phases"] == [["approach", 0, touch], ["grasp", touch, closed]]
    assert record["heading"] == "Margins of the grasp" and "other loads" in record["load_told"]
    assert np.allclose(array_in(record, "load"), np.tile(run.load[:3], (len(scene.times), 1)))
    with_simulation = record_of(make_scene(run, simulation))["phases"]
    assert [name for name, *_ in with_simulation] == ["approach", "grasp", "simulated hold"]


def moved_by(scene, pose):
    """A scene whose hand and all that it holds are somewhere else at every instant."""
    turn = Rotation.from_matrix(pose[:3, :3])
    links = np.array(scene.link_poses)
    flat = links.reshape(-1, 7)
    turned = (turn * Rotation.from_quat(flat[:, [4, 5, 6, 3]])).as_quat()[:, [3, 0, 1, 2]]
    links = np.concatenate([flat[:, :3] @ pose[:3, :3].T + pose[:3, 3], turned], axis=1).reshape(links.shape)
    return replace(scene, link_poses=links, carried=np.tile(to_sevens(pose), (len(links), 1)))


@pytest.mark.slow
def test_all_that_is_carried_is_drawn_where_it_is(run):
    """A camera that is carried along sees the same picture."""
    scene = make_scene(run)
    angle = np.radians(70.0)
    turn = Rotation.from_rotvec(angle * scene.up).as_matrix()
    away = moved_by(scene, pose_of(0.4 * np.cross(scene.up, scene.view), turn))

    def seen(scene, view):
        return imread(io.BytesIO(encode_figure(draw_picture(scene, scene.closed, view=view))))[..., :3]

    before = seen(scene, scene.view)
    assert differing(before, seen(away, turn @ scene.view)) < 2e-3
    left_behind = replace(away, carried=None)
    assert differing(before, seen(left_behind, turn @ scene.view)) > 0.05


# -- the file ----------------------------------------------------------------------------------------------------------


def test_the_file_is_whole_and_small(run, tmp_path):
    path = save_html(run, tmp_path / "deep" / "paper.html")
    text = path.read_text(encoding="utf-8")
    assert path.stat().st_size < 5e6
    assert "__DATA__" not in text
    addresses = set(re.findall(r"https?://[^\s\"']+", text))
    assert addresses <= {"http://www.w3.org/2000/svg"}  # a name, not an address
    assert not re.search(r"<(script|link|img|iframe)[^>]*\s(src|href)=", text)
    assert [path.name for path in path.parent.iterdir()] == ["paper.html"]
    json.loads(text.split('id="data">')[1].split("</script>")[0], parse_constant=lambda name: pytest.fail(name))


@pytest.mark.slow
def test_names_cannot_leave_the_record(run, tmp_path):
    evil = replace(run, settings={"name": "</script><script>alert(1)</script>"})
    text = save_html(evil, tmp_path / "a.html").read_text(encoding="utf-8")
    assert text.count("</script>") == 2 and "<script>alert" not in text
    from pinograsp.viz.panel import forces, head

    scene = make_scene(replace(evil, contacts=replace(run.contacts, names=("<img src=x>", "b", "c"))))
    assert "<script" not in head(scene) and "<img" not in forces(scene, 0)


# -- the command -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_view_writes_a_file_and_keeps_what_is_there(command, run, tmp_path):
    save_run(run, tmp_path / "a")
    code, out, err = command("view", "a", "--html", "a.html")
    assert code == 0 and "written to a.html" in out, err
    before = (tmp_path / "a.html").read_bytes()
    code, _, err = command("view", "a", "--html", "a.html")
    assert code == 2 and "--force" in err
    assert command("view", "a", "--html", "a.html", "--force")[0] == 0
    assert (tmp_path / "a.html").read_bytes() == before
    code, _, err = command("view", "nowhere")
    assert code == 2 and "no readable run" in err
    code, _, err = command("view", "a", "--port", "70000", "--no-browser")
    assert code == 2 and "--port" in err


@pytest.mark.slow
def test_a_page_in_the_runs_folder_is_one_of_its_files(command, run, tmp_path):
    save_run(run, tmp_path / "a")
    assert command("view", "a", "--html", "a/view.html")[0] == 0
    save_run(run, tmp_path / "a", force=True)
    assert not (tmp_path / "a" / "view.html").exists()
    code, _, err = command("view", "a", "--html", "n" * 300)
    assert code == 2 and "at most 255 bytes" in err


@pytest.mark.slow
def test_view_takes_the_latest_check(command, run, simulation, tmp_path):
    save_run(run, tmp_path / "a")
    alone = (command("view", "a", "--html", "alone.html"), (tmp_path / "alone.html").read_text())[1]
    stored(simulation, tmp_path / "a" / "check")
    stored(simulation, tmp_path / "a" / ".pinograsp-half")  # one that was killed while it was written
    assert newest_check(tmp_path / "a") == tmp_path / "a" / "check"
    assert command("view", "a", "--html", "both.html")[0] == 0
    both = (tmp_path / "both.html").read_text()
    assert '"simulated": null' in alone and '"simulated": null' not in both
    (tmp_path / "empty").mkdir()
    code, _, err = command("view", "a", "--check", "empty", "--html", "c.html")
    assert code == 2 and "pinograsp check" in err


@pytest.mark.slow
def test_ctrl_c_ends_the_live_page(run, tmp_path):
    pytest.importorskip("viser", reason="the live page needs viser: pip install 'pinograsp[viz]'")
    save_run(run, tmp_path / "a")
    script = (
        "from pinograsp.cli import main; import sys; sys.argv = ['pinograsp', 'view', 'a', "
        "'--no-browser', '--port', '0']; main()"
    )
    process = subprocess.Popen(
        [sys.executable, "-u", "-c", script], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    try:
        for line in process.stdout:
            if "Ctrl-C" in line:
                break
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=30)
    finally:
        process.kill()
    assert process.returncode == 0 and "Traceback" not in err, err


# -- browsers ----------------------------------------------------------------------------------------------------------

ARGUMENTS = [
    "--headless=new",
    "--no-sandbox",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--use-gl=angle",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
]


@pytest.fixture(scope="module")
def chromium():
    playwright = pytest.importorskip(
        "playwright.sync_api", reason="tests of the viewer in a browser need playwright: pip install playwright"
    )
    with playwright.sync_playwright() as started:
        own = started.chromium.executable_path
        installed = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
        if installed is None and not Path(own).exists():
            pytest.skip(
                "tests of the viewer in a browser need Chromium: apt install chromium, or playwright install chromium"
            )
        browser = started.chromium.launch(executable_path=installed or own, args=ARGUMENTS)
        yield browser
        browser.close()


@contextlib.contextmanager
def page_of(chromium, url: str, width: int = 1100, height: int = 700):
    """A page that must neither complain nor ask for anything from elsewhere."""
    page = chromium.new_page(viewport={"width": width, "height": height})
    complaints, elsewhere = [], []
    page.on("console", lambda message: complaints.append(message.text) if message.type == "error" else None)
    page.on("pageerror", lambda error: complaints.append(str(error)))
    near = ("file:", "data:", "blob:", "http://localhost:", "ws://localhost:")
    page.on("request", lambda request: None if request.url.startswith(near) else elsewhere.append(request.url))
    page.on("websocket", lambda socket: None if socket.url.startswith(near) else elsewhere.append(socket.url))
    page.goto(url)
    try:
        yield page
        assert complaints == []
        assert elsewhere == []
    finally:
        page.close()


def pixels(target) -> np.ndarray:
    """A picture (h, w, 3) of a page or an element, 0 to 1."""
    return imread(io.BytesIO(target.screenshot()))[..., :3]


def differing(a, b) -> float:
    """Share of pixels that are not the same."""
    return float((np.abs(a - b).max(axis=2) > 0.03).mean())


def yellow(picture) -> float:
    """Share of pixels of the object's colour."""
    r, g, b = np.moveaxis(picture, 2, 0)
    return float(((r > 0.5) & (g > 0.5) & (np.minimum(r, g) - b > 0.25)).mean())


def slide(page, value: int) -> None:
    page.locator("#slider").evaluate("(e, v) => { e.value = v; e.dispatchEvent(new Event('input')); }", value)
    page.wait_for_function("v => document.body.dataset.drawn == v", arg=value)


@pytest.fixture
def offline(chromium, run, tmp_path):
    path = save_html(run, tmp_path / "paper.html")
    with page_of(chromium, path.as_uri()) as page:
        page.wait_for_function("() => document.body.dataset.drawn !== undefined")
        yield page


@pytest.mark.slow
def test_the_file_draws_the_grasp_and_follows_its_slider(offline, run):
    scene = make_scene(run)
    canvas = offline.locator("#scene")
    start = scene.frame_at(scene.closed)
    closed = pixels(canvas)
    assert len(np.unique((closed * 255).astype(int).reshape(-1, 3), axis=0)) > 1000  # not blank: shaded surfaces
    assert yellow(closed) > 0.01
    assert f"{scene.closed:.3f} s" in offline.locator("#clock").inner_text()
    row = offline.locator("#forces tr").nth(1).inner_text().split()
    assert row[0] == "thumb" and float(row[1]) == pytest.approx(run.forces.normal_forces[0], rel=6e-3)
    assert f"{100 * scene.used[start, 0]:.0f}" in row
    slide(offline, 0)
    opened = pixels(canvas)
    assert differing(closed, opened) > 0.03
    slide(offline, 100)
    assert differing(pixels(canvas), opened) > 0.03  # the hand alone: nothing else changes in the approach
    slide(offline, 0)
    assert offline.locator("#forces tr").nth(1).inner_text().split()[1] == "0"
    assert "Approach" in offline.locator("#caption").inner_text()
    torque = offline.locator("#torques").inner_text()
    slide(offline, start)
    assert differing(pixels(canvas), closed) < 1e-3  # and back
    assert offline.locator("#torques").inner_text() != torque
    assert "plan: ok" in offline.locator("#status").inner_text()
    assert "force closure" in offline.locator("#margins").inner_text()


@pytest.mark.slow
def test_every_layer_of_the_file_can_be_switched(offline):
    canvas = offline.locator("#scene")
    everything = pixels(offline)
    for layer in ("hand", "object", "frames", "cones", "forces", "labels", "ground"):
        box = offline.locator(f"#layer-{layer}")
        box.uncheck()
        offline.wait_for_timeout(150)
        without = pixels(offline)
        assert differing(everything, without) > 3e-4, layer
        if layer == "object":
            assert yellow(pixels(canvas)) < 1e-3
        box.check()
        offline.wait_for_timeout(150)
        assert differing(everything, pixels(offline)) < 1e-3, layer


@pytest.mark.slow
def test_the_file_shows_collision_shapes_in_place_of_what_is_seen(chromium, tmp_path):
    path = save_html(run_with(load_hand("panda")), tmp_path / "panda.html")
    with page_of(chromium, path.as_uri()) as page:
        page.wait_for_function("() => document.body.dataset.drawn !== undefined")
        canvas, box = page.locator("#scene"), page.locator("#layer-collision")
        seen = pixels(canvas)
        box.check()
        page.wait_for_timeout(150)
        assert differing(seen, pixels(canvas)) > 0.03
        box.uncheck()
        page.wait_for_timeout(150)
        assert differing(seen, pixels(canvas)) < 1e-3


@pytest.mark.slow
def test_the_files_arrows_grow_with_the_force(offline, run):
    """With all else hidden, the thumb's arrow is as long on the screen as its force is large."""
    scene = make_scene(run)
    for layer in ("hand", "object", "frames", "cones", "labels", "ground"):
        offline.locator(f"#layer-{layer}").uncheck()
    offline.evaluate(
        "() => { for (const id of ['caption', 'legend']) document.getElementById(id).style.visibility = 'hidden'; }"
    )

    def length(frame: int) -> float:
        slide(offline, frame)
        r, g, b = np.moveaxis(pixels(offline.locator("#scene")), 2, 0)
        rows, columns = np.nonzero((b > 0.4) & (r < 0.25) & (g < 0.6))
        return float(np.hypot(np.ptp(rows), np.ptp(columns))) if rows.size else 0.0

    last = len(scene.times) - 1
    half = int(np.abs(scene.normal[:, 0] - 0.5 * scene.normal[last, 0]).argmin())
    assert length(0) == 0.0
    whole = length(last)
    assert whole > 60
    assert length(half) / whole == pytest.approx(scene.normal[half, 0] / scene.normal[last, 0], abs=0.08)


@pytest.mark.slow
def test_the_file_plays_turns_and_scales_its_arrows(offline):
    canvas = offline.locator("#scene")
    slide(offline, 0)
    offline.locator("#play").click()
    offline.wait_for_function("() => +document.getElementById('slider').value > 10")
    offline.locator("#play").click()
    value = offline.locator("#slider").input_value()
    offline.wait_for_timeout(300)
    assert offline.locator("#slider").input_value() == value and int(value) > 10
    slide(offline, 235)
    before = pixels(canvas)
    offline.locator("#slide-scale").evaluate("e => { e.value = +e.min; e.dispatchEvent(new Event('input')); }")
    offline.wait_for_timeout(150)
    short = pixels(canvas)
    assert differing(before, short) > 1e-3
    box = canvas.bounding_box()
    offline.mouse.move(box["x"] + 300, box["y"] + 300)
    offline.mouse.down()
    offline.mouse.move(box["x"] + 420, box["y"] + 280, steps=4)
    offline.mouse.up()
    offline.wait_for_timeout(150)
    assert differing(short, pixels(canvas)) > 0.05
    offline.mouse.dblclick(box["x"] + 300, box["y"] + 300)
    offline.wait_for_timeout(150)
    assert differing(short, pixels(canvas)) < 1e-3  # back to where it was


def middle_of_the_object(page) -> np.ndarray:
    """On the screen [pixels]: what is yellow."""
    r, g, b = np.moveaxis(pixels(page.locator("#scene")), 2, 0)
    found = (r > 0.5) & (g > 0.5) & (np.minimum(r, g) - b > 0.25)
    assert found.sum() > 20
    return np.argwhere(found).mean(axis=0)


@pytest.mark.slow
def test_the_file_shows_an_object_in_a_moving_hand(chromium, tmp_path):
    arm = load_hand(file_of("panda"), posture=dict(zip(JOINTS, START)))
    pose = arm.frame_placements(arm.resting, [arm.palm])[0] @ pose_of(np.array([0, 0, 0.1034]), np.eye(3))
    box = Box(size=[0.04, 0.04, 0.06], mass=0.2, pose=pose)
    plan = plan_carry(arm, plan_grasp_on(arm, box, GraspConditions(mu=0.6)), WAYPOINTS, intervals=20)
    scene = carry_scene(plan)
    last = len(scene.times) - 1
    path = plan.save_html(tmp_path / "way.html")
    with page_of(chromium, path.as_uri()) as page:
        page.wait_for_function("() => document.body.dataset.drawn !== undefined")
        assert page.locator("#clock").inner_text() == "0.000 s"
        overview = pixels(page.locator("#scene"))
        for layer in ("frames", "cones", "forces", "labels"):
            page.locator(f"#layer-{layer}").uncheck()
        moved = []
        for frame in (0, last // 2, last):
            slide(page, frame)
            moved.append(middle_of_the_object(page))
            assert scene.told[frame] in page.locator("#caption").inner_text()
        assert min(np.linalg.norm(b - a) for a, b in itertools.pairwise(moved)) > 20  # pixels
        assert differing(overview, pixels(page.locator("#scene"))) > 0.05
        # A camera that goes with the hand sees the object in the same place, and the fingers beside it.
        page.locator("#layer-follow").check()
        page.locator("#layer-hand").uncheck()
        still = []
        for frame in (0, last // 2, last):
            slide(page, frame)
            still.append(middle_of_the_object(page))
        assert np.ptp(still, axis=0).max() < 12
        # The page's "residual" is that of the plan at its own instants.
        assert float(page.locator("#panel p").first.inner_text().split("residual ")[1].split()[0]) < 1e-3


@pytest.mark.slow
def test_the_file_shows_the_simulation(chromium, run, simulation, tmp_path):
    path = save_html(run, tmp_path / "both.html", simulation=simulation)
    assert path.stat().st_size < 5e6
    with page_of(chromium, path.as_uri()) as page:
        page.wait_for_function("() => document.body.dataset.drawn !== undefined")
        assert "simulation: HELD" in page.locator("#panel").inner_text()
        canvas = page.locator("#scene")
        beside = pixels(canvas)
        half = beside.shape[1] // 2
        assert yellow(beside[:, :half]) > 2e-3 and yellow(beside[:, half:]) > 2e-3  # an object on either side
        page.locator("#layer-simulation").uncheck()
        page.wait_for_timeout(150)
        alone = pixels(canvas)
        assert yellow(alone[:, :half]) > 2e-3 and yellow(alone[:, half:]) < 1e-4
        page.locator("#layer-simulation").check()
        page.locator("#layer-beside").uncheck()  # over the plan, and the plan to the middle
        page.wait_for_timeout(150)
        over = pixels(canvas)
        assert differing(over, alone) > 0.05 and yellow(over[:, : half // 3]) < 1e-4


@contextlib.contextmanager
def phone(chromium, url: str):
    """A page on a phone: 390 pixels wide, and touched."""
    context = chromium.new_context(viewport={"width": 390, "height": 844}, is_mobile=True, has_touch=True)
    page = context.new_page()
    page.goto(url)
    try:
        yield page
    finally:
        context.close()


@pytest.mark.slow
def test_the_file_fits_a_phone(chromium, run, tmp_path):
    """The hand is seen at once, labels keep within its picture, and what is touched is as large as a thumb."""
    path = save_html(run, tmp_path / "paper.html")
    with phone(chromium, path.as_uri()) as page:
        page.wait_for_function("() => document.body.dataset.drawn !== undefined")
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
        stage = page.locator("#stage").bounding_box()
        assert stage["y"] == 0 and 400 < stage["height"] < 600
        canvas = pixels(page.locator("#scene"))
        assert yellow(canvas) > 0.01
        caption = page.locator("#caption").bounding_box()
        labels = [box for box in (one.bounding_box() for one in page.locator(".label").all()) if box]
        assert len(labels) == len(run.contacts.names)
        for box in labels:
            assert box["x"] >= 0 and box["x"] + box["width"] <= 390
            assert caption["y"] + caption["height"] <= box["y"] and box["y"] + box["height"] <= stage["height"]
        for a, b in itertools.combinations(labels, 2):
            apart = a["y"] + a["height"] <= b["y"] or b["y"] + b["height"] <= a["y"]
            assert apart or a["x"] + a["width"] <= b["x"] or b["x"] + b["width"] <= a["x"]
        for name in ("#play", "#slider", "#slide-scale", "#slide-speed"):
            box = page.locator(name).bounding_box()
            assert box["height"] >= 44 and box["y"] >= stage["height"], name
        page.locator("#layer-object").tap()
        page.wait_for_timeout(150)
        assert yellow(pixels(page.locator("#scene"))) < 1e-3
        assert "thumb" in page.locator("#torques .group").first.inner_text()


@pytest.mark.slow
def test_the_report_shows_the_grasp_beside_the_answer(chromium, run, tmp_path):
    write_report(run, tmp_path, [path.name for path in save_figures(run, tmp_path)])
    url = (tmp_path / "report.html").as_uri()
    dark = chromium.new_context(viewport={"width": 1200, "height": 900}, color_scheme="dark")
    with page_of(chromium, url, 1200, 900) as page, contextlib.closing(dark):
        answer = page.locator(".top li").first.bounding_box()
        image = page.locator(".top img").bounding_box()
        assert image["x"] >= answer["x"] + answer["width"] and abs(image["y"] - answer["y"]) < 10
        assert image["y"] + image["height"] < 900
        light = pixels(page)[-1, 0]
        other = dark.new_page()
        other.goto(url)
        assert light.min() > 0.95 and pixels(other)[-1, 0].max() < 0.2
    with phone(chromium, url) as page:
        assert page.evaluate("() => document.documentElement.scrollWidth") <= 390
        answer, image = page.locator(".top li").first.bounding_box(), page.locator(".top img").bounding_box()
        second = page.locator(".top li").nth(1).bounding_box()
        assert answer["y"] < image["y"] < second["y"] and image["width"] <= 390
        # Wide tables scroll in their own boxes.
        assert all(box["width"] <= 390 for box in (one.bounding_box() for one in page.locator(".wide").all()))


@pytest.fixture
def live(run):
    pytest.importorskip("viser", reason="the live page needs viser: pip install 'pinograsp[viz]'")
    with view(run, port=0, open_browser=False) as viewer:
        yield viewer


def settled(page, done, timeout: float = 300.0) -> np.ndarray:
    """The picture once it is as wanted: the page fades in, slowly where graphics are computed."""
    until = time.monotonic() + timeout
    while True:
        picture = pixels(page)
        if done(picture):
            return picture
        assert time.monotonic() < until, "the live page does not come to show what it should"
        page.wait_for_timeout(500)


@pytest.mark.slow
def test_the_live_page_draws_follows_time_and_switches_layers(chromium, live):
    with page_of(chromium, live.url, 1100, 400) as page:
        closed = settled(page, lambda picture: yellow(picture) > 5e-3)
        assert "1.000 s" in page.inner_text("body") and "plan: ok" in page.inner_text("body")
        page.wait_for_timeout(3000)
        closed = pixels(page)
        left = np.s_[:, : closed.shape[1] // 2]  # the panel is on the right
        live.show(0.4)
        page.wait_for_function("() => document.body.innerText.includes('Approach')")
        settled(page, lambda picture: differing(picture[left], closed[left]) > 0.01)
        assert live.time == pytest.approx(0.4, abs=0.01)
        slider = page.get_by_role("slider").first
        slider.focus()
        page.keyboard.press("Home")
        page.wait_for_function("() => document.body.innerText.includes('0.000 s')")
        assert live.time == 0.0
        page.get_by_role("checkbox", name="object").first.uncheck()
        settled(page, lambda picture: yellow(picture) < 1e-3)


@pytest.mark.slow
def test_the_live_page_shows_collision_shapes_in_place_of_what_is_seen(chromium):
    pytest.importorskip("viser", reason="the live page needs viser: pip install 'pinograsp[viz]'")
    live = view(run_with(load_hand("panda")), port=0, open_browser=False)
    with live, page_of(chromium, live.url, 1100, 600) as page:
        settled(page, lambda picture: yellow(picture) > 5e-3)
        page.wait_for_timeout(3000)
        seen = pixels(page)
        left = np.s_[:, : seen.shape[1] // 2]  # the panel is on the right
        page.get_by_role("checkbox", name="collision shapes").first.check()
        settled(page, lambda picture: differing(picture[left], seen[left]) > 0.02)
        page.get_by_role("checkbox", name="collision shapes").first.uncheck()
        settled(page, lambda picture: differing(picture[left], seen[left]) < 5e-3)


@pytest.mark.slow
def test_the_live_page_plays_and_closes(live):
    live.show(0.0)
    live.play()
    until = time.monotonic() + 20
    while live.time < 0.05 and time.monotonic() < until:
        time.sleep(0.05)
    assert live.time >= 0.05
    live.pause()
    live.show(1.0)
    assert live.time == 1.0
    live.close()
    live.close()
    with pytest.raises(OSError):
        import urllib.request

        urllib.request.urlopen(live.url, timeout=2)


def answer_to(viewer, host: str, origin: str | None = None, upgrade: bool = True) -> int:
    """HTTP status of a request to the live page, over a socket."""
    import socket

    port = viewer.server.get_port()
    lines = ["GET / HTTP/1.1", f"Host: {host.format(port=port)}"]
    lines += [] if origin is None else [f"Origin: {origin.format(port=port)}"]
    if upgrade:
        lines += [
            "Upgrade: websocket",
            "Connection: Upgrade",
            "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==",
            "Sec-WebSocket-Version: 13",
            f"Sec-WebSocket-Protocol: viser-v{__import__('viser').__version__}",
        ]
    with socket.create_connection(("127.0.0.1", port), timeout=20) as stream:
        stream.sendall("\r\n".join([*lines, "", ""]).encode())
        return int(stream.makefile("rb").readline().split()[1])


def test_no_web_page_from_elsewhere_reads_the_live_page(live):
    assert answer_to(live, "localhost:{port}", "http://localhost:{port}") == 101
    assert answer_to(live, "127.0.0.1:{port}", "http://127.0.0.1:{port}") == 101
    assert answer_to(live, "localhost:{port}") == 101  # no browser
    assert answer_to(live, "localhost:{port}", upgrade=False) == 200
    for origin in (
        "http://evil.example",
        "https://localhost.evil.example",
        "null",
        "http://localhost:1",
        "file://",
        "http://[",
        "",
    ):
        assert answer_to(live, "localhost:{port}", origin) == 403, origin
    for host in ("evil.example:{port}", "evil.example", "localhost.evil.example:{port}", "", "[", "192.168.1.2:{port}"):
        for upgrade in (True, False):
            assert answer_to(live, host, f"http://{host}", upgrade) == 403, host
            assert answer_to(live, host, None, upgrade) == 403, host


def test_a_page_for_other_machines_answers_to_addresses_and_its_own_names():
    import socket

    from pinograsp.viz.access import is_welcome

    for name in ("192.168.1.2:8080", "[fe80::1]:8080", "localhost", socket.gethostname()):
        assert is_welcome("0.0.0.0", [name], [f"http://{name}"]), name
        assert not is_welcome("0.0.0.0", [name], ["http://evil.example"])
    assert not is_welcome("0.0.0.0", ["evil.example"], ["http://evil.example"])
    assert not is_welcome("0.0.0.0", ["localhost", "localhost"], [])


def test_the_live_page_listens_on_the_loopback_interface_alone(live):
    listening = "0A"
    rows = [
        line.split()
        for kind in ("tcp", "tcp6")
        if (path := Path(f"/proc/net/{kind}")).exists()
        for line in path.read_text().splitlines()[1:]
    ]
    port = f"{live.server.get_port():04X}"
    found = {row[1].split(":")[0] for row in rows if row[1].endswith(f":{port}") and row[3] == listening}
    assert found and found <= {"0100007F", "00000000000000000000000001000000"}


@pytest.mark.slow
def test_a_live_page_that_cannot_listen_says_so(run):
    import socket

    pytest.importorskip("viser", reason="the live page needs viser: pip install 'pinograsp[viz]'")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        port = taken.getsockname()[1]
        with view(run, port=port, host="127.0.0.1", open_browser=False) as viewer:
            assert viewer.server.get_port() > port
    for host in ("no.such.host.invalid", "192.0.2.1", 7):
        with pytest.raises(InvalidInput, match="host"):
            view(run, host=host, open_browser=False)


def test_a_plan_shows_itself(plan):
    pytest.importorskip("viser", reason="the live page needs viser: pip install 'pinograsp[viz]'")
    with plan.show(port=0, open_browser=False) as viewer:
        assert viewer.url.startswith("http://localhost:") and viewer.time == 1.0


@pytest.mark.slow
def test_planning_does_not_need_the_viewer(tmp_path):
    """Neither does importing the page's writer need viser: it is looked for where the live page starts."""
    script = "import sys; import pinograsp.plan, pinograsp.viz.viewer; assert 'viser' not in sys.modules"
    subprocess.run([sys.executable, "-c", script], cwd=tmp_path, check=True)
