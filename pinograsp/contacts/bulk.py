"""Where a hand touches an object at many postures: one acceleration structure, arrays in and arrays out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import coal
import numpy as np

from pinograsp import core
from pinograsp.checks import brief, instance_of, read_only
from pinograsp.contacts.clearance import PALM, HandPart, check_geometry, parts_of
from pinograsp.contacts.compiled import SupportShape, corners_of, joints_of, support_shape
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.core.threads import share_out
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.hands.geometry import hull_points
from pinograsp.objects.body import Body
from pinograsp.objects.mesh import Mesh
from pinograsp.spatial import Array, BoolArray, IntArray

CORNERS = 4  # of an area, at most
_AT_ONCE = 16  # postures of a thread
LEAN = 0.03  # [rad] of faces that are to touch as areas: jaws turn what they squeeze by more
DOWN = read_only(np.array([0.0, 0.0, -9.81]))  # [m/s^2]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BulkContacts:
    """Where a hand touches an object at N postures: t touches in all, a link each.

    Attributes:
        grasp: to which posture each touch belongs (t,), ascending.
        part: the hand's part (t,), an index into ``BulkScene.parts``.
        gap: distance from the surface (t,) [m], negative inside.
        points_o: on the object's surface (t, 3), world [m].
        normals_o: inward unit normals (t, 3).
        corners_o: of the areas that touch (t, 4, 3) [m]; the first ``counts`` count.
        counts: corners of each area (t,), 1 where it is a point.
        leaning: by how much each corner is farther off than the nearest (t, 4) [m], where faces lean.
        jacobians_o: of the touching points of the links (t, 6, n), world axes, linear first; the palm's are zero.
        depth: of the deepest link that is farther inside than the tolerance (N,) [m]; 0: none.
        failed: whether some link found no way out of the object (N,): a degenerate mesh.
        collision: links of the hand that overlap, an index into ``BulkScene.collisions.pairs`` (N,); -1: none.
        gravity_torques: that hold the hand's own weight (N, n) [N m].
    """

    grasp: IntArray
    part: IntArray
    gap: Array
    points_o: Array
    normals_o: Array
    corners_o: Array
    counts: IntArray
    leaning: Array
    jacobians_o: Array
    depth: Array
    failed: BoolArray
    collision: IntArray
    gravity_torques: Array

    __repr__ = brief("points_o", "gap", "depth")


class BulkScene:
    """A hand and an object, prepared once for any number of postures.

    The object is that of its convex parts (:attr:`Mesh.convex_parts <pinograsp.objects.Mesh.convex_parts>`) where these
    tell what is near, and itself where distances and normals are measured. With ``surface`` an object that is not
    convex is its surface alone, which needs no parts; links touch it at points then, not with areas.

    Raises:
        ExtraMissing: the compiled core is not installed, or the object is not convex and coacd (extra ``mesh``) is not.
        InvalidInput: a hand without geometry, or a kind of geometry that the core does not know.
    """

    def __init__(self, hand: HandModel, body: Body, *, surface: bool = False):
        check_geometry(hand)
        self.hand, self.body = hand, instance_of("body", body, Body)
        self.parts: list[HandPart] = parts_of(hand)
        keys = [(part.joint, part.link) for part in self.parts]
        links = list(dict.fromkeys(keys))
        self.links = [name for _, name in links]
        self.link_of = np.array([links.index(key) for key in keys], dtype=np.int64)
        # 0: the palm, then the fingers; -1: links of no finger, which are no contacts.
        names = [PALM, *(finger.name for finger in hand.fingers)]
        self.fingers = np.array([names.index(part.finger) if part.finger else -1 for part in self.parts])
        self.collisions = SelfCollisions(hand)
        try:
            self.compiled = self._compile(surface)
        except InvalidInput:
            raise
        except ValueError as error:  # of the core
            raise InvalidInput(f"hand, object: expected solids and meshes with volume, got others ({error})") from error

    def contacts(
        self,
        q: Array,
        roots: Array,
        *,
        tolerance: float,
        lean: float = LEAN,
        gravity_o: Array = DOWN,
        threads: int | None = 1,
    ) -> BulkContacts:
        """The touches of postures (N, n), the hand's root at ``roots`` (N, 4, 4) in the world.

        Args:
            q: postures [rad or m].
            roots: oMh of each.
            tolerance: distance from the surface [m] up to which a link touches, outside or inside.
            lean: of faces that are to touch as areas [rad].
            gravity_o: gravity (3,) [m/s^2].
            threads: of the compiled core; None: one for each core.
        """
        q, roots, n = np.ascontiguousarray(q), np.ascontiguousarray(roots), self.hand.n

        def touch(start: int) -> Any:
            some = slice(start, start + _AT_ONCE)
            return self.compiled.touch(q[some], roots[some], tolerance=tolerance, lean=lean, gravity=gravity_o)

        starts = range(0, max(len(q), 1), _AT_ONCE)
        found = share_out(touch, starts, threads)

        def join(name: str, *shape: int) -> Any:
            return np.concatenate([getattr(one, name) for one in found]).reshape(shape)

        grasp = np.concatenate([start + one.grasp for start, one in zip(starts, found)])
        t = len(grasp)
        return BulkContacts(
            grasp=grasp,
            part=join("part", t),
            gap=join("gap", t),
            points_o=join("points", t, 3),
            normals_o=join("normals", t, 3),
            corners_o=join("corners", t, CORNERS, 3),
            counts=join("counts", t),
            leaning=join("leaning", t, CORNERS),
            jacobians_o=join("jacobians", t, 6, n),
            depth=join("depth", len(q)),
            failed=join("failed", len(q)).astype(bool),
            collision=join("collision", len(q)),
            gravity_torques=join("gravity", len(q), n),
        )

    def placed_parts(self, q: Array, roots: Array) -> Array:
        """Placements oMp (N, p, 4, 4) of the hand's parts at postures (N, n), the root at ``roots`` (N, 4, 4)."""
        placed = np.zeros((len(q), len(self.parts), 4, 4))
        self.compiled.place(np.ascontiguousarray(q), np.ascontiguousarray(roots), placed)
        return placed

    def gaps(self, q: Array, roots: Array, parts: IntArray, reach: float) -> Array:
        """Distances (N,) [m] of some of the hand's parts from the object, up to ``reach``: of convex hulls, from below.

        Arguments as for :meth:`contacts`.
        """
        found = np.zeros(len(q))
        self.compiled.gaps(np.ascontiguousarray(q), np.ascontiguousarray(roots), parts, reach, found)
        return found

    def _compile(self, surface: bool) -> Any:
        """Hand and object for the core."""
        model = self.hand.model
        compiled = core.load().Scene(self.hand.n, self.hand.pose, self.body.shape_pose)
        for joint, inertia in zip(joints_of(model), list(model.inertias)[1:]):
            compiled.add_joint(*joint, inertia.mass, inertia.mass * inertia.lever)
        for part, link in zip(self.parts, self.link_of.tolist()):
            shapes = *support_shape(part.hull), corners_of(part.geometry)
            compiled.add_part(part.joint - 1, part.placement.homogeneous, link, *shapes)
        for one, other in self.collisions.pairs.tolist():
            compiled.add_pair(one, other)
        geometry = self.body.collision_geometry
        whole = support_shape(geometry)
        if whole.points.size:
            compiled.add_solid(*whole)
        elif not isinstance(geometry, coal.BVHModelBase):
            raise InvalidInput(f"object: expected a solid or a mesh, got coal's {type(geometry).__name__}")
        else:
            whole = SupportShape(hull_points(geometry), np.zeros(3))
            for corners in _parts(self.body, surface):
                compiled.add_solid(corners, np.zeros(3))
        compiled.enclose(*whole)
        compiled.put(corners_of(geometry))
        return compiled


def _parts(body: Body, surface: bool) -> tuple[Array, ...]:
    """Corners of convex parts that together are about an object; none where its surface stands for it."""
    if not isinstance(body, Mesh) or (surface and not body.fills_hull):
        return ()
    return body.convex_parts.corners
