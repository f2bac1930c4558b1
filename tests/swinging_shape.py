"""One shape on one joint beside a free object, for tests of the simulation's engine."""

from __future__ import annotations

from types import SimpleNamespace

import coal
import numpy as np
import pinocchio as pin
from scipy.spatial import ConvexHull

from pinograsp.hands.model import HandModel
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.settings import Servo

DT = 2.5e-4


def hull(corners) -> coal.ConvexBase:
    made, shell = coal.BVHModelOBBRSS(), ConvexHull(corners)
    made.beginModel(len(shell.simplices), 3 * len(shell.simplices))
    for triangle in shell.simplices:
        made.addTriangle(*corners[triangle])
    made.endModel()
    made.buildConvexHull(True, "Qt")
    return made.convex


def pebble() -> np.ndarray:
    v = np.random.default_rng(0).normal(size=(40, 3))
    return v / np.linalg.norm(v, axis=1)[:, None] * [0.01, 0.012, 0.02]


SHAPES = {
    "ellipsoid": coal.Ellipsoid(0.01, 0.012, 0.02),
    "sphere": coal.Sphere(0.01),
    "capsule": coal.Capsule(0.01, 0.03),
    "hull": hull(pebble()),
    "box": coal.Box(0.02, 0.02, 0.03),
    "cylinder": coal.Cylinder(0.01, 0.03),
}
CENTRE = np.array([0.05, 0.0, 0.0])


def one_joint(shape) -> HandModel:
    """A shape 50 mm from the joint that swings it about the world's z axis."""
    model, geometry = pin.Model(), pin.GeometryModel()
    j = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "turn")
    model.appendBodyToJoint(j, pin.Inertia.FromSphere(0.1, 0.02), pin.SE3.Identity())
    frame = model.addBodyFrame("tip", j, pin.SE3.Identity(), 0)
    model.lowerPositionLimit, model.upperPositionLimit = np.full(1, -3.0), np.full(1, 3.0)
    geometry.addGeometryObject(pin.GeometryObject("tip_0", j, frame, pin.SE3(np.eye(3), CENTRE), shape))
    return HandModel(name="one", source="", model=model, geometry=geometry, palm="universe", fingers=(), pose=np.eye(4))


def engine(shape, body, *, dt: float = DT, gravity=(0.0, 0.0, -9.81), servo=None, friction=None) -> MujocoEngine:
    hand = one_joint(shape)
    task = SimpleNamespace(
        links=(), hand=hand, body=body, gravity_o=np.array(gravity), torque_limit=np.full(1, np.inf), carrier=""
    )
    return MujocoEngine(
        task, time_step=dt, servo=Servo.of(hand, servo), mass_factor=1.0, joint_friction=np.full(1, friction or 0.0)
    )


def pose(rotation, position) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = rotation, position
    return made


def width(shape, normal) -> float:
    """Support of a shape about its centre in a direction (3,) of its own axes: closed form."""
    if isinstance(shape, coal.Box):
        return float(np.abs(normal) @ np.array(shape.halfSide).ravel())
    if isinstance(shape, coal.ConvexBase):
        return float((np.array(shape.points()) @ normal).max())
    if isinstance(shape, coal.Sphere | coal.Ellipsoid):
        radii = shape.radius if isinstance(shape, coal.Sphere) else np.array(shape.radii).ravel()
        return float(np.linalg.norm(radii * normal))
    along = abs(normal[2]) * shape.halfLength
    return along + shape.radius * (1.0 if isinstance(shape, coal.Capsule) else float(np.hypot(normal[0], normal[1])))
