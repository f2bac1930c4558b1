"""Where the hand is in the object: depths and normals of overlapping convex geometry, by coal's distances."""

from __future__ import annotations

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from pinograsp.referee.geometry import convex, convex_object

_CLEAR = 1e-3  # [m] how far the object is moved off: the direction between nearest points keeps its digits
_NEAR = 2e-4  # [m] parts farther off are looked at again when they may have come closer
_ALIKE = 3e-5  # [rad] normals this close are the same: the depth is off by their square
_ROUNDS = 20
_JUMP = 1e-3  # [m] what has moved so far between two looks was put there: its last normal says nothing
_FARTHEST = 1.0  # [m] of a sliding joint without limits
_FLUSH = 2e-6  # [m] corners of a hull this near to the plane of a face belong to it
_ABREAST = 2e-4  # [m] edges that cross count as touching where they are nearer than this
_CORNERS = 8  # of a common area at most
_MOST = 0.995  # of the depth: an area that is nowhere as deep lacks the deepest point


class _Part:
    """One convex geometry of the hand, and what is known of it from the last look: normal, and how far to move off."""

    def __init__(self, joint: int, placement: pin.SE3, shape):
        self.joint, self.placement, self.shape = joint, placement, shape
        shape.computeLocalAABB()
        self.centre, self.radius = np.array(shape.aabb_center), float(shape.aabb_radius)
        self.footprint = _Footprint(shape)
        self.normal, self.off = None, 2 * _CLEAR


