"""Still pictures: every surface is where a camera would see it, and a picture shows the grasp that it is of."""

from __future__ import annotations

import base64
import io
import xml.etree.ElementTree as ElementTree
from dataclasses import replace

import numpy as np
import pytest
from marks import slow_except
from matplotlib.figure import Figure
from matplotlib.image import imread

from pinograsp.cases import load_case
from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.planner import GraspPlan, save_run
from pinograsp.viz.figures import save_figures
from pinograsp.viz.outlines import draw_arrow
from pinograsp.viz.raster import Camera, Surface, render_surfaces
from pinograsp.viz.scene import make_scene
from pinograsp.viz.scene_meshes import ball, rgb
from pinograsp.viz.still import Sheet, find_camera, picture
from pinograsp.viz.style import COLOURS, encode_figure, finger_colours, finger_of

UP = np.array([0.0, 0.0, 1.0])
CAMERA = Camera(np.array([0.0, -2.0, 0.0]), np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]]), 200.0, 161, 121)
GREY, RED = np.full(3, 0.5), np.array([0.9, 0.1, 0.1])


@pytest.fixture(scope="module")
def plan() -> GraspPlan:
    return load_case("paper", {"forces.search": "convex", "forces.balance": "wrench"}).plan()


@pytest.fixture(scope="module")
def usual(plan):
    """The picture as it is without further words."""
    return picture(plan)


@pytest.fixture(scope="module")
def printed(plan):
    """The same for print."""
    return picture(plan, vector=True)


def seen(figure) -> np.ndarray:
    return imread(io.BytesIO(encode_figure(figure)))[..., :3]


def differing(a, b) -> float:
    return float((np.abs(a - b).max(axis=2) > 0.03).mean())


# -- the rasteriser ----------------------------------------------------------------------------------------------------


def rays() -> np.ndarray:
    """Directions (h, w, 3) of the pixels' middles, one unit of depth long."""
    x = (np.arange(CAMERA.width) + 0.5 - CAMERA.width / 2) / CAMERA.focal
    y = -(np.arange(CAMERA.height) + 0.5 - CAMERA.height / 2) / CAMERA.focal
    return np.stack(np.broadcast_arrays(x[None], 1.0, y[:, None]), axis=-1)


def test_a_plane_is_as_deep_as_its_rays_are_long():
    """A slanted triangle against the intersection of every pixel's ray with its plane."""
    corners = np.array([[-0.5, 0.3, -0.3], [0.6, -0.4, -0.2], [0.0, 0.2, 0.5]])
    layer = render_surfaces([Surface(corners, np.array([[0, 1, 2]]), GREY)], CAMERA, UP)
    a, b, c = corners
    normal = np.cross(b - a, c - a)
    depth = normal @ (a - CAMERA.eye) / (rays() @ normal)
    points = CAMERA.eye + depth[..., None] * rays()
    shares = np.stack([np.cross(end - start, points - start) @ normal for start, end in ((a, b), (b, c), (c, a))])
    least = shares.min(axis=0) / (normal @ normal)
    inside = least >= 0
    assert inside.sum() > 1000
    assert np.abs(least[layer.drawn != inside]).max(initial=0.0) < 1e-8  # on an edge
    both = inside & layer.drawn
    assert np.allclose(1 / layer.near[both], depth[both], rtol=1e-9)


def test_a_ball_is_as_large_as_its_outline():
    """Seen from a distance d, a ball of radius r fills the cone of half-angle asin(r / d)."""
    vertices, faces = ball()
    layer = render_surfaces([Surface(0.5 * vertices, faces, GREY)], CAMERA, UP)
    cosine = rays()[..., 1] / np.linalg.norm(rays(), axis=2)
    assert layer.drawn.sum() == pytest.approx((cosine > np.cos(np.arcsin(0.5 / 2))).sum(), rel=0.02)
    assert 1 / layer.near[60, 80] == pytest.approx(1.5, abs=5e-3)
    assert layer.facing[60, 80] == pytest.approx(1.0, abs=0.01)
    assert layer.colour[20:60].mean() > layer.colour[60:100].mean()  # light from above


