"""Where a hand touches an object at many postures: one acceleration structure, arrays in and arrays out."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import coal
import numpy as np
import pinocchio as pin

from pinograsp.checks import brief, instance_of, read_only
from pinograsp.contacts.clearance import PALM, Distances, HandPart, check_geometry, parts_of
from pinograsp.contacts.penetration import ICOSAHEDRON
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.contacts.support import CORNERS, common_corners, support_shape, tilt
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.objects.mesh import Mesh
from pinograsp.spatial import Array, BoolArray, IntArray, inverse_of

_OFF = 1e-3  # [m] how far the object is moved off: the direction between nearest points keeps its digits
_ROUNDS, _ALIKE = 12, 1e-3  # of finding the direction, and where it has settled [rad]
_MOST_CORNERS = 1000  # of a hull that tells what is near
_FAILED = 1e3  # [m] farther off than any object: coal failed
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
        failed: whether some distance could not be computed (N,): a degenerate mesh.
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
    tell what is near, and itself where distances and normals are measured.

    Raises:
        ExtraMissing: the object is not convex, and coacd (extra ``mesh``) is not installed.
        InvalidInput: a hand without geometry.
    """

    def __init__(self, hand: HandModel, body: Body):
        check_geometry(hand)
        self.hand, self.body = hand, instance_of("body", body, Body)
        self.parts: list[HandPart] = parts_of(hand)
        self.model, self.data = hand.model, hand.model.createData()
        self.distances = Distances(hand, body)
        self.solids = _solids(body)
        self.whole = len(self.solids) == 1 and self.solids[0] is body.collision_geometry
        self._bounds = _bounds(self.solids)
        self._shapes = [support_shape(part.hull) for part in self.parts]
        self._solid_shapes = [support_shape(solid) for solid in self.solids]
        self._spheres = _spheres(self.parts)
        self.joints = np.array([part.joint for part in self.parts], dtype=np.int64)
        self.placements = np.array([part.placement.homogeneous for part in self.parts])
        keys = [(part.joint, part.link) for part in self.parts]
        links = list(dict.fromkeys(keys))
        self.links = [name for _, name in links]
        self.link_of = np.array([links.index(key) for key in keys], dtype=np.int64)
        # 0: the palm, then the fingers; -1: links of no finger, which are no contacts.
        names = [PALM, *(finger.name for finger in hand.fingers)]
        self.fingers = np.array([names.index(part.finger) if part.finger else -1 for part in self.parts])
        self.collisions = SelfCollisions(hand)

    def contacts(
        self, q: Array, roots: Array, *, tolerance: float, lean: float = LEAN, gravity_o: Array = DOWN
    ) -> BulkContacts:
        """The touches of postures (N, n), the hand's root at ``roots`` (N, 4, 4) in the world.

        Args:
            q: postures [rad or m].
            roots: oMh of each.
            tolerance: distance from the surface [m] up to which a link touches, outside or inside.
            lean: of faces that are to touch as areas [rad].
            gravity_o: gravity (3,) [m/s^2].
        """
        # The hand stays where it is, and the object is seen from there.
        there = self.hand.pose @ inverse_of(roots)
        objects = there @ self.body.shape_pose
        oMi = self._kinematics(q)
        placed = oMi[:, self.joints] @ self.placements
        touching = self._find_touching(q, placed, objects, tolerance)
        grasp, part = touching.grasp, touching.part
        back = roots @ inverse_of(self.hand.pose[None])
        turn = back[grasp, :3, :3]
        points = _turn(turn, touching.points) + back[grasp, :3, 3]
        normals = _turn(turn, touching.normals)
        shallow = touching.gap >= -tolerance
        depth = np.zeros(len(q))
        np.maximum.at(depth, grasp[~shallow], -touching.gap[~shallow])
        corners, counts, leaning = self._corners(touching, placed, objects, lean)
        corners = np.einsum("tij,taj->tai", turn, corners) + back[grasp, None, :3, 3]
        jacobians = np.einsum("tij,tbjn->tbin", turn, touching.jacobians.reshape(len(grasp), 2, 3, self.hand.n))
        jacobians = jacobians.reshape(len(grasp), 6, self.hand.n)
        return BulkContacts(
            grasp=grasp[shallow],
            part=part[shallow],
            gap=touching.gap[shallow],
            points_o=points[shallow],
            normals_o=normals[shallow],
            corners_o=corners[shallow],
            counts=counts[shallow],
            leaning=leaning[shallow],
            jacobians_o=jacobians[shallow],
            depth=depth,
            failed=touching.failed,
            collision=self.collisions.first(oMi),
            gravity_torques=self._gravity(q, there, gravity_o),
        )

    def placed_parts(self, q: Array, roots: Array) -> Array:
        """Placements oMp (N, p, 4, 4) of the hand's parts at postures (N, n), the root at ``roots`` (N, 4, 4)."""
        own = self._kinematics(q)[:, self.joints] @ self.placements
        placed: Array = (roots @ inverse_of(self.hand.pose[None]))[:, None] @ own
        return placed

    def gaps(self, q: Array, roots: Array, parts: IntArray, reach: float) -> Array:
        """Distances (N,) [m] of some of the hand's parts from the object, up to ``reach``: of convex hulls, from below.

        Arguments as for :meth:`contacts`.
        """
        objects = self.hand.pose @ inverse_of(roots) @ self.body.shape_pose
        placed = self._kinematics(q)[:, self.joints] @ self.placements
        found = np.full(len(q), reach)
        request, result = self.distances.request, self.distances.result
        near = self._near(placed, objects, reach)
        wanted = np.lexsort((near[3], near[0]))  # nearest first: most need not be looked at
        wanted = wanted[np.isin(near[1][wanted], parts)]
        for i, part, solid, least in zip(*(one[wanted].tolist() for one in near)):
            if least >= found[i]:
                continue
            pose = coal.Transform3s(placed[i, part, :3, :3], placed[i, part, :3, 3])
            here = coal.Transform3s(objects[i, :3, :3], objects[i, :3, 3])
            result.clear()
            gap = coal.distance(self.parts[part].hull, pose, self.solids[solid], here, request, result)
            found[i] = min(found[i], gap)
        return found

    def _kinematics(self, q: Array) -> Array:
        """Placements (N, joints, 4, 4) of the joints."""
        found = np.empty((len(q), self.model.njoints, 4, 4))
        for i, posture in enumerate(q):
            pin.forwardKinematics(self.model, self.data, posture)
            for j, pose in enumerate(self.data.oMi):
                found[i, j] = pose.homogeneous
        return found

    def _gravity(self, q: Array, there: Array, gravity_o: Array) -> Array:
        """Torques (N, n) that hold the hand itself, gravity as it acts on each."""
        seen = _turn(there[:, :3, :3], np.broadcast_to(gravity_o, (len(q), 3)))
        model, before = self.model, np.array(self.model.gravity.linear)
        found = np.empty(q.shape)
        try:
            for i, (posture, gravity) in enumerate(zip(q, seen)):
                model.gravity.linear = gravity
                found[i] = pin.computeGeneralizedGravity(model, self.data, posture)
        finally:
            model.gravity.linear = before
        return found

    def _near(self, placed: Array, objects: Array, reach: float) -> tuple[IntArray, IntArray, IntArray, Array]:
        """Grasp, part of the hand and of the object of all pairs whose bounding volumes are nearer than that.

        Last, how near they are at least [m].
        """
        low, high, centres, radii = self._bounds
        own, own_radii, halves = self._spheres
        seen = inverse_of(objects)[:, None] @ placed  # hand's parts in the object's frame
        middle = seen[..., :3, :3] @ own[None, :, :, None]
        middle = middle[..., 0] + seen[..., :3, 3]
        outside = np.maximum(np.maximum(low - middle[:, :, None], middle[:, :, None] - high), 0.0)
        squared = np.einsum("gpsx,gpsx->gps", outside, outside)
        grasp, part, solid = np.nonzero(squared <= (own_radii[:, None] + reach) ** 2)
        local = np.einsum("pji,pj->pi", seen[grasp, part, :3, :3], centres[solid] - middle[grasp, part])
        outside = np.maximum(np.abs(local) - halves[part], 0.0)
        near = np.einsum("px,px->p", outside, outside) <= (radii[solid] + reach) ** 2
        grasp, part, solid = grasp[near], part[near], solid[near]
        return grasp, part, solid, np.sqrt(squared[grasp, part, solid]) - own_radii[part]

    def _find_touching(self, q: Array, placed: Array, objects: Array, tolerance: float) -> _Touching:
        """The nearest part of each link, where it is within the tolerance or deeper, in the hand's own world."""
        grasps, parts, solids, _ = self._near(placed, objects, tolerance)
        rows: list[_Row] = []
        failed = np.zeros(len(q), dtype=bool)
        at = np.searchsorted(grasps, np.arange(len(q) + 1)).tolist()
        part_list, solid_list, links = parts.tolist(), solids.tolist(), self.link_of.tolist()
        for i in range(len(q)):
            if at[i] == at[i + 1]:
                continue
            here = coal.Transform3s(objects[i, :3, :3], objects[i, :3, 3])
            best: dict[int, tuple[float, int, int, coal.Transform3s]] = {}
            part, pose = -1, coal.Transform3s()
            for j in range(at[i], at[i + 1]):
                if part_list[j] != part:
                    part = part_list[j]
                    pose = coal.Transform3s(placed[i, part, :3, :3], placed[i, part, :3, 3])
                gap = self._gap(part, pose, solid_list[j], here)
                link = links[part]
                if gap <= tolerance and (link not in best or gap < best[link][0]):
                    best[link] = gap, part, solid_list[j], pose
            if best:
                pin.computeJointJacobians(self.model, self.data, q[i])
            for _, part, solid, pose in best.values():
                found = self._measure(part, pose, solid, here)
                if found is None:
                    failed[i] = True
                elif found[0] <= tolerance:
                    rows.append((i, part, solid, *found, *self._jacobian(part)))
        return _Touching(rows, failed, self.hand.n)

    def _gap(self, part: int, pose: coal.Transform3s, solid: int, here: coal.Transform3s) -> float:
        return self.distances.measure(self.parts[part].hull, pose, self.solids[solid], here)

    def _measure(
        self, part: int, pose: coal.Transform3s, solid: int, here: coal.Transform3s
    ) -> tuple[float, Array, Array] | None:
        """Gap [m], the point on the object's surface (3,), and the inward normal (3,): its own, not its parts'.

        Inside, the object is moved off until it is clear (:meth:`_way_out`), along the normal of its convex part, or,
        where that leads along a wall, in the direction that is shortest. None where coal finds no way out.
        """
        result, hand_part = self.distances.result, self.parts[part]
        gap = self._gap(part, pose, solid, here)
        mine, other = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
        apart = other - mine
        size = float(np.abs(apart).max())
        if gap > _OFF / 10 and size < 2 * gap:  # coal's points of an overlap are often none
            size = float(np.linalg.norm(apart))
            normal = apart / size
            if self.whole:
                return size, other, normal
        else:
            normal = np.array(result.normal)
        found = self._way_out(hand_part, pose, here, normal, _OFF - gap)
        if found is None:
            ways = [self._way_out(hand_part, pose, here, start, _OFF - gap) for start in ICOSAHEDRON]
            found = max((way for way in ways if way is not None), key=lambda way: way[0], default=None)
        return found

    def _way_out(
        self, part: HandPart, pose: coal.Transform3s, here: coal.Transform3s, normal: Array, off: float
    ) -> tuple[float, Array, Array] | None:
        """As :meth:`_measure`, along the common normal to which that one (3,) leads, moved ``off`` [m] at first.

        Where the object is clear of the part, their nearest points tell the next normal. None: it leads to none.
        """
        result, found = self.distances.result, None
        for _ in range(_ROUNDS):
            moved = coal.Transform3s(here.getRotation(), here.getTranslation() + off * normal)
            result.clear()
            gap = coal.distance(part.geometry, pose, self.distances.shape, moved, self.distances.plain, result)
            if not -_FAILED < gap < _FAILED:
                return None
            if gap < _OFF / 10:  # deeper than thought
                off += _OFF + max(-gap, 0.0)
                continue
            mine, other = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            direction = (other - mine) / gap
            surface = other - off * normal
            turned = float(direction @ normal)
            found = float((surface - mine) @ direction), surface, direction
            if turned > 1 - _ALIKE**2 / 2:
                break
            off, normal = max(off - gap + _OFF, _OFF), direction
        return found

    def _jacobian(self, part: int) -> tuple[Array, Array]:
        """Jacobian (6, n) of the origin of a part's joint, and where that is (3,)."""
        joint = self.parts[part].joint
        if not joint:
            return np.zeros((6, self.hand.n)), np.zeros(3)
        J = pin.getJointJacobian(self.model, self.data, joint, pin.LOCAL_WORLD_ALIGNED).reshape(6, -1)
        return J, np.array(self.data.oMi[joint].translation)

    def _corners(
        self, touching: _Touching, placed: Array, objects: Array, lean: float
    ) -> tuple[Array, IntArray, Array]:
        """Corners (t, 4, 3) of the areas that touch, their counts (t,) and leanings (t, 4), in the hand's own world."""
        count = len(touching.grasp)
        directions = tilt(touching.normals, lean)
        mirrored = (
            directions
            - 2 * touching.normals[:, None] * np.einsum("tax,tx->ta", directions, touching.normals)[..., None]
        )
        mine = np.repeat(touching.points[:, None], directions.shape[1], axis=1)
        other = mine.copy()
        for shapes, which, poses, found, along in (
            (self._shapes, touching.part, placed[touching.grasp, touching.part], mine, directions),
            (self._solid_shapes, touching.solid, objects[touching.grasp], other, mirrored),
        ):
            local = np.einsum("tji,taj->tai", poses[:, :3, :3], along)
            for i in np.unique(which) if count else ():
                shape, own = shapes[i], which == i
                if shape is not None:
                    pose = poses[own]
                    found[own] = np.einsum("tij,taj->tai", pose[:, :3, :3], shape.support(local[own]))
                    found[own] += pose[:, None, :3, 3]
        if not count:
            return np.zeros((0, CORNERS, 3)), np.zeros(0, dtype=np.int64), np.zeros((0, CORNERS))
        return common_corners(mine, other, touching.points, touching.normals)


