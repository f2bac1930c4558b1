"""Calls of the public functions with one to three arguments spoiled: they succeed with finite results, or say what is
wrong.

Every entry of ``CALLS`` is a valid call on small things. Where an argument is spoiled with what can never be meant (a
text or a truth value for a number, a masked array, a set...) success is a failure, too."""

from __future__ import annotations

import array
import datetime
import decimal
import enum
import fractions
import inspect
import math
import os
import reprlib
import types
from collections import OrderedDict, UserDict, namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path

import numpy as np

import pinograsp as pg
from pinograsp.errors import PinograspError

WORLD = types.SimpleNamespace()
CALLS: dict[str, tuple[Callable, dict]] = {}
LOOPBACK = True


@dataclass(frozen=True)
class Case:
    call: str
    arguments: dict
    spoiled: tuple[str, ...]

    def __repr__(self) -> str:
        return f"{self.call}, spoiled: " + ", ".join(
            f"{name}={reprlib.repr(self.arguments[name])}" for name in self.spoiled
        )


def prepare() -> None:
    """A grasp of everything, then the table of calls."""
    w = WORLD
    w.case = pg.load_case("paper", {"forces.search": "convex", "forces.balance": "wrench"})
    w.plan = w.case.plan()
    w.hand, w.contacts, w.problem, w.solution = w.plan.hand, w.plan.problem.contacts, w.plan.problem, w.plan.solution
    w.pen = w.case.make_object()
    w.points = {contact.finger: np.array(contact.point_o) for contact in w.contacts}
    w.q = np.array(w.plan.motion.q[-1])
    w.closure = pg.close_hand(w.hand, w.pen)
    w.conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone"))
    w.ball = pg.Sphere(radius=0.03, mass=0.2)
    w.run = w.plan.with_margins().with_reach()
    w.torques = pg.torque_limits(w.hand, w.contacts, w.q, limit=2.0)
    w.batch = pg.ForceBatch.of([w.problem, w.problem], impact_times=0.9)
    w.loads = pg.LoadSet.around(w.problem.load, mass_range=(0.9, 1.1))
    w.grid = pg.GridSpec(
        impact_times=[0.9], accelerations=np.linspace(0.1, 0.9, 9), multipliers=np.linspace(-0.9, 0.9, 5)
    )
    w.paper = pg.load_case("paper").make_problem(w.hand)
    w.simulation = pg.simulate(w.plan, hold=0.01, time_step=2e-3)
    w.online = pg.OnlineForces(w.problem, hand=w.hand, q=w.q)
    _fill()