@pytest.mark.parametrize("first", [True, False])
def test_what_is_nearer_hides_what_is_farther(first):
    vertices, faces = ball()
    near, far = Surface(0.2 * vertices - [0, 0.5, 0], faces, RED), Surface(0.5 * vertices, faces, GREY)
    layer = render_surfaces([near, far] if first else [far, near], CAMERA, UP)
    red, green, blue = layer.colour[60, 80]
    assert red > 2 * green and red > 2 * blue
    assert layer.surface[60, 80] == (0 if first else 1) and layer.surface[0, 0] == -1
    away = render_surfaces([Surface(0.2 * vertices - [0, 5.0, 0], faces, RED)], CAMERA, UP)
    assert not away.drawn.any()  # behind the camera
    assert not render_surfaces([], CAMERA, UP).drawn.any()


# -- the picture -------------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("vector", slow_except([False, True], False))
def test_a_picture_shows_contacts_forces_and_object(plan, usual, printed, vector):
    usual = printed if vector else usual
    image = seen(usual)
    assert image.shape == (640, 900, 3)
    for colour in make_scene(plan).colours:  # of arrows and labels
        assert (np.abs(image - rgb(colour) / 255).max(axis=2) < 0.1).sum() > 300
    r, g, b = np.moveaxis(image, 2, 0)
    assert ((r > 0.5) & (g > 0.5) & (np.minimum(r, g) - b > 0.2)).mean() > 0.01  # the object
    edge = np.concatenate([image[:2].reshape(-1, 3), image[-2:].reshape(-1, 3)])
    assert edge.min() > 0.75  # nothing is cut off
    texts = [text.get_text() for text in usual.axes[0].texts]
    forces = dict(zip(plan.contacts.names, plan.forces.normal_forces))
    assert sorted(texts) == sorted(f"{name}  {force:.3g} N" for name, force in forces.items())


@pytest.mark.slow
def test_pictures_follow_time_and_view(plan, usual):
    usual = seen(usual)
    assert differing(usual, seen(picture(plan, time=0.0))) > 0.02
    assert differing(usual, seen(picture(plan, view=[1, 0.2, 0.3]))) > 0.02
    # But for pixels on edges, which rounding decides.
    assert differing(usual, seen(picture(plan, view=7 * make_scene(plan).view))) < 1e-3
    assert differing(usual, seen(picture(plan, collision_shapes=True))) < 1e-3  # the paper's hand is seen as it touches
    alone = seen(picture(replace(plan, body=None)))
    assert differing(usual, alone) > 0.01
    for view in ([0, 0, 0], [1, 2], "left"):
        with pytest.raises(InvalidInput, match="view"):
            picture(plan, view=view)
    with pytest.raises(InvalidInput, match="plan with its hand"):
        picture(replace(plan, hand=None))


def test_views_have_names(plan):
    scene, sheet = make_scene(plan), Sheet()
    cameras = {name: find_camera(scene, name, [200], sheet) for name in ("front", "back", "side", "top")}
    towards = {name: camera.axes[2] for name, camera in cameras.items()}
    for name in ("front", "back", "side"):
        assert towards[name] @ scene.up == pytest.approx(0, abs=1e-12) and cameras[name].axes[1] @ scene.up > 0.999
    assert towards["front"] @ scene.view > 0.7 and np.allclose(towards["back"], -towards["front"])
    assert np.allclose(towards["side"], cameras["front"].axes[0])  # on the right of who looks from the front
    assert np.allclose(towards["top"], scene.up)
    assert np.allclose(cameras["top"].axes[0], cameras["front"].axes[0])
    below = find_camera(scene, -scene.up, [200], sheet)
    assert np.allclose(below.axes[2], -scene.up) and np.isfinite(below.eye).all()


@pytest.mark.slow
def test_pictures_for_print_are_vector_graphics(plan, printed, tmp_path):
    """Arrows are filled outlines in the colours of the contacts; the hand is one picture, fine enough for print."""
    written = encode_figure(printed, "svg")
    root = ElementTree.fromstring(written)
    (image,) = root.iter("{http://www.w3.org/2000/svg}image")
    content = base64.b64decode(image.get("{http://www.w3.org/1999/xlink}href").partition(",")[2])
    assert imread(io.BytesIO(content)).shape[:2] == (1280, 1800)
    filled = [one.get("style", "").lower() for one in root.iter("{http://www.w3.org/2000/svg}path")]
    for colour in make_scene(plan).colours:
        assert sum(f"fill: {colour.lower()}" in style for style in filled) >= 3  # label, shaft and head
    assert len(written) < 1e6 and encode_figure(printed, "svg") == written
    path = plan.picture(tmp_path / "grasp.pdf", view="front")
    content = path.read_bytes()
    assert content.startswith(b"%PDF") and b"/Type3" not in content and len(content) < 1e6
    with pytest.raises(InvalidInput, match=r"\.png, \.svg, \.pdf.*film"):
        plan.picture(tmp_path / "grasp.jpg")


