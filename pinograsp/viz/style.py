"""Colours and names as figures show them."""

from __future__ import annotations

from pinograsp.words import printable

# Okabe-Ito colours, which colour-blind readers can distinguish.
COLOURS = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#000000")


def label_of(name: str) -> str:
    """A name from a file as Matplotlib's text: short, without formulas, and never hidden from a legend."""
    name = printable(name, 40).replace("$", r"\$")
    return f" {name}" if name.startswith("_") or not name else name