# Posture, part of the hand and of the object, gap, point and normal; Jacobian of the joint's origin, and its place.
_Row: TypeAlias = tuple[int, int, int, float, Array, Array, Array, Array]


class _Touching:
    """Touches in the hand's own world, as arrays."""

    def __init__(self, rows: list[_Row], failed: BoolArray, n: int):
        t = len(rows)
        self.failed = failed
        self.grasp, self.part, self.solid = (
            np.array([row[i] for row in rows], dtype=np.int64).reshape(t) for i in range(3)
        )
        self.gap = np.array([row[3] for row in rows]).reshape(t)
        self.points, self.normals = (np.array([row[i] for row in rows]).reshape(t, 3) for i in (4, 5))
        self.jacobians = np.array([row[6] for row in rows]).reshape(t, 6, n)
        arms = self.points - np.array([row[7] for row in rows]).reshape(t, 3)
        self.jacobians[:, :3] += np.cross(self.jacobians[:, 3:], arms[:, :, None], axis=1)


def _solids(body: Body) -> list[coal.CollisionGeometry]:
    """Convex geometry in the shape's own frame that together is about the object."""
    if not isinstance(body, Mesh) or body.convex:
        return [body.collision_geometry]
    return [_hull(corners) for corners in body.convex_parts.corners]


