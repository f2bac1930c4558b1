"""The viewer of a run: a live page, or one HTML file that needs only a browser."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from pinograsp.checks import number, shorten
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.plan import PlanRecord, Simulation
from pinograsp.spatial import Array, pose_of, tangent_frame
from pinograsp.viz.access import free_port, guard_server
from pinograsp.viz.page import save_html
from pinograsp.viz.panel import foot, forces, head, short, torques
from pinograsp.viz.scene import ViewScene, make_scene
from pinograsp.viz.scene_meshes import AXES, GHOST, LOAD
from pinograsp.viz.solids import Look, to_sevens
from pinograsp.viz.viser_values import arrow_size, colour, dark

if TYPE_CHECKING:
    import viser

__all__ = ["Viewer", "save_html", "view"]

_SHOWN = 30.0  # instants per second that a browser keeps up with
_LAYERS = {
    "hand": "hand",
    "object": "object",
    "frames": "contact frames",
    "cones": "friction cones",
    "forces": "forces",
    "labels": "labels",
    "ground": "ground",
    "simulation": "simulation",
    "collision": "collision shapes",
}
_FOV = np.radians(35.0)
_STEP = 1e-3  # [s] of the time slider
_APART = 0.12  # of the slider: marks that are nearer overlap


def view(
    plan: PlanRecord,
    *,
    simulation: Simulation | None = None,
    port: int = 8080,
    host: str = "localhost",
    open_browser: bool = True,
) -> Viewer:
    """Show a plan on a live page, in a browser on this machine.

    Args:
        plan: the page shows its margins if it has them.
        simulation: a simulation of the plan to show beside it.
        port: first port to try.
        host: ``"0.0.0.0"`` admits other machines as well, by this machine's address or name. Requests from foreign web
            pages are rejected.
        open_browser: whether to open the page; its address is ``viewer.url``.

    Raises:
        InvalidInput: a plan without its hand, a simulation of another plan, or an unusable port.
        HandNotLoaded: mesh files are missing.
        ExtraMissing: viser (extra ``viz``) is not installed.
    """
    return open_viewer(make_scene(plan, simulation), port=port, host=host, open_browser=open_browser)


def open_viewer(scene: ViewScene, *, port: int, host: str = "localhost", open_browser: bool = True) -> Viewer:
    """Open a live page of a scene; see :func:`view`."""
    if not isinstance(port, int) or isinstance(port, bool) or not 0 <= port < 65536:
        raise InvalidInput(f"port: expected a whole number from 0 to 65535, got {shorten(port)}")
    viewer = Viewer(scene, port, host)
    if open_browser:
        import webbrowser

        webbrowser.open(viewer.url)
    return viewer


# -- the live page -----------------------------------------------------------------------------------------------------


class _BodyFrames(NamedTuple):
    """Frames of one hand and its object in the scene, of the plan or of the simulation."""

    links: list[viser.FrameHandle]
    object: viser.FrameHandle | None


class Viewer:
    """A live page, which :meth:`show`, :meth:`play`, :meth:`pause` and :meth:`close` control.

    Attributes:
        scene: what it shows.
        server: the ``viser.ViserServer``, to which more can be added.
        url: address of the page.
    """

    def __init__(self, scene: ViewScene, port: int, host: str):
        try:
            import viser
        except ImportError as error:
            raise ExtraMissing(
                f"the live page needs viser: pip install 'pinograsp[viz]', or write a file: save_html, --html ({error})"
            ) from error
        self.scene = scene
        port = free_port(host, port)
        with guard_server(host):
            self.server = viser.ViserServer(host=host, port=port, label="pinograsp", verbose=False)
        shown = "localhost" if host in ("0.0.0.0", "127.0.0.1", "::") else host
        self.url = f"http://{shown}:{self.server.get_port()}"
        self._frame, self._scale = scene.frame_at(scene.closed), scene.force_scale
        self._lock, self._closed = threading.RLock(), threading.Event()
        self._playing = threading.Event()
        self._layers: dict[str, list[tuple[viser.SceneNodeHandle, Look]]] = {name: [] for name in _LAYERS}
        self._on = {name: name != "collision" for name in _LAYERS}
        try:
            self._set_stage()
            self._add_bodies()
            self._add_contacts()
            self._add_panel()
            self._draw()
        except BaseException:
            self.server.stop()
            raise
        self._thread = threading.Thread(target=self._run, name="pinograsp-viewer", daemon=True)
        self._thread.start()

    def show(self, time: float) -> None:
        """Stop playing, and show the instant nearest to ``time`` [s]."""
        self.pause()
        self._move_slider(self.scene.frame_at(number("time", time, unit="s")))

    @property
    def time(self) -> float:
        """The instant shown [s]."""
        return float(self.scene.times[self._frame])

    def play(self) -> None:
        """Play from the present instant, or from the start if that is the last one."""
        if self._frame >= len(self.scene.times) - 1:
            self._move_slider(0)
        self._playing.set()
        self._play.label = "Pause"

    def pause(self) -> None:
        """Stop playing."""
        self._playing.clear()
        self._play.label = "Play"

    def wait(self) -> None:
        """Return when the viewer is closed; Ctrl-C interrupts it."""
        while not self._closed.wait(0.2):
            pass

    def close(self) -> None:
        """Stop the server; a second call does nothing."""
        if not self._closed.is_set():
            self._closed.set()
            self._playing.set()  # wakes the thread that plays
            self._thread.join(timeout=2.0)
            self.server.stop()

    def __enter__(self) -> Viewer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def _run(self) -> None:
        while not self._closed.is_set():
            self._playing.wait()
            if self._closed.is_set():
                return
            # Instants that pass faster than a browser keeps up with are skipped.
            rate, last = self.scene.rate * self._speed.value, len(self.scene.times) - 1
            ahead = max(1, round(rate / _SHOWN))
            if self._frame >= last:
                self.pause()
            else:
                self._move_slider(min(self._frame + ahead, last))
            time.sleep(ahead / rate)

    def _move_slider(self, frame: int) -> None:
        self._redraw(frame)
        self._slider.value = self._tell(frame)  # type: ignore[misc]  # viser's setter, which mypy does not find

    def _tell(self, frame: int) -> float:
        """The time of an instant as the slider has it [s]."""
        return round(float(self.scene.times[frame]) / _STEP) * _STEP

    def _follow(self, time: float) -> None:
        """Show what the slider says, unless it was told that: it is coarser than the instants."""
        if abs(time - self._tell(self._frame)) > 0.5 * _STEP:
            self._redraw(self.scene.frame_at(time))

    # The scene.

    def _set_stage(self) -> None:
        scene, world = self.scene, self.server.scene
        world.set_up_direction(np.array(scene.up))
        world.configure_environment_map("studio", environment_intensity=0.35)
        # The panel covers the right third of a window half as wide again as high: the scene is to fit beside it.
        width, height, depth = scene.extent
        seen = 1.15 * max(height, width)  # half the height of the view, where the scene is
        distance = 0.6 * depth + seen / np.tan(_FOV / 2)
        camera = self.server.initial_camera
        camera.fov, camera.near, camera.far = float(_FOV), float(0.01 * distance), float(100 * distance)
        aside = 0.5 * seen * np.cross(scene.up, scene.view) / np.linalg.norm(np.cross(scene.up, scene.view))
        camera.look_at, camera.position = scene.centre + aside, scene.centre + aside + distance * scene.view
        reach, cell = float(8 * scene.extent.max()), scene.cell
        self._keep(
            "ground",
            world.add_grid(
                "/ground",
                width=reach,
                height=reach,
                cell_size=cell,
                section_size=5 * cell,
                cell_color=(214, 220, 227),
                section_color=(160, 170, 181),
                fade_distance=3 * reach,
                shadow_opacity=0.2,
                wxyz=to_sevens(pose_of(rotation=tangent_frame(scene.up, np.zeros(3))))[3:],
                position=scene.centre + (scene.ground - scene.up @ scene.centre) * scene.up,
            ),
        )

    def _add_bodies(self) -> None:
        scene = self.scene
        self._bodies: list[_BodyFrames] = []
        self._root: viser.FrameHandle | None = None  # of the simulation
        self._ghost: list[tuple[viser.MeshHandle, float | None]] = []  # its meshes, with their opacity
        links = scene.link_poses.shape[1]
        self._add_body("plan", links, np.zeros(3), ("hand", "object"), has_object=scene.object_pose is not None)
        if scene.simulated is not None:
            shift = scene.simulated.beside
            self._root = self._add_body("simulation", links, shift, ("simulation", "simulation"), has_object=True)

    def _add_body(
        self, name: str, links: int, shift: Array, layers: tuple[str, str], *, has_object: bool
    ) -> viser.FrameHandle:
        """Add a hand and its object, moved by ``shift``; ``layers``: theirs. Returns their common frame."""
        world, simulated = self.server.scene, name == "simulation"
        root = world.add_frame(f"/{name}", show_axes=False, position=shift)
        frames = [world.add_frame(f"/{name}/link{i}", show_axes=False) for i in range(links)]
        held = world.add_frame(f"/{name}/object", show_axes=False) if has_object else None
        self._bodies.append(_BodyFrames(frames, held))
        for i, solid in enumerate(self.scene.solids):
            is_object = solid.link is None
            parent = f"/{name}/object" if is_object else f"/{name}/link{solid.link}"
            shade = GHOST if simulated and not is_object else solid.colour
            opacity = 0.6 if is_object else None
            mesh = world.add_mesh_simple(
                f"{parent}/{i}", solid.vertices, solid.faces, color=colour(shade), side="double", opacity=opacity
            )
            if simulated:
                self._ghost.append((mesh, opacity))
            self._keep(layers[1] if is_object else layers[0], mesh, solid.look)
        return root

    def _add_contacts(self) -> None:
        scene, world, k = self.scene, self.server.scene, len(self.scene.contacts)
        width = scene.thickness
        # Contacts and forces as planned, under a frame that the palm carries.
        self._grasp = world.add_frame("/contacts", show_axes=False)
        thick, thin = arrow_size(width), arrow_size(0.42 * width)
        ends = scene.points_o[:, None] + 0.6 * scene.cone_height * np.moveaxis(scene.rotations_oc, 1, 2)
        points = np.stack([np.repeat(scene.points_o[:, None], 3, axis=1), ends], axis=2).reshape(-1, 2, 3)
        self._keep(
            "frames", world.add_arrows("/contacts/frames", points, np.array([dark(c) for c in AXES] * k), **thin)
        )
        outside = scene.points_o - 0.5 * scene.cone_height * scene.rotations_oc[:, :, 2]
        self._arrows: list[viser.ArrowsHandle] = []
        self._labels: list[viser.LabelHandle] = []
        for i, name in enumerate(scene.colours):
            place = to_sevens(pose_of(scene.points_o[i], scene.rotations_oc[i]))
            cone = world.add_mesh_simple(
                f"/contacts/cone{i}", *scene.cones[i], color=colour(name), opacity=0.3, side="double", cast_shadow=False
            )
            cone.position, cone.wxyz = place[:3], place[3:]
            self._keep("cones", cone)
            force = scene.arrows(self._frame)[i : i + 1]
            self._arrows.append(world.add_arrows(f"/contacts/force{i}", force, dark(name), **thick))
            self._labels.append(world.add_label(f"/contacts/label{i}", "", position=outside[i], anchor="bottom-center"))
        self._load = world.add_arrows("/contacts/load", np.zeros((1, 2, 3)), dark(LOAD), **thick)
        self._head = thick["head_length"]
        self._pressing: list[viser.ArrowsHandle] = []
        if scene.simulated is not None:
            for i, part in enumerate(scene.simulated.parts):
                deep = dark(scene.colour_of(part))
                self._pressing.append(world.add_arrows(f"/simulation/force{i}", np.zeros((1, 2, 3)), deep, **thick))
            top = scene.centre - scene.simulated.beside / 2 + scene.extent[1] * scene.up
            verdict = "held" if scene.simulated.held else "lost"
            self._keep("labels", world.add_label("/signs/plan", "planned", position=top))
            self._keep("simulation", world.add_label("/simulation/sign", f"simulated: {verdict}", position=top))

    def _keep(self, layer: str, handle: viser.SceneNodeHandle, look: Look = "always") -> None:
        handle.visible = look != "collision"
        self._layers[layer].append((handle, look))

    # The panel.

    def _add_panel(self) -> None:
        gui, scene = self.server.gui, self.scene
        gui.configure_theme(control_width="large", show_logo=False, show_share_button=False, brand_color=(0, 114, 178))
        gui.add_html(head(scene))
        last = len(scene.times) - 1
        end = self._tell(last)
        marks = {0.0: "0", end: f"{end:g}"}
        if scene.carried is None:
            marks |= {scene.touch: "touch"}
            if scene.closed - scene.touch > _APART * end:
                marks |= {scene.closed: "t_F"}
        now, ticks = self._tell(self._frame), tuple(marks.items())
        self._slider = gui.add_slider(
            "time [s]", min=0.0, max=max(end, _STEP), step=_STEP, initial_value=now, marks=ticks
        )
        self._play = gui.add_button("Play")
        self._forces = gui.add_html("")
        with gui.add_folder("Show"):
            for name, text in _LAYERS.items():
                lacking = {"simulation": scene.simulated is None, "collision": not scene.has_collision_shapes}
                if not lacking.get(name):
                    label = "friction pyramids" if name == "cones" and scene.pyramids else text
                    self._add_toggle(gui.add_checkbox(label, self._on[name]), name)
            if scene.simulated is not None:
                beside = gui.add_checkbox("simulation beside", True)
                beside.on_update(lambda _: self._set_beside(bool(beside.value)))
            scale = 1e3 * scene.force_scale
            arrows = gui.add_slider(
                "arrows [mm/N]", min=0.1 * scale, max=10 * scale, step=0.01 * scale, initial_value=scale
            )
            self._speed = gui.add_slider("play speed", min=0.1, max=4.0, step=0.1, initial_value=1.0)
        with gui.add_folder(scene.heading):
            gui.add_html(foot(scene))
        with gui.add_folder("Joint torques"):
            self._torques = gui.add_html("")
        self._slider.on_update(lambda _: self._follow(float(self._slider.value)))
        self._play.on_click(lambda _: self.pause() if self._playing.is_set() else self.play())
        arrows.on_update(lambda _: self._redraw(scale=1e-3 * arrows.value))

    def _add_toggle(self, box: viser.GuiCheckboxHandle, layer: str) -> None:
        def change(_: object) -> None:
            with self._lock:
                self._on[layer] = bool(box.value)
                hidden = "visual" if self._on["collision"] else "collision"
                for name, kept in self._layers.items():
                    for handle, look in kept:
                        handle.visible = self._on[name] and look != hidden
                self._draw()

        box.on_update(change)

    def _set_beside(self, beside: bool) -> None:
        """Show the simulation beside the plan, or transparent in the same place."""
        if self._root is None or self.scene.simulated is None:
            return
        with self._lock:
            self._root.position = self.scene.simulated.beside * beside
            for mesh, opacity in self._ghost:
                mesh.opacity = opacity if beside else 0.3

    def _redraw(self, frame: int | None = None, scale: float | None = None) -> None:
        with self._lock:
            self._frame = self._frame if frame is None else frame
            self._scale = self._scale if scale is None else scale
            self._draw()

    def _draw(self) -> None:
        scene, i = self.scene, self._frame
        tracks: list[tuple[Array, Array | None]] = [(scene.link_poses[i], scene.object_at(i))]
        if scene.simulated is not None:
            tracks.append((scene.simulated.link_poses[i], scene.simulated.object_poses[i]))
        with self.server.atomic():
            for (link_poses, object_pose), body in zip(tracks, self._bodies):
                for pose, frame in zip(link_poses, body.links):
                    frame.position, frame.wxyz = pose[:3], pose[3:]
                if body.object is not None and object_pose is not None:
                    body.object.position, body.object.wxyz = object_pose[:3], object_pose[3:]
            for points, handle in zip(scene.arrows(i, self._scale), self._arrows):
                self._aim(handle, points)
            self._aim(self._load, scene.load_arrow(i, self._scale))
            if scene.carried is not None:
                self._grasp.position, self._grasp.wxyz = scene.carried[i, :3], scene.carried[i, 3:]
            if scene.simulated is not None:
                for points, handle in zip(scene.simulated.arrows(i, self._scale), self._pressing):
                    self._aim(handle, points, self._on["simulation"])
            for k, label in enumerate(self._labels):
                label.text = f"{scene.contacts[k]} {short(scene.normal[i, k])} N"
                label.visible = bool(self._on["labels"] and scene.normal[i, k] > 0)
            self._forces.content, self._torques.content = forces(scene, i), torques(scene, i)

    def _aim(self, handle: viser.ArrowsHandle, points: Array, on: bool = True) -> None:
        length = float(np.linalg.norm(points[1] - points[0]))
        handle.visible = bool(on and self._on["forces"] and length > 1e-5)
        if length > 1e-5:
            handle.points, handle.head_length = points[None].astype(np.float32), min(self._head, 0.6 * length)
