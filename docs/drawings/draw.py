"""The drawings of the concepts' pages, as SVG files beside this one."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
from matplotlib.patches import Circle, Polygon, Rectangle

HERE = Path(__file__).resolve().parent
plt.rcParams.update({"font.size": 11, "font.family": "sans-serif"})
plt.rcParams.update({"svg.fonttype": "none", "svg.hashsalt": "pinograsp"})
RED, GREEN, BLUE, GREY = "#c44e52", "#2a8a4a", "#2f6fb3", "#8a8f98"


def arrow(axes, start, way, colour, text="", offset=(0.0, 0.0)):
    """From ``start`` along ``way``, with a text at its end."""
    axes.annotate(
        "",
        xy=np.add(start, way),
        xytext=start,
        arrowprops={
            "arrowstyle": "-|>",
            "color": colour,
            "lw": 2,
            "shrinkA": 0,
            "shrinkB": 0,
        },
    )
    if text:
        end = np.add(np.add(start, np.multiply(way, 1.0)), offset)
        axes.text(*end, text, color=colour, ha="center", va="center")


def frame(axes, at, angle, name, size=0.55, offset=(-0.16, -0.16), labels=("x", "z")):
    """Two axes of a frame in the plane of the drawing."""
    c, s = np.cos(angle), np.sin(angle)
    arrow(axes, at, (size * c, size * s), RED, labels[0], (0.13 * c, 0.13 * s))
    arrow(axes, at, (-size * s, size * c), BLUE, labels[1], (-0.13 * s, 0.13 * c))
    axes.add_patch(Circle(at, 0.04, color="black", zorder=3))
    x, y = np.add(at, offset)
    axes.text(x, y, name, ha="center", va="center", fontweight="bold")


def page(width, height, x, y):
    """Empty axes of this size [inch] and these limits."""
    figure, axes = plt.subplots(figsize=(width, height))
    axes.set(xlim=x, ylim=y, aspect="equal")
    axes.axis("off")
    figure.subplots_adjust(0, 0, 1, 1)
    return figure, axes


def frames():
    """World, hand, object, contact."""
    figure, axes = page(5.8, 3.6, (-0.8, 6.9), (-0.7, 4.0))
    axes.add_patch(
        Rectangle((2.6, 0.6), 1.5, 2.4, facecolor="#dfe7ef", edgecolor=GREY, lw=1.5)
    )
    axes.text(3.35, 2.75, "object", ha="center", color=GREY)
    # A finger of two links from a palm on the right.
    finger = np.array([[5.9, 0.8], [5.7, 2.2], [4.35, 2.05]])
    axes.plot(*finger.T, lw=16, color="#cfcfd4", solid_capstyle="round", zorder=1)
    axes.plot(*finger.T, "o", color=GREY, ms=6)
    axes.add_patch(
        Rectangle((5.5, -0.2), 0.95, 0.75, facecolor="#cfcfd4", edgecolor=GREY)
    )
    axes.text(5.98, -0.4, "hand", ha="center", color=GREY)
    frame(axes, (0.0, 0.0), 0.0, "o  world", offset=(-0.25, -0.3))
    frame(axes, (3.2, 0.95), 0.0, "b", size=0.5)
    frame(axes, (5.8, -0.08), 0.0, "h", size=0.4, offset=(-0.18, 0.08))
    # z of the contact into the object, x against gravity.
    arrow(axes, (4.1, 2.0), (-0.6, 0.0), BLUE, "z", (-0.13, 0.0))
    arrow(axes, (4.1, 2.0), (0.0, 0.6), RED, "x", (0.14, 0.05))
    axes.add_patch(Circle((4.1, 2.0), 0.045, color="black", zorder=3))
    axes.text(4.28, 1.72, "c", fontweight="bold")
    arrow(axes, (1.3, 3.4), (0.0, -0.7), GREY, "gravity", (0.0, -0.16))
    figure.savefig(HERE / "frames.svg", facecolor="white", metadata={"Date": None})


def contact():
    """Cone, forces and depth."""
    figure, axes = page(4.8, 3.2, (-2.5, 2.8), (-1.6, 2.0))
    axes.add_patch(
        Rectangle((-2.4, 0.0), 5.2, 1.9, facecolor="#dfe7ef", edgecolor="none")
    )
    axes.plot([-2.4, 2.8], [0, 0], color=GREY, lw=1.5)
    axes.text(-2.3, 1.7, "object", color=GREY)
    axes.add_patch(
        Circle((0, -0.84), 1.0, facecolor="#cfcfd4", edgecolor=GREY, alpha=0.9)
    )
    axes.text(0, -1.0, "fingertip", ha="center", color="#55585e")
    mu = 0.6
    axes.add_patch(
        Polygon(
            [[0, 0], [1.7 * mu, 1.7], [-1.7 * mu, 1.7]],
            facecolor=GREEN,
            alpha=0.16,
            edgecolor=GREEN,
        )
    )
    axes.text(
        1.15, 1.5, "friction cone,\n" r"$|F_t| \leq \mu F_n$", color=GREEN, va="center"
    )
    arrow(axes, (0, 0), (0.45, 1.3), "black", r"$h$", (0.13, 0.03))
    arrow(axes, (0, 0), (0.0, 1.3), BLUE, r"$F_n$", (-0.22, -0.05))
    arrow(axes, (0, 0), (0.45, 0.0), RED, r"$f_x, f_y$", (0.42, 0.14))
    axes.annotate(
        "",
        xy=(-1.35, 0.14),
        xytext=(-1.35, 0.0),
        arrowprops={"arrowstyle": "<->", "color": "black"},
    )
    axes.plot([-1.45, 0], [0.14, 0.14], color=GREY, lw=0.8, ls=":")
    axes.text(-1.62, 0.16, r"depth $\delta$", ha="right", va="center")
    figure.savefig(HERE / "contact.svg", facecolor="white", metadata={"Date": None})


if __name__ == "__main__":
    frames()
    contact()
