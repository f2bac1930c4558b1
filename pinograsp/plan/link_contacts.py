"""Where a plan's contacts are on the links of its hand."""

from __future__ import annotations

from dataclasses import dataclass

from pinograsp.checks import brief
from pinograsp.plan.plain_fields import Plain
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LinkContacts:
    """Where on its links a hand touches (k contacts), to be compared with the place of a patch of taxels.

    Attributes:
        names: (k,).
        links: the links that touch (k,).
        points_l: contact points in the frames of these links (k, 3) [m], at the first touch.
        normals_l: unit normals there, out of the link and into the object (k, 3).
        normal_forces: planned F_n (k,) [N].
    """

    names: tuple[str, ...]
    links: tuple[str, ...]
    points_l: Array
    normals_l: Array
    normal_forces: Array

    __repr__ = brief("names", "links")

    def summary(self) -> Plain:
        """As plain JSON values, by contact."""
        rows = zip(self.names, self.links, self.points_l, self.normals_l, self.normal_forces, strict=True)
        return {
            name: {"link": link, "point_m": point.tolist(), "normal": normal.tolist(), "normal_force_N": float(force)}
            for name, link, point, normal, force in rows
        }
