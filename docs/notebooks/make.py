"""Notebooks of three tutorials, with a first cell for a hosted service."""

from __future__ import annotations

from pathlib import Path

import jupytext
import nbformat

HERE = Path(__file__).resolve().parent
NAMES = ("own_hand", "paper", "carry")
INSTALL = "# On a hosted service, once:\n# %pip install -q pinograsp[mesh]"


def notebook(name: str) -> str:
    """The notebook of a tutorial, as JSON without outputs."""
    made = jupytext.read(HERE.parent / "tutorials" / f"{name}.md", fmt="md:myst")
    cell = nbformat.v4.new_code_cell(INSTALL)
    made.cells.insert(1, cell)
    for number, one in enumerate(made.cells):
        one["id"] = f"cell-{number}"
        one["metadata"] = {}
    made.metadata = {"kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"}}
    made.nbformat, made.nbformat_minor = 4, 5
    return nbformat.writes(made) + "\n"


if __name__ == "__main__":
    for one in NAMES:
        (HERE / f"{one}.ipynb").write_text(notebook(one), encoding="utf-8")
