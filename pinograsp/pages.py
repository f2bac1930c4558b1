"""Texts made from the templates of the package; what is filled in is shown as it is, and can be no markup."""

from __future__ import annotations

import functools
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from pinograsp.words import escape_controls, printable

if TYPE_CHECKING:
    from jinja2 import Environment

LONGEST = 2000  # characters of a text from a file


def render(
    template: str, quote: Callable[[str], str] | None = None, *, longest: int = LONGEST, **values: object
) -> str:
    """A template with texts filled in.

    Args:
        template: its file within the package, such as ``report/report.html``.
        quote: how texts are made harmless; None: as HTML.
        longest: characters of a text; longer ones are cut.
        values: by their names in the template.
    """
    return _environment(quote, longest).get_template(template).render(**values)


@functools.cache
def _environment(quote: Callable[[str], str] | None, longest: int) -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined
    from markupsafe import Markup, escape

    def show(value: object) -> object:
        if isinstance(value, Markup):  # of a template, or quoted already
            return value
        text = printable(str(value), longest).strip()
        return text if quote is None else Markup(quote(text))

    def lines(text: str) -> Markup:
        text = escape_controls(text, keep="\n")
        return escape(text) if quote is None else Markup(text.replace("```", "'''"))

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).parent),
        autoescape=True,
        finalize=show,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters["lines"] = lines
    return environment
