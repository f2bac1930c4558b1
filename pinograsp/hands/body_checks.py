"""Masses and inertias of moving links that no body of their size has, as descriptions hold them for want of better."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

import coal
import numpy as np
import pinocchio as pin

from pinograsp.hands.geometry import DENSITY, PRIMITIVES, Shape, hull_points, read_mesh, solid
from pinograsp.spatial import Array, moments_problem
from pinograsp.words import few, printable

# Of mass times the square of the farthest point's distance from the centre of mass, which bounds the moments of inertia
# of what lies within. Identified and rounded values of real robots go up to 9.4 times, since shapes are not all of a
# link; placeholders start at 12 (2,000 links of 170 robots).
_LARGEST, _LEAST = 10.0, 1e-4
_AIR, _STEEL, _OSMIUM = 1.2, 7.9e3, 23e3  # [kg/m^3]; no link of those robots weighs less than 28
_BALL = 4 / 3 * np.pi  # volume of a ball of radius 1
_SMALLEST = 0.02  # [m] that a link reaches at least: some have a mark for a shape
_MOST_NAMED = 8
_TOO_HEAVY = "masses too large for links of that size: are they in grams? URDF's are in kg"


def mend_bodies(
    model: pin.Model, shapes: pin.GeometryModel, visuals: Sequence[Shape], weigh: bool, notes: list[str]
) -> None:
    """Replace masses and inertias of ``model`` that cannot be by those of the links' shapes; noted.

    Inertias that only have one moment above the sum of the others stay, noted.

    Args:
        shapes: collision shapes at the model's joints.
        visuals: what is seen of the links; read where collision shapes alone make a link too small for its inertia.
        weigh: whether a mass that is next to nothing, or above that of any metal, may be taken from shapes.
    """
    bodies = [_Body(model, shapes, joint) for joint in range(1, model.njoints)]
    whole = max((body.reach for body in bodies), default=0.0)  # bounds links of which nothing is known
    for body in bodies:
        if body.too_heavy(whole):
            body.see(visuals)
    wrong = any(body.too_heavy(whole) for body in bodies)
    light, heavy, weighed, placeholders, crooked = [], [], [], [], []
    for body in bodies:
        mass, moment = body.inertia.mass, body.moments[2]
        own = body.solid if mass < _AIR * body.room and (mass > 0 or weigh) else None
        if own is not None and mass < _AIR * own.mass / DENSITY:
            light.append(f"{body.link} ({mass:.3g} kg)")
            if weigh:
                model.inertias[body.joint] = own
                continue
        if body.too_wide(whole):
            body.see(visuals)
        own = body.solid if wrong else None
        # Where one of the masses cannot be, the others are not trusted with more than steel's.
        if body.too_heavy(whole) or (own is not None and mass > _STEEL / DENSITY * own.mass):
            told = f"{body.link} ({mass:.3g} kg within {1e3 * body.within(whole):.3g} mm)"
            if weigh and own is not None:
                weighed.append(told)
                model.inertias[body.joint] = own
                continue
            heavy.append(told)
        if body.too_wide(whole) or (mass > 0 and body.known and moment < _LEAST * mass * body.reach**2):
            placeholders.append(f"{body.link} ({moment:.3g} kg m^2 for {1e3 * mass:.3g} g)")
            model.inertias[body.joint] = _scale(body.solid or _ball(mass), body.inertia)
        elif body.moments[0] > 0 and moments_problem(body.moments, np.inf):
            crooked.append(body.link)
    for names, text in (
        (light, f"masses next to nothing{f', taken from the shapes at {DENSITY:g} kg/m^3' if weigh else ''}"),
        (heavy, _TOO_HEAVY),
        (weighed, f"{_TOO_HEAVY}; taken from the shapes at {DENSITY:g} kg/m^3 instead"),
        (
            placeholders,
            "inertias that links of that mass and size cannot have, taken from the shapes instead (an inertia of "
            "motors belongs in <dynamics armature=>)",
        ),
        (crooked, "inertias with one moment above the sum of the others, which no solid has, used as they are"),
    ):
        if names:
            notes.append(f"{text}: {few(names, _MOST_NAMED)}")


class _Body:
    """What a joint moves up to the next joints: its inertia, its shapes, how far it reaches from its centre of mass.

    Attributes:
        link: the one at the joint.
        inertia: in the joint's frame.
        moments: of inertia about the centre of mass (3,), ascending [kg m^2].
        reach: how far joints and known shapes are from the centre of mass [m].
        known: whether any of its shapes is.
    """

    def __init__(self, model: pin.Model, shapes: pin.GeometryModel, joint: int):
        self.model, self.joint = model, joint
        self.inertia: pin.Inertia = pin.Inertia(model.inertias[joint])
        self.moments: Array = np.asarray(np.linalg.eigvalsh(self.inertia.inertia), dtype=float)
        frames = [frame for frame in model.frames if frame.parentJoint == joint]
        links = [frame.name for frame in frames if frame.type == pin.FrameType.BODY]
        self.link = printable((*links, model.names[joint])[0], 60)
        self.shapes = [one for one in shapes.geometryObjects if one.parentJoint == joint]
        self.known = bool(self.shapes)
        self.reach = 0.0
        below = [model.jointPlacements[j].translation for j in range(1, model.njoints) if model.parents[j] == joint]
        self._extend(np.array([*(frame.placement.translation for frame in frames), *below]), pin.SE3.Identity())
        for one in self.shapes:
            self._extend(_points(one.geometry), one.placement)

    def _extend(self, points: Array, placement: pin.SE3) -> None:
        placed = points @ placement.rotation.T + placement.translation
        self.reach = max(self.reach, float(np.linalg.norm(placed - self.inertia.lever, axis=1).max()))

    @property
    def solid(self) -> pin.Inertia | None:
        """Mass and inertia of the shapes, at the density that links without mass have; None without any."""
        total = pin.Inertia.Zero()
        for one in self.shapes:
            if (part := solid(one.geometry, DENSITY)) is not None:
                total = total + one.placement.act(part)
        return total if total.mass > 0 else None

    def within(self, whole: float) -> float:
        """Radius [m] that holds all of it; ``whole``: of the hand's largest link, where no shape of it is known."""
        return self.reach if self.known else max(self.reach, whole)

    def too_wide(self, whole: float) -> bool:
        """Whether its mass would have to be farther out; where nothing has a size, nobody can tell."""
        radius = self.within(whole)
        return radius > 0 and bool(self.moments[2] > _LARGEST * self.inertia.mass * radius**2)

    def too_heavy(self, whole: float) -> bool:
        """Whether no metal is that heavy."""
        return bool(self.inertia.mass > _OSMIUM * _BALL * max(self.within(whole), _SMALLEST) ** 3)

    @property
    def room(self) -> float:
        """Volume that its shapes do not exceed, however many they are: each lies within its reach [m^3]."""
        return len(self.shapes) * _BALL * self.reach**3

    def see(self, visuals: Iterable[Shape]) -> None:
        """Let it reach as far as what is seen of it."""
        for shape in visuals:
            frame = self.model.frames[self.model.getFrameId(shape.link, pin.FrameType.BODY)]
            if frame.parentJoint != self.joint:
                continue
            mesh = shape.kind == "mesh"
            try:
                form = read_mesh(shape.path, shape.size) if mesh else PRIMITIVES[shape.kind](*shape.size)
            except (ValueError, OSError):
                continue
            self.known = True
            self._extend(_points(form), frame.placement * shape.placement)


def _points(shape: coal.CollisionGeometry) -> Array:
    """Points (p, 3) that reach as far as a shape does."""
    points: Array = np.array(shape.vertices()) if isinstance(shape, coal.BVHModelBase) else hull_points(shape)
    return points


def _scale(shape: pin.Inertia, given: pin.Inertia) -> pin.Inertia:
    """The mass and centre of mass that are given, with the inertia that a shape has about its own."""
    return pin.Inertia(given.mass, given.lever, given.mass / shape.mass * shape.inertia)


def _ball(mass: float) -> pin.Inertia:
    """A ball of that mass [kg], as dense as links without mass."""
    mass = max(mass, np.finfo(float).tiny)
    radius = float(np.cbrt(3 * mass / (4 * np.pi * DENSITY)))
    return pin.Inertia.FromSphere(mass, radius)
