"""The engine against closed forms and conservation laws."""

from __future__ import annotations

from types import SimpleNamespace

import coal
import numpy as np
import own_hands
import pinocchio as pin
import pytest
from swinging_shape import CENTRE, SHAPES, engine, one_joint, pose, width

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.objects import Box, Cylinder, Sphere
from pinograsp.plan import ContactLaw
from pinograsp.simulation.law import NO_TOUCHES, ContactForces, Pressing
from pinograsp.simulation.mujoco_engine import MujocoEngine
from pinograsp.simulation.settings import Servo

OBJECTS = {
    "cylinder": Cylinder(radius=0.02, height=0.1, mass=0.1),
    "box": Box(size=(0.03, 0.03, 0.06), mass=0.1),
    "sphere": Sphere(radius=0.03, mass=0.1),
}
NOTHING = Pressing(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))


def overlapping(shape, thing, rng) -> tuple[np.ndarray, np.ndarray]:
    """Joint angle and pose of the object, 20 um to 0.3 mm in the shape along a random direction."""
    q, way = rng.uniform(-1, 1, 1), rng.normal(size=3)
    turn = pin.exp3(np.array([0.0, 0.0, q[0]]))
    where, R = coal.Transform3s(turn, turn @ CENTRE), pin.exp3(2 * rng.normal(size=3))
    way /= np.linalg.norm(way)
    at, request, result = turn @ CENTRE + 0.2 * way, coal.DistanceRequest(), coal.DistanceResult()
    for _ in range(60):
        result.clear()
        gap = coal.distance(shape, where, thing, coal.Transform3s(R, at), request, result)
        if gap < 1e-6:
            break
        at = at - gap * way
    return q, pose(R, at - rng.uniform(2e-5, 3e-4) * way)


def fly(made, twist, steps) -> None:
    """Steps of the object alone, moving with a twist (6,) about its frame's axes."""
    made.data.qvel[made.object_v : made.object_v + 6] = twist
    for _ in range(steps):
        made.touches()
        made.step(made.q, made.dq, np.zeros(1), NO_TOUCHES, NOTHING, np.zeros(6))


@pytest.mark.parametrize(
    "shape, body",
    [
        ("hull", "box"),
        ("hull", "cylinder"),
        ("box", "cylinder"),
        ("capsule", "cylinder"),
        ("cylinder", "box"),
        ("ellipsoid", "box"),
        ("sphere", "box"),
    ],
)
def test_depths_are_the_least_width_of_the_overlap(shape, body):
    """No direction nearby separates hand and object with less motion; the point is on the object, the velocity that of
    rigid bodies there.
    """
    rng = np.random.default_rng(2)
    thing = OBJECTS[body].collision_geometry
    made = engine(SHAPES[shape], OBJECTS[body])
    for _ in range(40):
        q, at = overlapping(SHAPES[shape], thing, rng)
        made.place(q, np.zeros(1), at)
        dq, twist = rng.normal(size=1), rng.normal(size=6)  # of the object about its own axes
        made.data.qvel[made.object_v :], made.data.qvel[made.dofs] = twist, dq
        found = made.touches()
        assert set(found.part) == {1}
        i = found.depth.argmax()
        normal, deepest = found.normal_o[i], found.depth[i]
        turn = pin.exp3(np.array([0.0, 0.0, q[0]]))

        def overlap(n, turn=turn, at=at):
            mine, other = width(SHAPES[shape], turn.T @ n), width(thing, -at[:3, :3].T @ n)
            return mine + other - (at[:3, 3] - turn @ CENTRE) @ n

        assert deepest == pytest.approx(overlap(normal), rel=6e-3, abs=1e-9)
        for aside in rng.normal(size=(20, 3)):
            near = normal + 1e-3 * aside
            assert overlap(near / np.linalg.norm(near)) > overlap(normal) - 1e-9
        # The object's outermost point against the normal, and the speed of the hand's there less the object's.
        point, spin = found.point_o[i], at[:3, :3] @ twist[3:]
        assert (at[:3, 3] - point) @ normal == pytest.approx(width(thing, -at[:3, :3].T @ normal), abs=1e-6)
        speed = np.cross([0, 0, dq[0]], point) - twist[:3] - np.cross(spin, point - at[:3, 3])
        np.testing.assert_allclose(found.velocity_o[i], speed, atol=1e-9)
        assert found.spin[i] == pytest.approx(([0, 0, dq[0]] - spin) @ normal, abs=1e-9)


