"""Formulas as MathML, which browsers draw by themselves: no script, no other host."""

from __future__ import annotations

import re
from typing import Any

from docutils import nodes
from latex2mathml.converter import convert
from sphinx.application import Sphinx
from sphinx.errors import ExtensionError

# What the converter has no word for, in words that it has.
_SAME = {
    r"\boldsymbol": r"\mathbf",
    r"\tfrac": r"\frac",
    r"\lvert": "|",
    r"\rvert": "|",
}


def write_formula(formula: str, *, display: str = "inline") -> str:
    """A formula in TeX as MathML.

    Raises:
        ExtensionError: a command that the converter does not know.
    """
    formula = re.sub(r"\\[A-Za-z]+", lambda one: _SAME.get(one[0], one[0]), formula)
    written = convert(formula, display=display)
    if left := re.search(r"\\[A-Za-z]+", written):
        raise ExtensionError(f"{left[0]} has no MathML, in the formula {formula}")
    return written


def _write_inline(writer: Any, node: nodes.math) -> None:
    writer.body.append(f'<span class="math">{write_formula(node.astext())}</span>')
    raise nodes.SkipNode


def _write_block(writer: Any, node: nodes.math_block) -> None:
    formula = write_formula(node.astext(), display="block")
    writer.body.append(f'<div class="math">{formula}</div>')
    raise nodes.SkipNode


def setup(app: Sphinx) -> dict[str, bool]:
    """What Sphinx calls first."""
    app.add_html_math_renderer("mathml", (_write_inline, None), (_write_block, None))
    return {"parallel_read_safe": True, "parallel_write_safe": True}