@pytest.mark.slow
def test_vector_arrows_are_where_shaded_ones_are(plan, usual, printed):
    """Pixels of the thumb's colour, in both."""
    blue = rgb(make_scene(plan).colours[0]) / 255
    masks = [np.abs(seen(figure) - blue).max(axis=2) < 0.25 for figure in (usual, printed)]
    assert (masks[0] & masks[1]).sum() > 0.7 * (masks[0] | masks[1]).sum()


def test_what_the_hand_hides_is_pale():
    figure = Figure(figsize=(2, 2), dpi=100)
    axes = figure.add_axes((0, 0, 1, 1))

    def project(places):
        return np.column_stack([places[:, 0], places[:, 1], 1 / (5 - places[:, 2])])

    ends = np.array([[0.0, 0.0, 0.0], [100.0, 0.0, 0.0]])
    draw_arrow(axes, project, lambda places: places[:, 0] < 40, ends, 2.0, "#0072B2", 0.3)
    pale = [one for one in axes.patches if one.get_alpha() == 0.3]
    assert len(pale) == 1
    x = pale[0].get_xy()[:, 0]
    assert x.min() == pytest.approx(0, abs=1e-9) and x.max() == pytest.approx(40, abs=3)
    assert max(one.get_xy()[:, 0].max() for one in axes.patches) == pytest.approx(100)


def test_a_finger_has_one_colour():
    for names in (
        ("thumb", "index", "middle"),
        ("index/link_2", "index/link_3", "ring", "thumb"),
        ("rh_thumb", "palm"),
    ):
        colours = finger_colours(names, ["thumb", "index", "middle", "ring", "little"])
        assert len({colours[name] for name in names}) == len({finger_of(name) for name in names})
        thumbs = {colour for name, colour in colours.items() if name == "thumb"}
        assert thumbs <= {COLOURS[0], COLOURS[4]} and "#000000" not in colours.values()
    jaws = finger_colours(("left", "right"))
    assert jaws["left"] != jaws["right"] and jaws == finger_colours(("right", "left"))
    assert len(set(finger_colours([f"finger {i}" for i in range(9)]).values())) == 6


@pytest.mark.slow
def test_a_picture_says_where_meshes_are_gone(plan, tmp_path):
    gone = replace(plan.hand.visuals[0], kind="mesh", size=(1.0, 1.0, 1.0), path=str(tmp_path / "gone.stl"))
    texts = [text.get_text() for text in picture(replace(plan, hand=replace(plan.hand, visuals=(gone,)))).axes[0].texts]
    assert any(text.startswith("collision shapes are shown") for text in texts)


def test_a_plan_writes_its_picture(plan, tmp_path):
    path = plan.picture(tmp_path / "deep" / "grasp.png", view=[1, 0.2, 0.3])
    assert imread(path).shape[:2] == (640, 900) and path.stat().st_size < 5e5
    with pytest.raises(ResultsNotWritten):
        plan.picture("/proc/nothing/here.png")


@pytest.mark.slow
def test_reports_show_the_grasp(command, plan, tmp_path, no_rendering):
    full = plan.with_margins().with_reach()
    assert not (tmp_path / "grasp.png").exists()
    assert "grasp.png" not in {path.name for path in save_figures(replace(full, hand=None), tmp_path)}
    save_run(full, tmp_path / "run")
    assert command("report", "run")[0] == 0
    assert "](grasp.png)" in (tmp_path / "run" / "report.md").read_text()
    assert "The grasp at t_F" in (tmp_path / "run" / "report.html").read_text()
    (tmp_path / "run" / "scene.json").write_text("{}")
    assert command("report", "run")[0] == 0  # its figures need no hand
    assert "](grasp.png)" not in (tmp_path / "run" / "report.md").read_text()