def test_a_free_object_falls_as_it_should():
    made = engine(SHAPES["sphere"], OBJECTS["box"], dt=1e-3)
    start = np.array([0.0, 0.0, 1.0])
    made.place(np.zeros(1), np.zeros(1), pose(np.eye(3), start))
    energies = []
    for _ in range(500):
        fly(made, made.data.qvel[made.object_v :].copy(), 1)
        energies.append(made.potential_energy() + made.kinetic_energy())
    # Positions follow with the new velocities: g t (t + dt) / 2.
    np.testing.assert_allclose(made.object_pose[:3, 3], start - [0, 0, 9.81 * 0.5 * 0.501 / 2], atol=1e-12)
    np.testing.assert_allclose(made.object_twist, [0, 0, -9.81 * 0.5, 0, 0, 0], atol=1e-12)
    assert np.ptp(energies) < 0.1 * 9.81 * 0.5 * 9.81 * 0.5 * 1e-3


def test_a_spinning_object_keeps_momentum_and_energy_to_first_order():
    def drift(dt):
        brick = Box(size=(0.02, 0.04, 0.1), mass=0.5)
        made = engine(SHAPES["sphere"], brick, dt=dt, gravity=(0, 0, 0))
        made.place(np.zeros(1), np.zeros(1), pose(np.eye(3), [0, 0, 1.0]))

        def state():
            made.touches()
            R = made.object_pose[:3, :3]
            return R @ brick.inertia_s @ R.T @ made.object_twist[3:], made.kinetic_energy()

        fly(made, [0.1, 0, 0, 0.3, 8.0, 0.5], 0)
        momentum, energy = state()
        fly(made, [0.1, 0, 0, 0.3, 8.0, 0.5], round(0.5 / dt))
        after, left = state()
        R = made.object_pose[:3, :3]
        np.testing.assert_allclose(R.T @ R, np.eye(3), atol=1e-11)
        return np.linalg.norm(after - momentum) / np.linalg.norm(momentum), abs(left - energy) / energy

    coarse, fine = np.array(drift(1e-3)), np.array(drift(2.5e-4))
    assert (fine < 2e-3).all()
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.3)


def test_energy_of_a_hand_with_motors_beyond_coupled_joints(tmp_path):
    """However often it is asked for: half the sum of each link's v^T I v by Pinocchio's forward kinematics, and of the
    rotors, to rounding.
    """
    limit = "-1 1.4 5 4"
    parts = [own_hands.link("palm", 0.5, "box 0.1 0.1 0.03", "0 0 -0.015")]
    for i, x in enumerate((-0.05, 0.05)):
        parts += [own_hands.link(f"{name}{i}", 0.04, "cylinder 0.007 0.03", "0 0 0.015") for name in ("a", "b", "c")]
        parts += [
            own_hands.joint(f"first{i}", "palm", f"a{i}", f"{x} 0 0", "0 1 0", limit),
            own_hands.joint(f"middle{i}", f"a{i}", f"b{i}", "0 0 0.03", "0 1 0", limit, mimic=f"first{i} 0.7 0.1"),
            own_hands.joint(f"last{i}", f"b{i}", f"c{i}", "0 0 0.03", "0 1 0", limit),
        ]
    (tmp_path / "hand.urdf").write_text(own_hands.robot("coupled", *parts))
    hand = pg.load_hand(tmp_path / "hand.urdf")
    body = Sphere(radius=0.01, mass=0.1, pose=pose(np.eye(3), [0.0, 0.0, 5.0]))
    task = SimpleNamespace(
        links=(), hand=hand, body=body, gravity_o=np.zeros(3), torque_limit=np.full(hand.n, np.inf), carrier=""
    )
    servo, rng = Servo.of(hand), np.random.default_rng(5)
    made = MujocoEngine(task, time_step=1e-3, servo=servo, mass_factor=1.0)
    for _ in range(4):
        q, v = rng.uniform(-0.5, 0.8, hand.n), rng.normal(size=hand.n)
        made.place(q, v)
        made.touches()
        data = hand.model.createData()
        pin.forwardKinematics(hand.model, data, q, v)
        links = sum(own.vtiv(data.v[j]) for j, own in enumerate(hand.model.inertias) if j)
        assert made.kinetic_energy() == pytest.approx(0.5 * (links + servo.rotor @ v**2), rel=1e-12)


