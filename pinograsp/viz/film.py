"""Moving pictures of a grasp: the fingers close, and the forces grow."""

from __future__ import annotations

import io
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path

import matplotlib as mpl
import numpy as np
from matplotlib.animation import FFMpegWriter
from matplotlib.figure import Figure
from numpy.typing import ArrayLike
from PIL import Image
from tqdm import tqdm

from pinograsp.checks import flag, number, path_of
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.spatial import IntArray
from pinograsp.viz.scene import ViewScene
from pinograsp.viz.still import Sheet, draw, find_camera
from pinograsp.writing import write_file

_SHEETS = {
    ".gif": Sheet(width=480, height=360, dpi=96, fading=False),
    ".mp4": Sheet(width=720, height=540, dpi=144, fading=False),
}
_RATES = {".gif": 15, ".mp4": 24}  # pictures per second
_SHARES = (0.5, 0.3, 0.2)  # of the time: the approach, the forces' growth, and what comes then or the last picture
_SEEN = 9  # instants that the camera is to see
_COLOURS = 255  # of a GIF
_LONGEST = 60.0  # [s]


def write_film(
    scene: ViewScene,
    path: str | Path,
    *,
    view: ArrayLike | None = None,
    collision_shapes: bool = False,
    seconds: float = 4.0,
    progress: bool | None = None,
) -> Path:
    """Write a film of a scene; returns its path.

    Args:
        scene: the film shows its instants, slower while forces grow, and stays on the last one for a while.
        path: .gif (480 x 360 pixels, in an endless loop) or .mp4 (720 x 540, needs ffmpeg).
        view: as for :func:`~pinograsp.viz.still.picture`; the camera does not move.
        collision_shapes: draw the collision shapes instead of the visual ones.
        seconds: length of the film, up to 60.
        progress: show a progress bar; None: on a terminal.

    Raises:
        InvalidInput: another suffix, view or length.
        ExtraMissing: ffmpeg is missing for an MP4.
        ResultsNotWritten: the file cannot be written.
    """
    path = path_of("path", path)
    kind = path.suffix.lower()
    if kind not in _SHEETS:
        raise InvalidInput(
            f"film: expected a name that ends in {' or '.join(_SHEETS)} (for stills, .png, .svg and .pdf, use "
            f"picture), got '{path.name:.200}'"
        )
    seconds, collision_shapes = number("seconds", seconds, unit="s"), flag("collision_shapes", collision_shapes)
    if not 0.5 <= seconds <= _LONGEST:
        raise InvalidInput(f"seconds: expected 0.5 to {_LONGEST:g} s, got {seconds:g}")
    program = _ffmpeg() if kind == ".mp4" else ""
    sheet, rate = _SHEETS[kind], _RATES[kind]
    frames = choose_frames(scene, round(rate * seconds))
    seen = frames[np.linspace(0, len(frames) - 1, _SEEN).astype(int)]
    camera = find_camera(scene, view, np.unique(seen).tolist(), sheet)
    figure = sheet.figure()
    bar = tqdm(total=len(frames), desc=path.name, unit="picture", disable=None if progress is None else not progress)

    def draw_frames() -> Iterator[Figure]:
        last = -1
        with bar:
            for frame in frames.tolist():
                if frame != last:
                    figure.clear()
                    draw(figure, scene, frame, camera, sheet, collision_shapes=collision_shapes)
                    last = frame
                bar.update()
                yield figure

    if kind == ".gif":
        return write_file(path, _gif([_image_of(one, sheet) for one in draw_frames()], rate))
    return write_file(path, _mp4(figure, draw_frames(), rate, program))


def _image_of(figure: Figure, sheet: Sheet) -> Image.Image:
    content = io.BytesIO()
    figure.savefig(content, format="rgba", dpi=figure.dpi)
    return Image.frombytes("RGBA", (sheet.width, sheet.height), content.getvalue()).convert("RGB")


def choose_frames(scene: ViewScene, count: int) -> IntArray:
    """Choose the instants of ``count`` pictures; the last one stays."""
    last = len(scene.times) - 1
    stops = [0, scene.frame_at(scene.touch), scene.frame_at(scene.closed), last]
    parts = [(first, until, share) for first, until, share in zip(stops, stops[1:], _SHARES) if until > first]
    stay = max(1, round(0.2 * count))
    whole = sum(share for *_, share in parts)
    at, done = np.zeros(0), 0.0
    for first, until, share in parts:
        begin, done = round((count - stay) * done / whole), done + share
        many = round((count - stay) * done / whole) - begin
        at = np.r_[at, np.linspace(first, until, many, endpoint=False)]
    frames: IntArray = np.r_[np.round(at).astype(int), np.full(count - len(at), last)]
    return frames


def _gif(images: list[Image.Image], rate: float) -> bytes:
    """One palette for all pictures, without dithering: what does not move stays the same, and takes no room."""
    few = [images[i] for i in np.unique(np.linspace(0, len(images) - 1, 6).astype(int))]
    board = Image.new("RGB", (few[0].width, few[0].height * len(few)))
    for i, one in enumerate(few):
        board.paste(one, (0, i * one.height))
    # By the range of colours, not by their areas: fingers are small, and must keep theirs.
    palette = board.quantize(_COLOURS, Image.Quantize.MAXCOVERAGE, kmeans=2)
    first, *rest = (one.quantize(palette=palette, dither=Image.Dither.NONE) for one in images)
    content = io.BytesIO()
    first.save(content, "GIF", save_all=True, append_images=rest, duration=round(1000 / rate), loop=0, optimize=True)
    return content.getvalue()


def _mp4(figure: Figure, drawn: Iterable[Figure], rate: int, program: str) -> bytes:
    with tempfile.TemporaryDirectory(prefix="pinograsp-") as folder, mpl.rc_context({"animation.ffmpeg_path": program}):
        path = Path(folder) / "film.mp4"
        writer = FFMpegWriter(fps=rate, codec="h264", extra_args=["-pix_fmt", "yuv420p", "-crf", "20"])
        with writer.saving(figure, str(path), figure.dpi):
            for _ in drawn:
                writer.grab_frame()
        return path.read_bytes()


def _ffmpeg() -> str:
    """The program that writes MP4 files: the system's, or that of the package imageio-ffmpeg."""
    if (own := shutil.which("ffmpeg")) is not None:
        return own
    try:
        from imageio_ffmpeg import get_ffmpeg_exe
    except ImportError as error:
        raise ExtraMissing(
            "a film as .mp4 needs ffmpeg: pip install 'pinograsp[viz]', or apt install ffmpeg; or write a .gif"
        ) from error
    return str(get_ffmpeg_exe())
