"""How records show in a notebook."""

from __future__ import annotations

import importlib


def in_notebook(self: object) -> str | None:
    """``_repr_html_`` of a record: a picture where there is something to see, and its main figures.

    What draws it is above all records, and found by way of the front door, which loads it when it is asked for. None,
    which stands for the text, where it cannot be drawn: showing a record never fails.
    """
    try:
        package = importlib.import_module(__name__.partition(".")[0])
        html: str | None = package.notebook.render_record(self)
        return html
    except Exception:
        return None
