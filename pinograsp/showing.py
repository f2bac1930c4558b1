"""How records show in a notebook: what draws them is above all of them, and the front door names it here."""

from __future__ import annotations

from collections.abc import Callable

_drawing: list[Callable[[object], str | None]] = []


def drawn_by(html_of: Callable[[object], str | None]) -> None:
    """Let ``html_of`` draw records: their HTML, or None for those that show as text."""
    _drawing[:] = [html_of]


def in_notebook(self: object) -> str | None:
    """``_repr_html_`` of a record: a picture where there is something to see, and its main figures.

    None, which stands for the text, where it cannot be drawn: showing a record never fails.
    """
    try:
        return _drawing[0](self) if _drawing else None
    except Exception:
        return None