def test_hand_and_object_feel_opposite_forces():
    """A free joint in no gravity: what the object gains in angular momentum about the joint's axis, the joint loses."""
    hand, body = one_joint(SHAPES["ellipsoid"]), Sphere(radius=0.03, mass=0.1)
    limp = Servo(stiffness=np.full(1, 1e-12), damping=np.full(1, 1e-12), rotor=np.zeros(1))
    task = SimpleNamespace(
        links=(), hand=hand, body=body, gravity_o=np.zeros(3), torque_limit=np.full(1, np.inf), carrier=""
    )
    made = MujocoEngine(task, time_step=1e-4, servo=limp, mass_factor=1.0)
    made.place(np.zeros(1), np.array([2.0]), pose(np.eye(3), [0.05, 0.0425, 0.003]))
    law = ContactForces(ContactLaw(stiffness=1e6, damping=0.0, exponent=1.5), np.full(2, 0.5), 1e-3, 2e4, np.ones(2))
    inertia = float(pin.crba(hand.model, hand.model.createData(), np.zeros(1))[0, 0])

    def momentum() -> float:
        twist, at = made.object_twist, made.object_pose[:3, 3]
        return inertia * made.dq[0] + 0.1 * np.cross(at, twist[:3])[2] + (body.inertia_s[2, 2] * twist[5])

    before, pressed = momentum(), 0.0
    for _ in range(400):
        touches = made.touches()
        pressing = law.press(touches, 1e-4)
        pressed = max(pressed, pressing.normal.sum())
        made.step(made.q, made.dq, np.zeros(1), touches, pressing, np.zeros(6))
    assert pressed > 0.5
    assert momentum() == pytest.approx(before, rel=1e-3)
    assert np.linalg.norm(made.object_twist[:3]) > 0.01


def mesh(corners, triangles) -> coal.BVHModelOBBRSS:
    made = coal.BVHModelOBBRSS()
    made.beginModel(len(triangles), 3 * len(triangles))
    for triangle in triangles:
        made.addTriangle(*np.array(corners, dtype=float)[list(triangle)])
    made.endModel()
    return made


def test_what_is_no_shape_is_refused_and_meshes_are_noted():
    with pytest.raises(InvalidInput, match=r"expected a shape of pinograsp\.objects, got SimpleNamespace"):
        engine(SHAPES["sphere"], SimpleNamespace(mass=1.0, inertia_s=np.eye(3), shape_pose=np.eye(4)))
    # A pyramid whose base is pushed in, and a sheet.
    corners = 0.01 * np.array([[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0], [0, 0, 2], [0, 0, 1]])
    sides = [(0, 1, 4), (1, 2, 4), (2, 3, 4), (3, 0, 4), (1, 0, 5), (2, 1, 5), (3, 2, 5), (0, 3, 5)]
    dented, sheet = mesh(corners, sides), mesh(corners, [(0, 1, 2), (0, 2, 3)])
    notes = [engine(shape, OBJECTS["box"]).notes for shape in (dented, sheet)]
    assert notes == [("'tip_0' is not convex: its convex hull is used",), ("'tip_0' is flat: it is left out",)]