def _fill() -> None:
    from pinograsp import actuation, contacts, forces, handover, hands, motion, report, simulation, storage, synthesis
    from pinograsp.cases import builtin_cases
    from pinograsp.contacts import quality
    from pinograsp.hands import dh
    from pinograsp.sweep import load_sweep
    from pinograsp.viz import checks, figures
    from pinograsp.writing import write_file

    w = WORLD
    eye, box = np.eye(4), [0.03, 0.04, 0.05]
    tetrahedron = {
        "vertices": 0.03 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        "faces": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    }

    def call(function, name=None, /, **arguments):
        CALLS[name or function.__qualname__] = function, arguments

    weight = {"mass": 0.2, "density": None, "pose": eye}
    call(pg.Sphere, radius=0.03, **weight)
    call(pg.Cylinder, radius=0.01, height=0.12, **weight)
    call(pg.Capsule, radius=0.01, length=0.1, **weight)
    call(pg.Box, size=box, **weight)
    call(pg.Ellipsoid, semi_axes=box, **weight)
    call(pg.Mesh, **tetrahedron, **weight, convex=False)
    for body in (
        w.ball,
        w.pen,
        pg.Box(size=box, mass=0.1),
        pg.Ellipsoid(semi_axes=box, mass=0.1),
        pg.Mesh(**tetrahedron, mass=0.1),
    ):
        name = type(body).__name__
        for method in ("project", "curvature"):
            call(
                getattr(body, method),
                f"{name}.{method}",
                points_o=np.array([[0.011, 0.002, 0.003], [0.001, 0.032, 0.001]]),
            )
        call(body.placed, f"{name}.placed", pose=eye)
    call(pg.object_from, spec="cylinder:radius=0.02,height=0.12,mass=0.2")

    call(pg.MarhefkaOrin, stiffness=5e4, damping=100.0, exponent=1.5)
    call(
        contacts.hertz,
        young=(1e9, 2e9),
        poisson=(0.3, 0.4),
        curvatures=[[10.0, 20.0], [30.0, 40.0]],
        angle=0.1,
        damping=1.0,
    )
    call(w.problem.compliance.normal_force, depth=[1e-3, 2e-3], rate=0.1)
    call(w.problem.compliance.depth, force=[1.0, 2.0])
    point = {"point_o": np.array([0.01, 0.0, 0.0]), "rotation_oc": np.eye(3), "length": 0.03, "distance": 0.0}
    call(pg.Contact, finger="thumb", link="thumb_distal", **point, point_l=np.zeros(3))
    call(pg.ContactSet, contacts=w.contacts.contacts, com_o=w.contacts.com_o, posture=w.q)
    shape = pg.contacts.DecelerationShape
    call(shape.linear, start=1.0, end=0.5)
    call(shape.polynomial, coefficients=[1.0, -0.5])
    call(shape.sampled, values=[1.0, 0.7, 0.2])
    call(shape, name="mine", alpha=shape.linear(1.0, 0.0).alpha)
    for method in ("acceleration", "depth", "rate"):
        call(getattr(shape.linear(1.0, 0.5), method), u=[0.2, 0.5])
    for method in ("impulse_factor", "work_factor"):
        call(getattr(shape.linear(1.0, 0.5), method), rho=1.5)
    call(pg.Friction, model="pyramid", edges=8, torsion=0.01, safety=1.1)
    friction = pg.Friction(model="cone", torsion=0.01)
    for method, name in (("gauge", "u"), ("support", "a"), ("support_point", "a")):
        call(getattr(friction, method), **{name: np.ones((2, 3))})
    call(friction.scale, mu=np.array([0.5, 0.7]))
    call(
        pg.contacts.PenetrationProfile,
        acceleration=[0.1, 0.2],
        impact_time=0.9,
        final_time=1.0,
        shape=shape.linear(1.0, 0.5),
    )
    for method in ("depth", "rate"):
        call(getattr(w.solution.profile, method), t=[0.85, 0.95])
    call(
        pg.contacts_at,
        hand=w.hand,
        body=w.pen,
        points=w.points,
        links={"thumb": [w.contacts[0].link]},
        lengths={"thumb": [0.03]},
        gravity_o=(0.0, 0.0, -9.81),
        tolerance=1e-3,
    )
    call(pg.contacts_at, "contacts_at of an array", hand=None, body=w.pen, points=w.contacts.points_o, tolerance=1e-3)
    opened = {finger.name: np.zeros(len(finger.dofs)) for finger in w.hand.fingers}
    posture = {finger.name: w.q[finger.dofs] for finger in w.hand.fingers}
    call(
        pg.close_hand,
        hand=w.hand,
        body=w.pen,
        start=opened,
        target=np.array(w.hand.upper),
        palm=True,
        fingers=["thumb", "index"],
        wrap=False,
        fixed=False,
        friction=0.5,
    )
    call(w.closure.contacts, gravity_o=(0.0, 0.0, -9.81), palm=True, patches=True)
    call(contacts.check_geometry, hand=w.hand)
    call(contacts.clearance, hand=w.hand, body=w.pen, q=w.q)
    call(contacts.open_and_closed, hand=w.hand, body=w.pen)
    call(contacts.touching, hand=w.hand, body=w.pen, contacts=w.contacts, posture=w.q)
    call(contacts.MeasuredCompliance, depths=[1e-3, 2e-3, 4e-3], forces=[1.0, 3.0, 9.0], damping=0.1)
    table = contacts.MeasuredCompliance(depths=[1e-3, 2e-3, 4e-3], forces=[1.0, 3.0, 9.0])
    for law in (w.problem.compliance, table):
        for energy in (law.impulse, law.work):
            call(energy, final_depth=[1e-3], duration=0.1, shape=shape.constant())
        call(law.powers, measure="work", duration=0.1, shape=shape.constant(), largest=20.0)
    settings = {"friction": pg.Friction(), "moment_length": 0.03, "balance": "wrench"}
    call(quality.ferrari_canny, contacts=w.contacts, mu=0.7, norm="L1", tolerance=1e-2, limit=1000, **settings)
    call(quality.grasp_volume, contacts=w.contacts, mu=0.7, **settings)
    call(quality.grasp_map_metrics, contacts=w.contacts, moment_length=0.03, balance="wrench")
    call(
        quality.grasp_stiffness,
        contacts=w.contacts,
        compliance=w.problem.compliance,
        normal_forces=w.solution.normal_forces,
        tangential_ratio=0.66,
        moment_length=0.03,
    )
    call(quality.manipulability, jacobians=w.torques.jacobian[:, :3])

    problem = {
        "load": np.array(w.problem.load),
        "mu": np.array([0.7, 0.7, 0.7]),
        "compliance": pg.MarhefkaOrin(),
        "balance": "wrench",
        "measure": "work",
        "final_time": 1.0,
        "impact_time_range": (0.8, 0.95),
        "acceleration_range": (0.01, 1.0),
        "max_speed": 2.0,
        "max_depth": 5e-3,
        "moment_length": 0.03,
        "gravity_o": (0.0, 0.0, -9.81),
        "friction": pg.Friction(model="cone"),
        "max_normal_force": 15.0,
        "torques": w.torques,
        "shape": shape.linear(1.0, 0.5),
        "object": w.pen,
    }
    call(pg.ForceProblem, contacts=w.contacts, **problem)
    held = {name: problem[name] for name in ("mu", "balance", "gravity_o", "friction", "max_normal_force")}
    call(pg.ForceProblem.holding, object=w.pen, contacts=w.contacts, **held)

    def solved(**settings):
        return pg.optimize_forces(pg.ForceProblem(contacts=w.contacts, **settings), 0.9)

    call(solved, "ForceProblem, optimize_forces", **problem)
    call(w.problem.with_load, load=problem["load"])
    call(w.problem.acceleration, normal_force=[5.0, 6.0, 7.0], impact_time=0.9)
    call(w.problem.normal_force, acceleration=[0.1, 0.2, 0.3], impact_time=0.9)
    call(w.problem.normal_force_range, impact_time=0.9)
    call(w.problem.depth_per_acceleration, impact_time=0.9)
    call(w.problem.checked_impact_time, impact_time=0.9)
    call(w.problem.binding_bound, impact_time=0.9, contact=1)
    call(w.problem.energy, normal_force=[5.0, 6.0, 7.0], impact_time=0.9, measure="work")
    call(w.problem.energy_terms, impact_time=0.9, measure="work")
    call(w.problem.forces, normal_force=[5.0, 6.0, 7.0], multipliers=np.zeros((3, 2)))
    call(w.problem.residual, forces_c=np.ones((3, 3)), torsion=np.zeros(3))
    call(w.problem.scaled_norm, wrench=np.ones(6))
    call(w.problem.support, direction=np.ones(6))
    call(
        pg.TorqueLimits,
        jacobian=w.torques.jacobian,
        bias=w.torques.bias,
        limit=w.torques.limit,
        joints=w.torques.joints,
    )
    call(w.torques.torques, forces_o=np.ones((3, 3)), moments_o=np.zeros((3, 3)))
    call(pg.torque_limits, hand=w.hand, contacts=w.contacts, q=w.q, depth=1e-3, limit=2.0, gravity_o=(0.0, 0.0, -9.81))
    call(pg.GridSpec, impact_times=[0.9], accelerations=[0.1, 0.3], multipliers=[-0.5, 0.0, 0.5], residual_limit=0.1)
    for method in ("cells", "points"):
        call(getattr(w.grid, method), k=3)
    call(forces.grid_values, start=0.0, stop=1.0, step=0.1)
    call(pg.grid_search, problem=w.paper, grid=w.grid, search="hybrid", method="pruned", solver="daqp", progress=False)
    call(forces.refine_multipliers, problem=w.paper, normal_forces=[9.8, 6.3, 4.7], solver="daqp")
    call(forces.MultiplierQP, problem=w.paper, normal_forces=[9.8, 6.3, 4.7])
    call(forces.MultiplierQP(w.paper, [9.8, 6.3, 4.7]).solve, load=problem["load"])
    call(
        pg.optimize_forces,
        problem=w.problem,
        impact_time=0.9,
        objective={"work": 1.0, "least_squares": 1e-4},
        solver="auto",
    )
    call(
        pg.optimize_forces,
        "optimize_forces by name",
        problem=w.problem,
        impact_time=0.9,
        objective="peak",
        solver="clarabel",
    )
    call(pg.optimize_grasp, problem=w.problem, objective="work", solver="auto", gap=1e-3, progress=False)
    call(pg.ForceSolver, problem=w.problem, impact_time=0.9, objective="work", solver="clarabel")
    call(pg.ForceSolver(w.problem, 0.9, solver="clarabel").solve, load=problem["load"])
    qp, socp = forces.to_qp(w.paper, 0.9, objective="least_squares"), forces.to_socp(w.problem, 0.9, objective="work")
    call(forces.to_qp, problem=w.paper, impact_time=0.9, objective="least_squares")
    call(forces.to_socp, problem=w.problem, impact_time=0.9, objective={"work": 1.0, "peak": 0.1})
    call(qp.solution, x=np.ones(len(qp.q)), y=np.ones(len(qp.b)), z=np.ones(len(qp.h)), settle=False)
    call(socp.solution, x=np.ones(len(socp.q)), z=np.ones(len(socp.b)), settle=True)
    call(qp.forces, x=np.ones(len(qp.q)))
    call(socp.torsion, x=np.ones(len(socp.q)))
    call(pg.diagnose, problem=w.problem, impact_time=0.9)
    call(pg.grasp_margins, solution=w.solution, tolerance=1e-2)
    call(
        forces.disturbance_margin,
        problem=w.problem,
        direction=problem["load"],
        normal_forces=w.solution.normal_forces,
        impact_time=None,
    )
    call(
        forces.disturbance_margin,
        "disturbance_margin at a time",
        problem=w.problem,
        direction=problem["load"],
        impact_time=0.9,
    )
    call(pg.force_closure, contacts=w.contacts, mu=0.7, friction=pg.Friction(), balance="wrench")
    call(pg.forces.min_weight, contacts=w.contacts, mu=0.7, edges=8, balance="wrench")
    call(pg.LoadSet, loads=w.loads.loads, ball=0.1)
    call(pg.LoadSet.around, load=problem["load"], box=[0.1, 0.1, 0.1, 0, 0, 0], ball=0.1, mass_range=(0.9, 1.1))
    call(
        pg.optimize_robust,
        problem=w.problem,
        load_set=w.loads,
        impact_time=0.85,
        mu_range=(0.65, 0.8),
        objective="work",
    )
    call(
        forces.holding_probability,
        problem=w.problem,
        impact_time=0.9,
        normal_forces=np.array(w.solution.normal_forces),
        friction=0.1,
        load=0.1,
        disturbance=np.zeros(6),
        points=1e-3,
        normals=0.05,
        count=20,
        seed=0,
    )
    reliability = forces.holding_probability(w.problem, 0.9, count=50)
    call(reliability.squeeze, share=0.9)
    call(forces.force_sensitivity, solution=w.solution)
    call(
        forces.optimize_contacts,
        problem=w.problem,
        object=w.pen,
        impact_time=0.9,
        objective="work",
        reach=1e-3,
        tolerance=1e-2,
        solver="auto",
    )
    k = len(w.contacts)
    n = w.hand.n
    joints = {"joint_stiffness": np.full(n, 50.0), "springs": np.full(n, 0.1)}
    yielding = actuation.CompliantHand.at(w.contacts, w.torques.jacobian, gains=np.full(n, 5.0))
    call(
        actuation.CompliantHand,
        jacobian=np.array(yielding.jacobian),
        gains=np.full(n, 5.0),
        transmission=np.eye(n),
        turning=np.array(yielding.turning),
        **joints,
    )
    call(
        actuation.CompliantHand.at,
        contacts=w.contacts,
        jacobians=np.array(w.torques.jacobian),
        gains=np.full(n, 5.0),
        transmission=np.eye(n),
        **joints,
    )
    call(
        actuation.contact_stiffness,
        compliance=w.problem.compliance,
        normal_forces=w.solution.normal_forces,
        tangential_ratio=0.66,
    )
    held = {"grasp_map": np.array(w.contacts.G), "stiffness": 1e3 * np.eye(3 * k), "hand": yielding}
    call(actuation.quasistatic_maps, **held, moment_length=0.03)
    call(
        actuation.object_stiffness,
        **held,
        forces_c=np.array(w.solution.forces_c),
        object_curvature=100.0,
        hand_curvature=80.0,
        torsional_stiffness=0.1,
        joint_preload=np.zeros((n, n)),
        moment_length=0.03,
    )
    squeeze = {"solution": w.solution, "hand": yielding, "factors": [0.2, 20.0], "tangential_ratio": 0.66}
    call(actuation.force_band, **squeeze)
    call(actuation.gains_within, **squeeze, tolerance=0.3)
    call(motion.preload_slope, hand=w.hand, contacts=w.contacts, q=w.q, forces_o=np.ones((k, 3)), depth=1e-3)
    call(
        pg.ForceBatch,
        points=np.tile(w.contacts.points_o - w.contacts.com_o, (2, 1, 1)),
        rotations=np.tile(w.contacts.rotations_oc, (2, 1, 1, 1)),
        loads=np.tile(w.problem.load, (2, 1)),
        mu=0.7,
        low=np.zeros((2, k)),
        high=20.0,
        counts=np.array([k, k]),
        friction=pg.Friction(),
        balance="wrench",
        moment_lengths=np.array([0.03, 0.03]),
        energies={"work": np.array([[0.1, 1.5]])},
    )
    call(pg.ForceBatch.of, problems=[w.problem, w.problem], impact_times=[0.9, 0.85])
    call(pg.solve_batch, batch=w.batch, objective="work", threads=1)

    call(
        pg.MotionSpec,
        posture=posture,
        start=posture,
        spread=0.05,
        samples=5,
        time_step=1e-3,
        acceleration_at_start="rest",
    )
    call(motion.contact_postures, hand=w.hand, contacts=w.contacts, reference=posture, spread=0.05, samples=3)
    spec = pg.MotionSpec(samples=3, time_step=0.01)
    call(pg.plan_motion, hand=w.hand, solution=w.solution, spec=spec)

    def moved(**settings):
        return pg.plan_motion(w.hand, w.solution, pg.MotionSpec(**settings))

    call(
        moved,
        "MotionSpec, plan_motion",
        posture=posture,
        start=posture,
        spread=0.05,
        samples=3,
        time_step=0.01,
        acceleration_at_start="rest",
    )
    call(
        pg.OnlineForces,
        problem=w.problem,
        hand=w.hand,
        q=w.q,
        normal_forces=(0.1, 20.0),
        max_rate=100.0,
        ramp=0.1,
        period=1e-3,
        max_steps=50,
    )
    call(w.online.step, load=problem["load"], q=w.q, poses=_poses(w.contacts), mu=np.array([0.7, 0.7, 0.7]))
    call(w.online.engage, contact="thumb", touches=True)
    call(
        pg.plan_grasp,
        hand=w.hand,
        problem=w.problem,
        options=pg.PlanOptions(objective="work", motion=spec),
        torque_limit=None,
        progress=False,
    )
    options = {"grid": w.grid, "search": "hybrid", "solver": "daqp", "objective": None, "motion": spec}
    call(pg.PlanOptions, **options)
    call(pg.plan_grasp, "plan_grasp on a grid", hand=w.hand, problem=w.paper, options=pg.PlanOptions(**options))
    call(
        pg.plan_grasp_on,
        hand=w.hand,
        body=w.closure,
        conditions=w.conditions,
        options=pg.PlanOptions(objective="work", motion=spec),
        progress=False,
    )
    call(
        pg.GraspConditions,
        mu=0.7,
        friction=friction,
        balance="wrench",
        measure="work",
        gravity_o=(0.0, 0.0, -9.81),
        max_depth=5e-3,
        max_normal_force=20.0,
        torque_limit="effort",
    )
    call(w.conditions.problem, body=w.pen, contacts=w.contacts)
    call(
        synthesis.find_grasps,
        hand=w.hand,
        body=w.ball,
        conditions=w.conditions,
        count=1,
        seed=0,
        impact_time=0.9,
        wrap=False,
        jobs=1,
        progress=False,
    )
    call(synthesis.hold, closure=w.closure, conditions=w.conditions, impact_time=0.9)
    hand = w.hand
    call(hand.configuration, angles=posture)
    call(hand.finger, name="thumb")
    call(hand.finger_mass, name="thumb")
    call(hand.frame_id, name=hand.fingers[0].tip)
    call(hand.frame_placements, q=w.q, names=[hand.fingers[0].tip])
    call(hand.is_prismatic, joint_id=1)
    call(hand.ratio, joint_id=1)
    call(hand.placed, pose=eye)
    call(hand.with_limits, limits={hand.joint_names[0]: (-0.5, 0.5)})
    moved = {"joints": hand.joint_names[:2], "arms": (0.01, 0.02)}
    drive = {"name": "d", **moved, "control": "position", "limit": 3.0, "stiffness": 2.0, "damping": 0.1}
    spring = {"joint": hand.joint_names[0], "stiffness": 0.1, "rest": 0.2}
    call(hands.Drive, **drive)
    call(hands.Spring, **spring)
    call(hand.with_drives, drives=[hands.Drive(**drive)], springs=[hands.Spring(**spring)])
    call(hand.fingers[0].joint_of, link=hand.fingers[0].links[0])
    call(
        pg.load_hand,
        source="panda",
        pose=eye,
        root=None,
        palm=None,
        fingers=None,
        limits={"panda_finger_joint1": (0.0, 0.03)},
        drives=[hands.Drive(name="d", joints=("panda_finger_joint1",), arms=(1.0,))],
        springs=[hands.Spring(joint="panda_finger_joint1", stiffness=1.0)],
        hulls=False,
        trusted=False,
    )
    link = {"joint": "j", "link": "l", "d": 0.0, "a": 0.03, "alpha": 0.0, "lower": -1.0, "upper": 1.0, "phalanx": None}
    call(dh.Link, **link)
    finger = dh.FingerDescription(name="f", base=eye, links=(dh.Link(**link),))
    call(dh.FingerDescription, name="f", base=eye, links=(dh.Link(**link),), metacarpal=None)
    call(finger.frames, q=[0.1])
    call(dh.HandDescription, name="h", fingers=(finger,), density=1000.0, effort=1.0, velocity=1.0, notes="")

    call(pg.load_case, source="paper", changes={"forces.search": "convex", "friction.mu": 0.7})
    call(pg.load_case, "load_case, lines", source="paper", texts=["forces.search=convex"])
    call(w.case.make_contacts, hand=w.hand)
    call(w.case.make_problem, hand=w.hand)
    call(load_sweep, source={"case": "paper", "over": {"friction.mu": [0.6, 0.7]}, "set": {"forces.search": "convex"}})
    call(builtin_cases)

    call(handover.joint_trajectory, plan=w.plan, rate=100.0, start=w.q, lead=0.5, blend=0.02)
    trajectory = handover.joint_trajectory(w.plan, rate=100.0)
    call(trajectory.at, times=[0.1, 0.2])
    call(trajectory.to_csv, path="motion.csv", followers=False)
    call(trajectory.to_ros2, path="motion.yaml", followers=False, effort=True, goal=False, frame="world")
    call(trajectory.to_mujoco, path="motion.xml", model=None, qpos=None, feed_forward=True, prefix="")
    call(w.plan.to_csv, path="plan.csv", followers=False, rate=100.0)
    call(w.plan.to_ros2, path=None, followers=False, effort=True, goal=True, frame="", rate=100.0, start=w.q)
    call(w.plan.to_mujoco, path="plan.xml", feed_forward=True, prefix="hand_", rate=100.0)
    servo = {"stiffness": 5.0, "damping": np.full(w.hand.n, 0.1), "shortfall": 0.05}
    call(handover.drive_commands, plan=w.plan, command="impedance", rate=100.0, start=w.q, **servo)
    call(w.plan.to_csv, "to_csv of drives", path="drives.csv", command="position", stiffness=5.0, rate=100.0)
    call(w.plan.to_ros2, "to_ros2 of drives", path="drives.yaml", command="torque", goal=True, rate=100.0)
    call(w.plan.to_mujoco, "to_mujoco of drives", path="drives.xml", command="torque", rate=100.0)
    call(
        w.plan.to_mujoco,
        "to_mujoco, scene",
        path="scene.xml",
        scene=True,
        command="impedance",
        hold=0.1,
        rate=100.0,
        **servo,
    )
    target = handover.JointTarget(joint="j", position=0.01, closed=0.0, effort=3.0, follows=False)
    jaw = handover.JawCommand(
        drive="jaws",
        coordinate=0.02,
        effort=3.0,
        width=0.02,
        touch_width=0.021,
        jaw_force=3.0,
        total_force=6.0,
        joints=(target,),
    )
    call(handover.gripper_message, jaws=[jaw], path="grip.yaml", followers=True, frame="world")
    call(handover.write_jaws, jaws=[jaw], path="jaws.csv")
    call(handover.read_csv, path="kept/motion.csv")
    call(handover.read_ros2, path="kept/motion.yaml")

    push = simulation.Push(wrench_o=[0, 0, -0.5, 0, 0, 0], start=0.01, duration=0.01)
    call(simulation.Push, wrench_o=[0, 0, -0.5, 0, 0, 0], start=0.2, duration=0.1)
    motion = simulation.BaseMotion(times=[0.0, 0.02], accelerations=np.zeros((2, 3)))
    call(simulation.BaseMotion, times=[0.0, 0.02], accelerations=np.zeros((2, 3)))
    call(motion.at, since=0.01)
    call(simulation.BaseMotion.through, times=[0.0, 0.02], positions=np.zeros((2, 3)))
    disturbance = {
        "pushes": (push,),
        "shake": [0.1, 0.0, 0.0],
        "shake_frequency": 3.0,
        "mu": 0.65,
        "mass_factor": 1.1,
        "object_offset": [1e-4, 0.0, 0.0],
        "object_turn": [0.0, 0.01, 0.0],
        "start_error": np.zeros(hand.n),
        "base_motion": motion,
        "stiffness": 2.0,
        "joint_offset": 1e-4,
        "joint_friction": np.full(hand.n, 1e-4),
        "servo_gain": 1.1,
    }
    call(simulation.Disturbance, **disturbance)
    call(simulation.Disturbance(**disturbance).wrench, since_release=0.01)
    call(simulation.Disturbance(**disturbance).acceleration, since=0.01)
    call(simulation.Servo, stiffness=np.ones(hand.n), damping=np.ones(hand.n), rotor=np.zeros(hand.n))
    call(simulation.Servo.of, hand=hand, stiffness=50.0, damping=0.5, control="position")
    call(simulation.Servo.of(hand).scaled, factor=1.1)
    call(
        simulation.Errors,
        position=2e-3,
        rotation=0.03,
        friction=(0.05, 0.1),
        mass=0.1,
        posture=0.01,
        push=0.2,
        stiffness=(0.5, 2.0),
        joint_offset=0.01,
        joint_friction=0.01,
        servo_gain=0.1,
    )
    call(
        pg.simulate,
        plan=w.plan,
        hold=0.01,
        mode="servo",
        disturbance=simulation.Disturbance(),
        servo=simulation.Servo.of(hand),
        time_step=2e-3,
        sample=5e-3,
        release=True,
        letting_go=0.01,
        body=w.pen,
    )
    quick = {"hold": 0.01, "time_step": 2e-3}
    call(
        simulation.monte_carlo,
        plan=w.plan,
        count=1,
        seed=0,
        errors=simulation.Errors(),
        jobs=1,
        progress=False,
        folder=None,
        **quick | {"hold": 0.31},
    )
    for threshold in (simulation.slip_threshold, simulation.load_threshold):
        call(threshold, plan=w.plan, tolerance=1.0, planned=0.7, jobs=1, disturbance=None, **quick)
    slippery = simulation.Disturbance(mu=0.0)
    call(simulation.what_holds, plan=w.plan, disturbance=slippery, tolerance=1.0, **quick)

    call(pg.save_run, plan=w.run, folder="run", force=False, extras=None)
    call(pg.load_run, folder="kept/run")
    call(storage.newest_check, folder="absent")
    call(storage.read_check, folder="absent")
    call(write_file, path="file", content=b"abc")
    call(report.report_plan, plan=w.run, figures=(), simulation=None)
    call(report.write_report, run=w.run, folder=".", figures=(), simulation=None)
    for figure in (figures.joint_angles, figures.contact_forces, figures.friction_use, figures.wrench_margin):
        call(figure, plan=w.run)
    call(figures.joint_torques, plan=w.run, finger="thumb")
    table = {
        "mu": [0.6, 0.6, 0.7, 0.7],
        "mass": [1.0, 2.0, 1.0, 2.0],
        "energy": [1.0, 2.0, 3.0, 4.0],
        "status": ["ok"] * 4,
    }
    call(figures.sweep_map, columns=table, value="energy", x="mu", y="mass")
    for figure in (checks.forces_beside_plan, checks.object_motion):
        call(figure, simulation=w.simulation)


