"""The pictures of the README and of the gallery: ``python docs/make_pictures.py [NAME ...]``.

Without names all of them are made, in some minutes: docs/grasp.gif and docs/gallery/NAME.png. Every grasp is planned
anew from the hand and the object that stand here.
"""

from __future__ import annotations

import io
import sys
import tempfile
from dataclasses import dataclass, fields, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import trimesh
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image

import pinograsp as pg
from pinograsp.objects.body import Body
from pinograsp.planner import GraspPlan, plan_best
from pinograsp.synthesis import FoundGrasp
from pinograsp.viz.film import write_film
from pinograsp.viz.scene import Phase, ViewScene, make_scene
from pinograsp.viz.still import Sheet, draw, encode_figure, find_camera

DOCS = Path(__file__).resolve().parent
SHEET = Sheet(width=600, height=450, dpi=92, fading=False)
LIFT, STEPS = 0.05, 60  # [m], and instants on the way


def mug() -> Body:
    """A tall mug with a handle."""
    radius, height, wall = 0.041, 0.135, 0.004
    outside = trimesh.creation.cylinder(radius=radius, height=height, sections=96)
    inside = trimesh.creation.cylinder(radius=radius - wall, height=height, sections=96)
    inside.apply_translation([0, 0, wall])
    angle = np.linspace(-np.pi / 2, np.pi / 2, 24)
    path = np.column_stack([radius - 0.002 + 0.032 * np.cos(angle), 0 * angle, 0.042 * np.sin(angle)])
    tubes = [
        trimesh.creation.capsule(radius=0.006, height=float(np.linalg.norm(end - start)), count=[16, 16])
        for start, end in pairwise(path)
    ]
    for tube, (start, end) in zip(tubes, pairwise(path)):
        tube.apply_translation([0, 0, -float(np.linalg.norm(end - start)) / 2])
        tube.apply_transform(trimesh.geometry.align_vectors([0, 0, 1], end - start))
        tube.apply_translation((start + end) / 2)
    body = trimesh.boolean.union([outside, *tubes], engine="manifold")
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "mug.stl"
        trimesh.boolean.difference([body, inside], engine="manifold").export(file)
        return pg.Mesh.load(file, mass=0.35)


@dataclass(frozen=True)
class Shot:
    """A grasp to search, and where it is seen from."""

    hand: str
    thing: Body
    seed: int = 0
    count: int = 16
    wrap: bool = False
    table: bool = False
    view: ArrayLike | None = None
    fingers: int = 2

    def plan(self) -> GraspPlan:
        """The best grasp with so many fingers."""
        conditions = pg.GraspConditions(mu=0.6, table=self.table)
        hand = pg.load_hand(self.hand)
        found = pg.find_grasps(hand, self.thing, conditions, count=self.count, seed=self.seed, wrap=self.wrap)
        chosen = tuple(one for one in found.grasps if len(fingers_of(one)) >= self.fingers)
        return plan_best(replace(found, grasps=chosen), conditions)


def fingers_of(grasp: FoundGrasp) -> set[str]:
    """Those that touch."""
    return {name.split("/")[0] for name in grasp.closure.contacts().names}


def shots() -> dict[str, Shot]:
    """All but the paper's own grasp, by the names of the pictures."""
    egg = pg.Ellipsoid(semi_axes=np.array([0.02, 0.02, 0.027]), mass=0.06)
    return {
        "allegro_mug": Shot("allegro_right", mug(), seed=21, count=32, table=True, fingers=4),
        "allegro_power": Shot("allegro_left", pg.Cylinder(radius=0.035, height=0.16, mass=0.4), seed=3, wrap=True),
        "g1_can": Shot("g1_right", pg.Cylinder(radius=0.03, height=0.12, mass=0.3), seed=1),
        "g1_ball": Shot("g1_left", pg.Sphere(radius=0.035, mass=0.2), seed=2),
        "psyonic_ball": Shot("psyonic_right", pg.Sphere(radius=0.03, mass=0.1), seed=1),
        "psyonic_box": Shot("psyonic_left", pg.Box(size=(0.035, 0.035, 0.1), mass=0.15), seed=1),
        "hey5_bottle": Shot("hey5", pg.Cylinder(radius=0.022, height=0.14, mass=0.2), seed=1),
        "panda_box": Shot("panda", pg.Box(size=(0.04, 0.04, 0.06), mass=0.2), seed=1),
        "romeo_ball": Shot("romeo_right", pg.Sphere(radius=0.028, mass=0.08), seed=1),
        "talos_ball": Shot("talos_right", pg.Sphere(radius=0.03, mass=0.15), seed=1),
        "so101_box": Shot("so101", pg.Box(size=(0.025, 0.025, 0.07), mass=0.04), seed=1),
        "tiago_pro_egg": Shot("tiago_pro_right", egg, seed=1),
    }


def lifted(scene: ViewScene) -> ViewScene:
    """The same, and then hand and object rise together."""
    last, up = len(scene.times) - 1, scene.up
    share = np.linspace(0, 1, STEPS + 1)[1:]
    heights = np.r_[np.zeros(last + 1), LIFT * share**3 * (10 - 15 * share + 6 * share**2)]
    at = np.r_[np.arange(last + 1), np.full(STEPS, last)]
    longer = {
        field.name: value[at]
        for field in fields(scene)
        if isinstance(value := getattr(scene, field.name), np.ndarray) and len(value) == last + 1
    }
    times = np.r_[scene.times, scene.times[-1] + share]
    carried = np.tile([0.0, 0, 0, 1, 0, 0, 0], (len(at), 1))
    carried[:, :3] = heights[:, None] * up
    poses = longer["link_poses"].copy()
    poses[:, :, :3] += heights[:, None, None] * up
    told = (*scene.told, *["The hand lifts it."] * STEPS)
    phases = (*scene.phases, Phase("lift", last, last + STEPS))
    return replace(scene, **longer | {"times": times, "link_poses": poses}, carried=carried, told=told, phases=phases)


def still(plan: GraspPlan, path: Path, view: ArrayLike | None) -> None:
    """A picture of 600 pixels, in few colours."""
    scene = make_scene(plan)
    frame = scene.frame_at(scene.closed)
    figure = Figure(figsize=(SHEET.width / SHEET.dpi, SHEET.height / SHEET.dpi), dpi=SHEET.dpi)
    draw(figure, scene, frame, find_camera(scene, view, [frame], SHEET), SHEET)
    path.parent.mkdir(exist_ok=True)
    image = Image.open(io.BytesIO(encode_figure(figure))).convert("RGB")
    image.quantize(255, Image.Quantize.MAXCOVERAGE, kmeans=2).save(path, optimize=True)


def main(names: list[str]) -> None:
    """Make these pictures; none: all."""
    known = {"paper": None, **shots()}
    for name in names or known:
        shot = known[name]
        plan = pg.load_case("paper", {"forces.search": "convex"}).plan() if shot is None else shot.plan()
        still(plan, DOCS / "gallery" / f"{name}.png", None if shot is None else shot.view)
        if name == "allegro_mug":
            write_film(lifted(make_scene(plan)), DOCS / "grasp.gif", view=shot.view, seconds=5.0)
        held = ", ".join(f"{one} {force:.3g} N" for one, force in zip(plan.contacts.names, plan.forces.normal_forces))
        print(f"{name}: {plan.status}; {held}", flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