class _Footprint:
    """The flat face or straight edge of a convex geometry that faces a direction."""

    def __init__(self, shape):
        self.shape, self.faces, self.points = shape, {}, None
        if isinstance(shape, coal.Box):
            self.points = np.array(np.meshgrid(*[[-1.0, 1.0]] * 3)).reshape(3, 8).T * np.array(shape.halfSide).ravel()
        elif isinstance(shape, coal.ConvexBase):
            self.points = np.array(shape.points())
        if self.points is not None:
            self.planes = ConvexHull(self.points, qhull_options="Qt").equations

    def towards(self, direction: np.ndarray, rotation: np.ndarray, position: np.ndarray):
        """Corners of a face (k, 3) and its normal (3,), or ends (2, 3) and radius [m] of an edge; None: it is round."""
        d, shape = direction @ rotation, self.shape
        if self.points is not None:
            local, other = self._face(d)
        elif isinstance(shape, coal.Cylinder) and abs(d[2]) > np.sqrt(0.5):
            turn = np.arange(2 * _CORNERS) * np.pi / _CORNERS
            up = np.sign(d[2])
            rim = [shape.radius * np.cos(turn), shape.radius * np.sin(turn), np.full(turn.size, up * shape.halfLength)]
            local, other = np.array(rim).T, np.array([0.0, 0.0, up])
        elif isinstance(shape, coal.Cylinder | coal.Capsule) and abs(d[2]) < 0.9:
            out = d if isinstance(shape, coal.Capsule) else np.array([d[0], d[1], 0.0]) / np.hypot(d[0], d[1])
            ends = shape.halfLength * np.array([[0.0, 0.0, -1.0], [0.0, 0.0, 1.0]])
            local, other = shape.radius * out + ends, shape.radius
        else:
            return None
        return local @ rotation.T + position, rotation @ other if np.ndim(other) else other

    def _face(self, d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        i = int((self.planes[:, :3] @ d).argmax())
        if i not in self.faces:
            plane = self.planes[i]
            corners = self.points[np.abs(self.points @ plane[:3] + plane[3]) < _FLUSH]
            x, y = _across(plane[:3])
            across = (corners - corners.mean(axis=0)) @ np.column_stack([x, y])
            self.faces[i] = corners[np.arctan2(across[:, 1], across[:, 0]).argsort()], plane[:3].copy()
        return self.faces[i]


def _common_area(own, other, point: np.ndarray, normal: np.ndarray, depth: float):
    """Points (3,) of the object where faces or edges of hand and object lie on each other, with depths.

    ``point`` is the deepest, and one of them where the others are not as deep.
    """
    x, y = _across(normal)
    axes = np.column_stack([x, y, normal])
    mine, theirs = (_Flat((corners - point) @ axes, of @ axes if np.ndim(of) else of) for corners, of in (own, other))
    if mine.edge and theirs.edge:
        area = _abreast(mine.corners, theirs.corners)
    elif theirs.edge:
        area = _clip(theirs.corners, mine.corners)
    else:
        area = _clip(mine.corners, theirs.corners)
    found = []
    if area:
        area = np.array(area)
        if len(area) > _CORNERS:  # those farthest out
            turn = (np.arange(_CORNERS) + 0.5) * 2 * np.pi / _CORNERS
            area = area[np.unique((area @ np.array([np.cos(turn), np.sin(turn)])).argmax(axis=0))]
        surface = theirs.height(area, bool(mine.edge))
        depths = mine.height(area) - surface
        found = [(point + axes @ [*at, z], float(deep)) for at, z, deep in zip(area, surface, depths) if deep > 0]
    if max((deep for _, deep in found), default=0.0) < _MOST * depth:
        found.append((point, depth))
    return found


class _Flat:
    """A face or an edge as heights over a plane."""

    def __init__(self, corners: np.ndarray, of):
        self.corners, self.z = corners[:, :2].tolist(), corners[:, 2]
        self.edge = len(corners) == 2
        self.at, self.of = corners[0], of

    def height(self, points: np.ndarray, beside: bool = False) -> np.ndarray:
        """Over points (k, 2); ``beside`` an edge its surface falls away."""
        out = points - self.at[:2]
        if not self.edge:
            return self.at[2] - out @ self.of[:2] / self.of[2]
        along = np.subtract(*self.corners[::-1])
        length = float(along @ along)
        height = self.at[2] + (out @ along) / length * (self.z[1] - self.z[0])
        return height + (out @ [-along[1], along[0]]) ** 2 / length / (2 * self.of) if beside else height


def _across(n: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two directions across a unit normal (3,), right-handed with it (Duff et al. 2017)."""
    sign = 1.0 if n[2] >= 0 else -1.0
    a = -1.0 / (sign + n[2])
    b = n[0] * n[1] * a
    return np.array([1 + sign * n[0] ** 2 * a, sign * b, -sign * n[0]]), np.array([b, sign + n[1] ** 2 * a, -n[1]])


def _clip(corners: list, by: list) -> list:
    """A polygon or an edge (2-d corners) within a convex polygon (Sutherland and Hodgman)."""
    if sum(a[0] * b[1] - a[1] * b[0] for a, b in zip(by, by[1:] + by[:1])) < 0:
        by = by[::-1]
    for a, b in zip(by, by[1:] + by[:1]):
        ex, ey = b[0] - a[0], b[1] - a[1]
        sides = [ex * (p[1] - a[1]) - ey * (p[0] - a[0]) for p in corners]
        if min(sides, default=0.0) >= 0:
            continue
        left = []
        for k, (p, s) in enumerate(zip(corners, sides)):
            if s >= 0:
                left.append(p)
            if len(corners) == 2 and k == 1:
                break  # an edge does not close
            q, t = corners[(k + 1) % len(corners)], sides[(k + 1) % len(corners)]
            if s * t < 0:
                r = s / (s - t)
                left.append([p[0] + r * (q[0] - p[0]), p[1] + r * (q[1] - p[1])])
        corners = left
    return corners


def _abreast(edge: list, other: list) -> list:
    """The part of an edge that lies on another edge: its ends."""
    start, e, f = np.array(edge[0]), np.subtract(*edge[::-1]), np.subtract(*other[::-1])
    out, length = start - other[0], float(np.hypot(*f))
    low, high = 0.0, 1.0
    # Along the other, and to its side, both linear in the place on the edge.
    for direction, least, most in ((f / length, 0.0, length), (np.array([-f[1], f[0]]) / length, -_ABREAST, _ABREAST)):
        at, slope = float(out @ direction), float(e @ direction)
        if abs(slope) < 1e-12:
            if not least <= at <= most:
                return []
            continue
        ends = sorted(((least - at) / slope, (most - at) / slope))
        low, high = max(low, ends[0]), min(high, ends[1])
    return [(start + low * e).tolist(), (start + high * e).tolist()] if low < high else []


class Collider:
    """Overlaps of the hand's geometry with the object: depths along the common normal of the surfaces.

    The depth of an overlap is not exact in coal. So the object is moved off along the normal known so far until it is
    clear by a millimetre; there the nearest points are exact, their direction is the next guess, and so on.
    """

    def __init__(self, hand, body):
        self.notes: list[str] = []
        made = [
            _Part(one.parentJoint, one.placement, shape)
            for one in hand.geometry.geometryObjects
            if (shape := convex(one.geometry, one.name, self.notes)) is not None
        ]
        self.geometry, self.hand = made, hand
        self.object = convex_object(body, self.notes)
        self.object.computeLocalAABB()
        self.centre, self.radius = np.array(self.object.aabb_center), float(self.object.aabb_radius)
        self.extent = float(np.linalg.norm(self.centre)) + self.radius
        self.footprint = _Footprint(self.object)
        self.reach = np.array([self._reach(part) for part in made]).reshape(len(made), hand.n)
        # How far each geometry is off, less what it may have moved since.
        self.slack, self.last = np.zeros(len(made)), None
        self.request, self.plain, self.result = coal.DistanceRequest(), coal.DistanceRequest(), coal.DistanceResult()
        self.request.enable_signed_distance = self.plain.enable_signed_distance = True
        self.request.gjk_tolerance, self.request.gjk_max_iterations = 1e-12, 1000

    def _reach(self, part: _Part) -> np.ndarray:
        """How far any point of a geometry can move for each unit of each actuated joint (n,)."""
        hand, model, bound = self.hand, self.hand.model, np.zeros(self.hand.n)
        far, j = float(np.linalg.norm(part.placement.act(part.centre))) + part.radius, part.joint
        while j:
            i, ratio, slides = model.joints[j].idx_v, abs(hand.ratio(j)), hand.is_prismatic(j)
            bound[i] += ratio * (1.0 if slides else far)
            if slides:
                far += ratio * min(max(abs(hand.lower[i]), abs(hand.upper[i])) + 0.01, _FARTHEST)
            far += float(np.linalg.norm(model.jointPlacements[j].translation))
            j = model.parents[j]
        return bound

    def collide(self, data, q: np.ndarray, rotation: np.ndarray, position: np.ndarray) -> list[tuple]:
        """Joint, number of the geometry, point on the object (3,), normal (3,) and depth of every overlap, the joints
        as in data.
        """
        if self.last is not None:
            q_last, R_last, p_last = self.last
            turned = rotation - R_last
            object_moved = np.linalg.norm(position - p_last) + self.extent * np.sqrt(0.5 * (turned * turned).sum())
            self.slack -= self.reach @ np.abs(q - q_last) + object_moved
        self.last = q, rotation, position
        found: list[tuple] = []
        pose = coal.Transform3s(rotation, position)
        centre = position + rotation @ self.centre
        for i in np.flatnonzero(self.slack <= 0):
            part = self.geometry[i]
            placed = data.oMi[part.joint] * part.placement
            if self.slack[i] < -_JUMP:
                part.normal, part.off = None, 2 * _CLEAR
            apart = float(np.linalg.norm(placed.act(part.centre) - centre)) - part.radius - self.radius
            if apart > _NEAR:
                self.slack[i], part.normal = apart - 0.5 * _NEAR, None
                continue
            mine = coal.Transform3s(placed.rotation, placed.translation)
            depth, normal, point = self._deepest(part, mine, pose)
            self.slack[i] = max(-depth - 0.5 * _NEAR, 0.0) if depth < -_NEAR else 0.0
            if depth > 0:
                own = part.footprint.towards(normal, placed.rotation, placed.translation)
                other = None if own is None else self.footprint.towards(-normal, rotation, position)
                points = None if other is None else _common_area(own, other, point, normal, depth)
                for at, deep in points or ((point, depth),):
                    found.append((part.joint, int(i), at, normal, deep))
        return found

    def _deepest(self, part: _Part, mine, pose) -> tuple[float, np.ndarray, np.ndarray]:
        """Depth [m], negative where clear, inward normal (3,), and the point on the object's surface (3,)."""
        normal, off, depth = part.normal, part.off, None
        if normal is None:
            gap, point, normal = self._apart(part, mine, pose)
            depth = -gap
            if gap > _NEAR:
                return depth, normal, point
        position, rotation = pose.getTranslation(), pose.getRotation()
        for _ in range(_ROUNDS):
            moved = coal.Transform3s(rotation, position + off * normal)
            gap, other, direction = self._apart(part, mine, moved)
            if gap < 0.5 * _CLEAR:  # deeper than thought
                off += _CLEAR - min(gap, 0.0)
                continue
            # The width of the overlap along this direction is exact.
            depth, point = off * float(normal @ direction) - gap, other - off * normal
            alike, spare = np.abs(direction - normal).max() < _ALIKE, gap - _CLEAR
            normal, off = direction, off - spare
            if alike and abs(spare) < 0.5 * _CLEAR:
                break
        if depth is None:  # never clear: the last normal led nowhere
            part.normal, part.off = None, 2 * _CLEAR
            return self._deepest(part, mine, pose)
        part.normal, part.off = (normal, off) if depth > -_NEAR else (None, 2 * _CLEAR)
        return depth, normal, point

    def _apart(self, part: _Part, mine, pose) -> tuple[float, np.ndarray, np.ndarray]:
        """Distance [m], the object's nearest point (3,), and the direction there from the hand's (3,)."""
        result = self.result
        for request in (self.request, self.plain):
            result.clear()
            gap = coal.distance(part.shape, mine, self.object, pose, request, result)
            own, other = np.array(result.getNearestPoint1()), np.array(result.getNearestPoint2())
            if np.isfinite(own).all() and np.isfinite(other).all():
                break
        return gap, other, (other - own) / gap if gap > 0.5 * _NEAR else np.array(result.normal)
