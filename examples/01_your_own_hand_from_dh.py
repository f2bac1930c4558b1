"""A hand of your own from Denavit-Hartenberg rows: two fingers of two joints each, as a URDF, closed on a sphere."""

import tempfile
from math import pi, radians
from pathlib import Path

import pinograsp as pg
from pinograsp.hands.dh import FingerDescription, HandDescription, Link, PhalanxShape
from pinograsp.spatial import pose_of, rotation_rpy


def finger(name: str, at: list[float], yaw: float) -> FingerDescription:
    """Two phalanges of 45 and 35 mm that flex towards the middle; A_i = Rz(q_i) Tz(d_i) Tx(a_i) Rx(alpha_i)."""
    rows = (
        Link(
            joint=f"{name}_mcp",
            link=f"{name}_proximal",
            a=0.045,
            lower=radians(-60),
            upper=radians(90),
            phalanx=PhalanxShape(a=0.0225, b=0.008, c=0.008),
        ),
        Link(
            joint=f"{name}_pip",
            link=f"{name}_distal",
            a=0.035,
            lower=0.0,
            upper=radians(100),
            phalanx=PhalanxShape(a=0.0175, b=0.007, c=0.007),
        ),
    )
    # The frame's x points along the stretched finger (up), its z along the flexion axis.
    base = pose_of(at, rotation_rpy(0.0, 0.0, yaw) @ rotation_rpy(pi / 2, 0.0, 0.0) @ rotation_rpy(0.0, 0.0, pi / 2))
    return FingerDescription(name=name, base=base, links=rows)


description = HandDescription(
    name="pincer",
    fingers=(finger("left", [0.03, 0, 0], 0.0), finger("right", [-0.03, 0, 0], pi)),
    density=1000.0,
    effort=1.5,
    velocity=5.0,
)
with tempfile.TemporaryDirectory() as folder:
    xacro, urdf = description.write(Path(folder))
    hand = pg.load_hand(urdf)
print(hand.describe())

ball = pg.Sphere(radius=0.025, mass=0.1)
conditions = pg.GraspConditions(mu=0.8, friction=pg.Friction(model="soft", torsion=5e-3))
found = pg.find_grasps(hand, ball, conditions, count=32, seed=1)
plan = pg.plan_grasp_on(found.best.closure.hand, found.best.closure, conditions)
print(plan.status, plan.forces.normal_forces, f"N, peak torque {plan.motion.peak_torque:.3f} N m")