def _poses(contacts) -> np.ndarray:
    poses = np.tile(np.eye(4), (len(contacts), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = contacts.rotations_oc, contacts.points_o
    return poses


# What may come instead.


class Text(str):
    __slots__ = ()


class Number(float):
    __slots__ = ()


class Numbers(np.ndarray):
    pass


class Pair(namedtuple("Pair", "a b")):
    __slots__ = ()


class Level(enum.IntEnum):
    LOW = 1


class Column:
    """Like a column of a table: values, an index, and an array on demand."""

    def __init__(self, values):
        self.values = np.asarray(values)

    def __len__(self):
        return len(self.values)

    def __getitem__(self, i):
        return self.values[i]

    def __array__(self, dtype=None, copy=None):
        return np.array(self.values, dtype=dtype)


class Shy:
    """Looks like everything and is nothing."""

    def __float__(self):
        raise TypeError("no number")

    def __array__(self, dtype=None, copy=None):
        raise ValueError("no array")

    def __repr__(self):
        raise ValueError("no text")


def _nested(depth: int) -> list:
    value = [1.0]
    for _ in range(depth):
        value = [value]
    return value


def _itself() -> list:
    value = [1.0]
    value.append(value)
    return value


NUMBERS = [
    0,
    -1,
    1,
    2,
    3,
    7,
    0.0,
    -0.0,
    -1.0,
    0.5,
    1.0,
    1e-320,
    1e-12,
    1e12,
    1e150,
    1e308,
    -1e308,
    math.nan,
    math.inf,
    -math.inf,
    10**30,
    2**63,
    -(2**63),
    10**400,
    -(10**400),
    fractions.Fraction(1, 3),
    fractions.Fraction(10**400, 3),
    np.float32(0.5),
    np.float64("nan"),
    np.int8(-3),
    np.uint64(2**63),
    np.longdouble("1e4000"),
    Number(0.5),
    Level.LOW,
    np.array(0.5),
    np.float16(65504),
]
# Never a number, nor numbers in an array.
NOT_NUMBERS = [
    True,
    False,
    np.True_,
    1j,
    1 + 0j,
    np.complex128(2),
    "abc",
    "",
    "0.5",
    "nan",
    "1",
    Text("0.5"),
    b"0.5",
    bytearray(b"1"),
    "x" * 100_000,
    "\0",
    "é…",
    datetime.datetime(2020, 1, 1),
    datetime.timedelta(1),
    np.datetime64("2020-01-01"),
    np.timedelta64(5, "s"),
    np.datetime64("NaT"),
    object(),
    object,
    float,
    len,
    Ellipsis,
    NotImplemented,
    types,
    Shy(),
    Path("x"),
    {1.0},
    frozenset({1.0, 2.0}),
    set(),
    {},
    {"a": 1.0},
    {0: 1.0, 1: 2.0},
    UserDict(a=1),
    OrderedDict(b=2),
    types.MappingProxyType({"c": 3}),
    ValueError("x"),
    np.ma.masked,
    slice(3),
    memoryview(b"abc"),
    np.dtype(float),
    np.array("0.5"),
    np.array(1j),
    np.array(True),
    np.array(None),
    np.array("2020-01-01", dtype="M8[D]"),
    np.str_("1"),
    Shy,
    math,
    print,
]
# Neither a number nor, by their values, an array of finite numbers.
NOT_ARRAYS = [
    np.ones(3, dtype=complex),
    np.ones((3, 3)) * 1j,
    np.array(["1", "2", "3"]),
    np.array([b"1", b"2"]),
    np.array([True, False, True]),
    np.array([None, 1.0, 2.0]),
    np.array(["2020", "2021", "2022"], dtype="M8[Y]"),
    np.zeros(3, dtype="m8[s]"),
    np.zeros(3, dtype="i4,f8"),
    np.full(3, np.nan),
    np.array([1.0, np.inf, 2.0]),
    np.ma.masked_array([1.0, 2.0, 3.0], mask=[0, 1, 0]),
    [1.0, "a", 2.0],
    ["1", "2", "3"],
    [[1, 2], [3]],
    [None, None, None],
    [{}],
    [1j, 2, 3],
    [object()] * 3,
    _nested(70),
    _nested(5000),
    _itself(),
    ["x" * 1000] * 1000,
    [10**400, 1, 2],
    [True, False, True],
    [1.0, [2.0, 3.0]],
    [datetime.date(2020, 1, 1)] * 3,
    Column(["a", "b", "c"]),
    Column([1j, 2, 3]),
    [Shy()] * 3,
    [decimal.Decimal("NaN")] * 3,
    Column([np.nan] * 3),
    [np.nan] * 6,
    np.full((3, 3), np.inf),
]
ARRAYS = [
    [],
    (),
    [[]],
    np.zeros(0),
    np.zeros((0, 3)),
    np.zeros((3, 0)),
    np.zeros((2, 0, 3)),
    np.ones(1),
    np.ones(3),
    np.ones(6),
    np.zeros(3),
    np.zeros(6),
    np.ones((3, 3)),
    np.ones((2, 3)),
    np.ones((3, 2)),
    np.ones((4, 4)),
    np.eye(4),
    -np.eye(4),
    np.eye(3)[::-1],
    np.full(3, 1e308),
    np.full(6, 1e308),
    np.full(3, 1e-320),
    np.full(6, -1e200),
    np.full((3, 3), 1e308),
    np.ones((1, 1, 1, 1, 1)),
    np.arange(20.0),
    np.zeros(20),
    [1, 2],
    [1, 2, 3],
    (1.0, 2.0),
    (2.0, 1.0),
    (0.0, 0.0),
    (-1.0, 1.0),
    [2**63, 1, 1],
    [10**30, 1, 1],
    range(3),
    range(0),
    array.array("d", [1, 2, 3]),
    Pair(1.0, 2.0),
    Column([1.0, 2.0, 3.0]),
    Column([]),
    np.ones(3).view(Numbers),
    np.asmatrix(np.ones((1, 3))),
    np.ma.masked_array([1.0, 2.0, 3.0]),
    np.ones(3, dtype=np.float16),
    np.ones(3, dtype=">f8"),
    np.broadcast_to(1.0, (3,)),
    np.ones((6, 2))[:, 0],
    np.ones(10_000),
    [decimal.Decimal("0.5")] * 3,
    [fractions.Fraction(1, 2)] * 3,
    np.arange(3, dtype=np.int8),
    np.broadcast_to(1.0, (1000, 3)),
    np.ones((100, 100)),
]
STREAMS = [
    lambda: (float(i) for i in range(3)),
    lambda: iter([1.0, 2.0]),
    lambda: map(float, [1, 2, 3]),
    lambda: {"a": 1}.keys(),
    lambda: zip([1], [2]),
]
WORDS = [
    "abc",
    "",
    "wrench",
    "work",
    "daqp",
    "thumb",
    "THUMB",
    "thumb ",
    "index",
    "cone",
    "x" * 5000,
    "\0",
    "\x1b[31m",
    "ñandú",
    "a\nb",
    "None",
    "0",
    "paper",
    "auto",
]


def _strange(rng) -> object:
    w = WORLD
    ours = [
        w.hand,
        w.pen,
        w.ball,
        w.contacts,
        w.problem,
        w.solution,
        w.plan,
        w.closure,
        w.run,
        w.batch,
        w.loads,
        w.grid,
        w.case,
        pg.Friction(),
        pg.MarhefkaOrin(),
        w.torques,
        w.simulation,
        pg.Status.OK,
        pg.MotionSpec(),
        pg.Friction,
        pg.Sphere,
        w.contacts[0],
        w.contacts.contacts,
    ]
    pools = [NUMBERS, NOT_NUMBERS, NOT_ARRAYS, ARRAYS, WORDS, ours, STREAMS, [None]]
    pool = pools[rng.choice(len(pools), p=[0.25, 0.2, 0.15, 0.15, 0.08, 0.1, 0.03, 0.04])]
    value = pool[rng.integers(len(pool))]
    return value() if pool is STREAMS else value


def _number_like(rng, value: float):
    return [
        -value,
        0.0,
        value * 1e6,
        value * 1e-6,
        value * 1e300,
        value + 1,
        float("nan"),
        np.float32(value),
        np.array(value),
        [value],
        str(value),
        complex(value),
        np.array([value]),
        int(value),
        value * 1e30,
        bool(value),
        np.ma.masked_array(value, mask=True),
        decimal.Decimal(value),
    ][rng.integers(18)]


def _array_like(rng, value):
    a = np.array(value, dtype=float)
    flat = a.ravel()
    at = rng.integers(a.size) if a.size else 0

    def changed(number):
        b = a.copy()
        if b.size:
            b.ravel()[at] = number
        return b

    turns = [
        lambda: changed(np.nan),
        lambda: changed(np.inf),
        lambda: changed(-flat[at] if a.size else 0),
        lambda: changed(1e308),
        lambda: changed(1e-320),
        lambda: changed(0.0),
        lambda: a * 1e200,
        lambda: a * 1e-200,
        lambda: -a,
        lambda: 0 * a,
        lambda: a + 0.1,
        lambda: a.T,
        lambda: a[None],
        lambda: a[:-1],
        lambda: a[..., :-1],
        lambda: a[..., None],
        lambda: np.concatenate([a, a]),
        lambda: a.astype(complex),
        lambda: a.astype(str),
        lambda: a.astype(object),
        lambda: a.astype(bool),
        lambda: a.astype(int),
        lambda: np.ma.masked_array(a, mask=np.arange(a.size).reshape(a.shape) == at),
        lambda: a.tolist(),
        lambda: a.astype("f4"),
        lambda: np.asfortranarray(a),
        lambda: a.view(Numbers),
        lambda: a[::-1],
        lambda: a.astype("S8"),
        lambda: a.ravel(),
        lambda: np.full(a.shape, None),
        lambda: Column(a) if a.ndim else a,
        lambda: changed(10.0 ** rng.uniform(-12, 12)),
        lambda: a[:0],
        lambda: a.astype(">f8"),
        lambda: a + rng.normal(size=a.shape),
        lambda: a + 1e-3 * rng.normal(size=a.shape),
        lambda: [*a.tolist(), "x"] if a.ndim else a,
        lambda: a[0] if a.ndim else a,
    ]
    return turns[rng.integers(len(turns))]()


def _mapping_like(rng, value: Mapping):
    changed = dict(value)
    key = list(changed)[rng.integers(len(changed))] if changed else "a"
    turn = rng.integers(9)
    if turn == 0:
        changed[_strange_key(rng)] = changed.get(key)
    elif turn == 1:
        changed.pop(key, None)
    elif turn < 6:
        changed[key] = _spoiled(rng, changed.get(key))
    elif turn == 6:
        changed = {_strange_key(rng) if name == key else name: v for name, v in changed.items()}
    elif turn == 7:
        return [UserDict(changed), types.MappingProxyType(changed), OrderedDict(changed)][rng.integers(3)]
    else:
        return (
            [list(changed), list(changed.items()), list(changed.values()), tuple(changed), set(changed)][
                rng.integers(5)
            ]
            if _plain(changed)
            else list(changed)
        )
    return changed


def _plain(mapping) -> bool:
    return all(isinstance(key, str) for key in mapping)


def _strange_key(rng):
    return [
        "nobody",
        "",
        0,
        1.5,
        None,
        (),
        b"thumb",
        True,
        math.nan,
        "thumb",
        "x" * 1000,
        Path("a"),
        frozenset(),
        Shy(),
        "little",
    ][rng.integers(15)]


def _items_like(rng, value):
    items = list(value)
    turn = rng.integers(8)
    if turn == 0:
        return items[:-1]
    if turn == 1:
        return items + items
    if turn == 2 and items:
        items[rng.integers(len(items))] = _strange(rng)
    elif turn == 3:
        return [*items, _strange(rng)]
    elif turn == 4:
        return iter(items)
    elif turn == 5 and items:
        return items[0]
    elif turn == 6 and items:
        items[rng.integers(len(items))] = _spoiled(rng, items[0])
    elif turn == 7:
        return dict(enumerate(items))
    return type(value)(items) if type(value) in (tuple, list) else items


def _spoiled(rng, value):
    """Something else instead of a valid value: half of the time a mutation of it."""
    if rng.random() < 0.5:
        return _strange(rng)
    if isinstance(value, bool):
        return [0, 1, "no", "False", None, np.False_, 0.0, [], np.array([True, False])][rng.integers(9)]
    if isinstance(value, (int, float)):
        return (
            _number_like(rng, float(value))
            if rng.random() < 0.7
            else [value + 1, value - 1, -value, 10**9, 10**6, float(value)][rng.integers(6)]
        )
    if isinstance(value, str):
        turns = [
            value.upper(),
            value + " ",
            value[:-1],
            value * 1000,
            value.encode(),
            Text(value),
            Path(value),
            [value],
            np.str_(value),
            value + "\0",
            value[::-1],
        ]
        return turns[rng.integers(len(turns))]
    if isinstance(value, np.ndarray) or _is_numbers(value):
        return _array_like(rng, value)
    if isinstance(value, Mapping):
        return _mapping_like(rng, value)
    if isinstance(value, (list, tuple)):
        return _items_like(rng, value)
    return _strange(rng)


def _is_numbers(value) -> bool:
    return (
        isinstance(value, (list, tuple))
        and bool(value)
        and np.asarray(value, dtype=object).dtype == object
        and all(isinstance(v, (int, float)) or _is_numbers(v) for v in value)
    )


def _never_meant(valid, value) -> bool:
    """Whether a value can by no reading stand where ``valid`` stood."""
    if value is None or valid is None:
        return False
    if isinstance(valid, (bool, np.bool_)):
        return isinstance(value, (str, bytes, float, list, dict, set, np.ndarray))
    if isinstance(valid, (int, float)):
        if isinstance(value, float) and not math.isfinite(value):
            return True
        if isinstance(value, np.ma.MaskedArray) and np.ma.is_masked(value):
            return True
        return _among(value, NOT_NUMBERS[:30]) or isinstance(
            value, (str, bytes, bool, np.bool_, complex, np.datetime64, np.timedelta64, set, np.str_)
        )
    if isinstance(valid, np.ndarray) or _is_numbers(valid):
        if isinstance(value, np.ndarray) and value.size:
            if value.dtype.kind in "cSUbMmV" or np.ma.is_masked(value):
                return True
            return value.dtype.kind == "f" and not np.isfinite(value).all() and not np.isposinf(value).any()
        return _among(value, NOT_ARRAYS) or isinstance(value, (str, bytes, bool, complex, set, types.GeneratorType))
    if isinstance(valid, str):
        return isinstance(value, (bytes, bool, int, float, complex, list, set, np.ndarray))
    return False


def _among(value, pool) -> bool:
    return any(value is one for one in pool)


# The kind.

# Where infinity stands for something, or a number for a text; and the settings of a closure that has too few contacts
# for anything to be asked of them.
MEANT = {
    ("GraspConditions", "torque_limit"),
    ("TorqueLimits", "limit"),
    ("torque_limits", "limit"),
    ("hold", "mu"),
    ("hold", "torque_limit"),
    ("hold", "impact_time"),
    ("OnlineForces.engage", "contact"),
    ("CompliantHand", "gains"),
    ("CompliantHand", "joint_stiffness"),
    ("CompliantHand.at", "gains"),
    ("CompliantHand.at", "joint_stiffness"),
    ("object_stiffness", "object_curvature"),
    ("object_stiffness", "hand_curvature"),
}


# Calls that take a second: fewer of them.
SLOW = {
    "gains_within",
    "holding_probability",
    "plan_grasp",
    "plan_grasp_on",
    "simulate",
    "monte_carlo",
    "slip_threshold",
    "load_threshold",
    "what_holds",
    "OnlineForces",
    "find_grasps",
}


def make(rng: np.random.Generator, folder: Path) -> Case:
    """One call with one to three arguments spoiled."""
    names = list(CALLS)
    name = names[rng.integers(len(names))]
    if name in SLOW and rng.random() < 0.7:
        name = names[rng.integers(len(names))]
    _function, valid = CALLS[name]
    arguments = dict(valid)
    if any(isinstance(value, str) and value.startswith("kept/") for value in valid.values()):
        (folder / "kept").mkdir()
        WORLD.plan.to_csv(folder / "kept" / "motion.csv", rate=50.0)
        WORLD.plan.to_ros2(folder / "kept" / "motion.yaml", rate=50.0)
        pg.save_run(WORLD.run, folder / "kept" / "run")
    if not valid:
        return Case(name, arguments, ())
    count = min(len(valid), 1 + int(rng.choice(3, p=[0.7, 0.2, 0.1])))
    spoiled = tuple(list(valid)[i] for i in sorted(rng.choice(len(valid), count, replace=False)))
    for argument in spoiled:
        arguments[argument] = _argument(rng, name, argument, valid[argument])
    return Case(name, arguments, spoiled)


def _argument(rng, call: str, name: str, valid):
    value = _spoiled(rng, valid)
    if name == "jobs" and isinstance(value, (int, float)) and not isinstance(value, bool) and value not in (0, 1):
        return 1  # more than one job starts processes
    if name in ("path", "folder", "source", "spec") and isinstance(value, (str, Path)) and ("/" in str(value)):
        return "name"
    if name == "extras" and callable(value):
        return None  # what the caller's own function does is the caller's
    if name in ("path", "folder", "source") and isinstance(value, str):
        return value[:300]  # messages tell paths as they are
    return value


def run(case: Case) -> str:
    """Makes the call, looks at what came back."""
    function, valid = CALLS[case.call]
    WORLD.online.reset()
    try:
        result = function(**case.arguments)
    except PinograspError as error:
        text = str(error)
        if len(text) > 4000:
            raise AssertionError(f"{len(text)} characters in the message: {text[:300]}") from error
        if not text.strip():
            raise AssertionError("an error without a message") from error
        raise
    for name in case.spoiled:
        if _never_meant(valid[name], case.arguments[name]) and (case.call, name) not in MEANT:
            raise AssertionError(f"accepted {name}={reprlib.repr(case.arguments[name])}")
    _look(result, case.call, 4)
    return "accepted"


# Where NaN stands for what is not known.
UNKNOWN = {"servo_stiffness"}


def _look(value, where: str, depth: int) -> None:
    """Numbers are numbers; what can be asked of a record can be asked."""
    if isinstance(value, (float, np.floating)):
        if math.isnan(value):
            raise AssertionError(f"{where} is NaN")
    elif isinstance(value, np.ndarray):
        if value.dtype.kind == "f" and np.isnan(value).any():
            raise AssertionError(f"{where} has NaN")
    elif depth == 0 or isinstance(value, (str, bytes, int)) or value is None:
        return
    elif isinstance(value, Mapping):
        for key, item in value.items():
            _look(item, f"{where}[{key!r}]", depth - 1)
    elif isinstance(value, (tuple, list)):
        for i, item in enumerate(value[:20]):
            _look(item, f"{where}[{i}]", depth - 1)
    elif type(value).__module__.startswith("pinograsp.") and is_dataclass(value):
        for field in fields(value):
            if not field.name.startswith("_"):
                _look(getattr(value, field.name), f"{where}.{field.name}", depth - 1)
        for name, _kind in inspect.getmembers(type(value), lambda member: isinstance(member, property)):
            if not name.startswith("_") and name not in UNKNOWN:
                try:
                    _look(getattr(value, name), f"{where}.{name}", depth - 1)
                except PinograspError:
                    continue
        for name in ("describe", "explain", "summary"):
            if depth > 2 and callable(getattr(value, name, None)):
                getattr(value, name)()


if os.environ.get("MPLBACKEND") is None:
    os.environ["MPLBACKEND"] = "Agg"
