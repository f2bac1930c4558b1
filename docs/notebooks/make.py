"""Notebooks of tutorials, executed.

Their first cell installs the package on a hosted service.

Run it without arguments to make all of them, or with the names of some.
"""

from __future__ import annotations

import base64
import io
import re
import sys
import tempfile
from pathlib import Path

import jupytext
import nbformat
from nbclient import NotebookClient
from PIL import Image

HERE = Path(__file__).resolve().parent
NEEDED = {"data_set": "pyarrow"}  # package of an extra that a tutorial needs
NAMES = (
    "own_hand",
    "gripper",
    "position_servos",
    "loop",
    "reflex",
    "data_set",
    "carry",
    "paper",
)
INSTALL = """\
# If pinograsp is not installed here, as on a hosted service: set SOURCE to a wheel, a
# source archive or a checkout of it. This is a path (upload the file beside the
# notebook) or a URL.
SOURCE = "pinograsp-*.tar.gz"

import site
from importlib.util import find_spec

if find_spec("pinograsp") is None:
    %pip install -q {SOURCE}
    # Pinocchio is in a folder of its own, which Python looks for when it starts
    site.main()"""
INSTALL_ALSO = """
if find_spec("{0}") is None:
    %pip install -q {0}"""
COLOURS = 256  # of a picture: a quarter of the bytes, and it looks the same


def notebook(name: str) -> str:
    """The notebook of a tutorial, as JSON without outputs."""
    made = jupytext.read(HERE.parent / "tutorials" / f"{name}.md", fmt="md:myst")
    also = INSTALL_ALSO.format(NEEDED[name]) if name in NEEDED else ""
    made.cells.insert(1, nbformat.v4.new_code_cell(INSTALL + also))
    for number, one in enumerate(made.cells):
        one["id"] = f"cell-{number}"
        one["metadata"] = {}
        if one.cell_type == "markdown":  # other tutorials are in their own folder
            one.source = re.sub(r"\]\((\w+\.md)", r"](../tutorials/\1", one.source)
    kernel = {"display_name": "Python 3", "language": "python", "name": "python3"}
    made.metadata = {"kernelspec": kernel}
    made.nbformat, made.nbformat_minor = 4, 5
    return nbformat.writes(made) + "\n"


def execute(made: nbformat.NotebookNode) -> None:
    """Run a notebook in a folder of its own, and keep what it shows."""
    with tempfile.TemporaryDirectory() as folder:
        place = {"metadata": {"path": folder}}
        client = NotebookClient(
            made,
            timeout=600,
            record_timing=False,
            coalesce_streams=True,
            resources=place,
        )
        client.execute()
    made.metadata.pop("language_info", None)  # of this machine
    for cell in made.cells:
        for output in cell.get("outputs", ()):
            data = output.get("data", {})
            if "image/png" in data:
                data["image/png"] = shrink(data["image/png"])


def shrink(picture: str) -> str:
    """A picture with fewer colours, as base64."""
    image = Image.open(io.BytesIO(base64.b64decode(picture))).convert("RGB")
    image = image.quantize(COLOURS, dither=Image.Dither.NONE)
    image.save(file := io.BytesIO(), "png", optimize=True)
    return base64.b64encode(file.getvalue()).decode()


if __name__ == "__main__":
    for one in sys.argv[1:] or NAMES:
        book = nbformat.reads(notebook(one), as_version=4)
        execute(book)
        path = HERE / f"{one}.ipynb"
        path.write_text(nbformat.writes(book) + "\n", encoding="utf-8")
        print(path.name, path.stat().st_size // 1000, "kB")