def _hull(corners: Array) -> coal.ConvexBase:
    """The convex hull of points (n, 3); of very many, that of those farthest in a thousand directions."""
    if len(corners) > _MOST_CORNERS:
        turns = np.pi * (3 - np.sqrt(5)) * np.arange(_MOST_CORNERS)
        height = 1 - (2 * np.arange(_MOST_CORNERS) + 1) / _MOST_CORNERS
        flat = np.sqrt(1 - height**2)
        spiral = np.column_stack([flat * np.cos(turns), flat * np.sin(turns), height])
        corners = corners[np.unique(np.argmax(spiral @ corners.T, axis=1))]
    points = coal.StdVec_Vec3s()
    for corner in corners:
        points.append(np.array(corner))
    return coal.Convex.convexHull(points, True, "Qt")


def _bounds(solids: list[coal.CollisionGeometry]) -> tuple[Array, Array, Array, Array]:
    """Lower and upper corners (s, 3) of boxes, centres (s, 3) and radii (s,) of spheres around solids [m]."""
    for solid in solids:
        solid.computeLocalAABB()
    low = np.array([solid.aabb_local.min_ for solid in solids]).reshape(-1, 3)
    high = np.array([solid.aabb_local.max_ for solid in solids]).reshape(-1, 3)
    return low, high, (low + high) / 2, np.array([solid.aabb_radius for solid in solids])


def _spheres(parts: list[HandPart]) -> tuple[Array, Array, Array]:
    """Centres (p, 3) and radii (p,) of spheres around parts, and halves (p, 3) of the boxes around the same centres."""
    low, high, centres, radii = _bounds([part.hull for part in parts])
    return centres, radii, (high - low) / 2


def _turn(rotations: Array, vectors: Array) -> Array:
    """Vectors (t, 3) turned by rotations (t, 3, 3)."""
    found: Array = np.einsum("tij,tj->ti", rotations, vectors)
    return found
