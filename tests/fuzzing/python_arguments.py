"""Calls of the public functions with one to three arguments spoiled: they succeed with finite results, or say what is
wrong.

Every entry of ``CALLS`` is a valid call on small things. Where an argument is spoiled with what can never be meant (a
text or a truth value for a number, a masked array, a set...) success is a failure, too."""

from __future__ import annotations

import array
import contextlib
import datetime
import decimal
import enum
import fractions
import inspect
import math
import os
import reprlib
import types
import typing
from collections import OrderedDict, UserDict, namedtuple
from collections.abc import Callable, Mapping
from dataclasses import dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path

import numpy as np

import pinograsp as pg
from fuzzing import material
from fuzzing.material import pick
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
    w.finger_angles = {finger.name: w.q[finger.dofs] for finger in w.hand.fingers}
    w.deceleration = pg.contacts.DecelerationShape.linear(1.0, 0.5)
    w.spec = pg.MotionSpec(samples=3, time_step=0.01)
    values = _list_values()
    for add in (
        _add_objects,
        _add_contacts,
        _add_forces,
        _add_actuation,
        _add_plans,
        _add_hands,
        _add_files,
        _add_checks,
    ):
        add(partial(_add_call, values))


def _list_values() -> dict[str, object]:
    """What arguments of a name are in most of the calls."""
    w = WORLD
    gravity, cone = (0.0, 0.0, -9.81), pg.Friction(model="cone")
    k, n = len(w.contacts), w.hand.n
    return {
        **dict(hand=w.hand, body=w.pen, object=w.pen, contacts=w.contacts, problem=w.problem, solution=w.solution),
        **dict(plan=w.plan, q=w.q, conditions=w.conditions, torques=w.torques, shape=w.deceleration, grid=w.grid),
        **dict(radius=0.03, mass=0.2, density=None, pose=np.eye(4), convex=False, progress=False, jobs=1, seed=0),
        **dict(mu=0.7, friction=cone, balance="wrench", measure="work", gravity_o=gravity, moment_length=0.03),
        **dict(impact_time=0.9, final_time=1.0, impact_time_range=(0.8, 0.95), acceleration_range=(0.01, 1.0)),
        **dict(
            max_speed=2.0, max_depth=5e-3, max_normal_force=15.0, torque_limit=None, objective="work", solver="auto"
        ),
        **dict(load=np.array(w.problem.load), compliance=pg.MarhefkaOrin(), normal_force=[5.0, 6.0, 7.0], edges=8),
        **dict(normal_forces=np.array(w.solution.normal_forces), tangential_ratio=0.66, tolerance=1e-2, limit=2.0),
        **dict(posture=w.finger_angles, start=w.finger_angles, spread=0.05, samples=3, time_step=0.01),
        **dict(forces_o=np.ones((k, 3)), moments_o=np.zeros((k, 3)), forces_c=np.ones((k, 3)), torsion=np.zeros(k)),
        **dict(jacobian=np.array(w.torques.jacobian), gains=np.full(n, 5.0), transmission=np.eye(n), depth=1e-3),
        **dict(joint_stiffness=np.full(n, 50.0), springs=np.full(n, 0.1), rate=100.0, damping=0.1, hold=0.01),
        **dict(name="thumb", joint_id=1, duration=0.1, stiffness=2.0, figures=(), simulation=None, folder=None),
    }


def _add_call(values: dict, function: Callable, name: str | None = None, /, **arguments) -> None:
    """Enter a call: ``arguments``, for others the ``values`` of their names, for the rest the defaults."""
    chosen = {}
    for parameter in inspect.signature(function).parameters.values():
        if parameter.kind in (parameter.VAR_POSITIONAL, parameter.VAR_KEYWORD):
            continue
        if parameter.name in arguments or parameter.name in values:
            chosen[parameter.name] = arguments.get(parameter.name, values.get(parameter.name))
        elif parameter.default is not parameter.empty:
            chosen[parameter.name] = parameter.default
        else:
            raise TypeError(f"{function.__qualname__}: no value for {parameter.name}")
    CALLS[name or function.__qualname__] = function, {**chosen, **arguments}


def _add_objects(call: Callable) -> None:
    tetrahedron = {
        "vertices": 0.03 * np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]),
        "faces": np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]]),
    }
    edges = [0.03, 0.04, 0.05]
    for shape, sizes in (
        (pg.Sphere, {}),
        (pg.Cylinder, {"height": 0.12}),
        (pg.Capsule, {"length": 0.1}),
        (pg.Box, {"size": edges}),
        (pg.Ellipsoid, {"semi_axes": edges}),
        (pg.Mesh, tetrahedron),
    ):
        call(shape, **sizes)
        body = shape(**sizes, **({"radius": 0.03} if "radius" in inspect.signature(shape).parameters else {}), mass=0.1)
        points = np.array([[0.011, 0.002, 0.003], [0.001, 0.032, 0.001]])
        for method in (body.project, body.curvature):
            call(method, f"{shape.__name__}.{method.__name__}", points_o=points)
        call(body.placed, f"{shape.__name__}.placed")
    call(pg.object_from, spec="cylinder:radius=0.02,height=0.12,mass=0.2")


def _add_contacts(call: Callable) -> None:
    from pinograsp import contacts
    from pinograsp.contacts import quality

    w = WORLD
    call(pg.MarhefkaOrin, stiffness=5e4, damping=100.0, exponent=1.5)
    call(contacts.hertz, young=(1e9, 2e9), poisson=(0.3, 0.4), curvatures=[[10.0, 20.0], [30.0, 40.0]], angle=0.1)
    call(w.problem.compliance.normal_force, depth=[1e-3, 2e-3], rate=0.1)
    call(w.problem.compliance.depth, force=[1.0, 2.0])
    point = {"point_o": np.array([0.01, 0.0, 0.0]), "rotation_oc": np.eye(3), "length": 0.03, "distance": 0.0}
    call(pg.contacts.Contact, finger="thumb", link="thumb_distal", **point, point_l=np.zeros(3))
    call(pg.contacts.ContactSet, contacts=w.contacts.contacts, com_o=w.contacts.com_o, posture=w.q)
    shape = contacts.DecelerationShape
    call(shape.linear, start=1.0, end=0.5)
    call(shape.polynomial, coefficients=[1.0, -0.5])
    call(shape.from_samples, values=[1.0, 0.7, 0.2])
    call(shape, name="mine", alpha=shape.linear(1.0, 0.0).alpha)
    for method in (w.deceleration.acceleration, w.deceleration.depth, w.deceleration.rate):
        call(method, u=[0.2, 0.5])
    for method in (w.deceleration.impulse_factor, w.deceleration.work_factor):
        call(method, rho=1.5)
    call(pg.Friction, model="pyramid", torsion=0.01, safety=1.1)
    friction = pg.Friction(model="cone", torsion=0.01)
    for method, name in ((friction.gauge, "u"), (friction.support, "a"), (friction.support_point, "a")):
        call(method, **{name: np.ones((2, 3))})
    call(friction.scale, mu=np.array([0.5, 0.7]))
    call(contacts.PenetrationProfile, acceleration=[0.1, 0.2])
    for method in (w.solution.profile.depth, w.solution.profile.rate):
        call(method, t=[0.85, 0.95])
    links, lengths = {"thumb": [w.contacts[0].link]}, {"thumb": [0.03]}
    points = {contact.finger: np.array(contact.point_o) for contact in w.contacts}
    call(pg.contacts_at, points=points, links=links, lengths=lengths, tolerance=1e-3)
    call(pg.contacts_at, "contacts_at of an array", hand=None, points=w.contacts.points_o, tolerance=1e-3)
    opened = {finger.name: np.zeros(len(finger.dofs)) for finger in w.hand.fingers}
    call(pg.close_hand, start=opened, target=np.array(w.hand.upper), fingers=["thumb", "index"], friction=0.5)
    call(w.closure.contacts, palm=True, patches=True)
    for function in (contacts.check_geometry, contacts.clearance, contacts.open_and_closed):
        call(function)
    call(contacts.touching, posture=w.q)
    table = {"depths": [1e-3, 2e-3, 4e-3], "forces": [1.0, 3.0, 9.0]}
    call(contacts.MeasuredCompliance, **table)
    for law in (w.problem.compliance, contacts.MeasuredCompliance(**table)):
        for energy in (law.impulse, law.work):
            call(energy, final_depth=[1e-3], shape=shape.constant())
        call(law.powers, shape=shape.constant(), largest=20.0)
    call(quality.ferrari_canny, norm="L1", limit=1000, friction=pg.Friction())
    call(quality.grasp_volume, friction=pg.Friction())
    for function in (quality.grasp_map_metrics, quality.grasp_stiffness):
        call(function)
    call(quality.manipulability, jacobians=w.torques.jacobian[:, :3])


def _add_forces(call: Callable) -> None:
    from pinograsp import forces

    w = WORLD
    call(pg.ForceProblem, mu=np.array([0.7, 0.7, 0.7]))
    call(pg.ForceProblem.holding, mu=np.array([0.7, 0.7, 0.7]))

    def build_and_solve(**settings):
        return pg.optimize_forces(pg.ForceProblem(**settings), 0.9)

    call(build_and_solve, "ForceProblem, optimize_forces", **CALLS["ForceProblem"][1])
    for method in "with_load normal_force_range depth_per_acceleration checked_impact_time energy energy_terms".split():
        call(getattr(w.problem, method))
    call(w.problem.acceleration)
    call(w.problem.normal_force, acceleration=[0.1, 0.2, 0.3])
    call(w.problem.binding_bound, contact=1)
    call(w.problem.forces, multipliers=np.zeros((3, 2)))
    call(w.problem.residual)
    call(w.problem.scaled_norm, wrench=np.ones(6))
    call(w.problem.support, direction=np.ones(6))
    limits = {name: getattr(w.torques, name) for name in ("bias", "limit", "joints")}
    call(pg.TorqueLimits, jacobian=w.torques.jacobian, **limits)
    call(w.torques.torques)
    call(pg.torque_limits)
    call(pg.GridSpec, impact_times=[0.9], accelerations=[0.1, 0.3], multipliers=[-0.5, 0.0, 0.5], residual_limit=0.1)
    for method in (w.grid.cells, w.grid.points):
        call(method, k=3)
    call(forces.grid_values, start=0.0, stop=1.0, step=0.1)
    call(pg.grid_search, problem=w.paper, search="hybrid", method="pruned", solver="daqp")
    rounded = [9.8, 6.3, 4.7]
    call(forces.refine_multipliers, problem=w.paper, normal_forces=rounded, solver="daqp")
    call(forces.MultiplierQP, problem=w.paper, normal_forces=rounded)
    call(forces.MultiplierQP(w.paper, rounded).solve)
    call(pg.optimize_forces, objective={"work": 1.0, "least_squares": 1e-4})
    call(pg.optimize_forces, "optimize_forces by name", objective="peak", solver="clarabel")
    call(pg.optimize_grasp, gap=1e-3)
    call(pg.ForceSolver, solver="clarabel")
    call(pg.ForceSolver(w.problem, 0.9, solver="clarabel").solve)
    qp, socp = forces.to_qp(w.paper, 0.9, objective="least_squares"), forces.to_socp(w.problem, 0.9, objective="work")
    call(forces.to_qp, problem=w.paper, objective="least_squares")
    call(forces.to_socp, objective={"work": 1.0, "peak": 0.1})
    call(qp.solution, x=np.ones(len(qp.q)), y=np.ones(len(qp.b)), z=np.ones(len(qp.h)), settle=False)
    call(socp.solution, x=np.ones(len(socp.q)), z=np.ones(len(socp.b)), settle=True)
    call(qp.forces, x=np.ones(len(qp.q)))
    call(socp.torsion, x=np.ones(len(socp.q)))
    for function in (pg.diagnose, pg.grasp_margins, forces.force_sensitivity):
        call(function)
    call(forces.disturbance_margin, direction=w.problem.load, impact_time=None)
    call(forces.disturbance_margin, "disturbance_margin at a time", direction=w.problem.load, normal_forces=None)
    call(pg.force_closure, friction=pg.Friction())
    call(pg.forces.min_weight)
    call(pg.LoadSet, loads=w.loads.loads, ball=0.1)
    call(pg.LoadSet.around, box=[0.1, 0.1, 0.1, 0, 0, 0], ball=0.1, mass_range=(0.9, 1.1))
    call(pg.optimize_robust, load_set=w.loads, impact_time=0.85, mu_range=(0.65, 0.8))
    errors = {"friction": 0.1, "load": 0.1, "disturbance": np.zeros(6), "points": 1e-3, "normals": 0.05}
    call(forces.holding_probability, **errors, count=20)
    call(forces.holding_probability(w.problem, 0.9, count=50).squeeze, share=0.9)
    call(forces.optimize_contacts, reach=1e-3)
    k = len(w.contacts)
    call(
        pg.ForceBatch,
        points=np.tile(w.contacts.points_o - w.contacts.com_o, (2, 1, 1)),
        rotations=np.tile(w.contacts.rotations_oc, (2, 1, 1, 1)),
        loads=np.tile(w.problem.load, (2, 1)),
        low=np.zeros((2, k)),
        high=20.0,
        counts=np.array([k, k]),
        friction=pg.Friction(),
        moment_lengths=np.array([0.03, 0.03]),
        energies={"work": np.array([[0.1, 1.5]])},
    )
    call(pg.ForceBatch.of, problems=[w.problem, w.problem], impact_times=[0.9, 0.85])
    call(pg.solve_batch, batch=w.batch, threads=1)


def _add_actuation(call: Callable) -> None:
    from pinograsp import actuation, motion

    w = WORLD
    k, n = len(w.contacts), w.hand.n
    yielding = actuation.CompliantHand.at(w.contacts, w.torques.jacobian, gains=np.full(n, 5.0))
    call(actuation.CompliantHand, jacobian=np.array(yielding.jacobian), turning=np.array(yielding.turning))
    call(actuation.CompliantHand.at, jacobians=np.array(w.torques.jacobian))
    call(actuation.contact_stiffness)
    held = {"grasp_map": np.array(w.contacts.G), "stiffness": 1e3 * np.eye(3 * k), "hand": yielding}
    call(actuation.quasistatic_maps, **held)
    curved = {"object_curvature": 100.0, "hand_curvature": 80.0, "torsional_stiffness": 0.1}
    call(actuation.object_stiffness, **held, **curved, joint_preload=np.zeros((n, n)))
    squeeze = {"hand": yielding, "factors": [0.2, 20.0]}
    call(actuation.force_band, **squeeze)
    call(actuation.gains_within, **squeeze, tolerance=0.3)
    call(motion.preload_slope)


def _add_plans(call: Callable) -> None:
    from pinograsp import motion, synthesis

    w = WORLD
    call(pg.MotionSpec, acceleration_at_start="rest")
    call(motion.contact_postures, reference=w.finger_angles)
    call(pg.motion.plan_motion, spec=w.spec)

    def build_and_plan(**settings):
        return pg.motion.plan_motion(w.hand, w.solution, pg.MotionSpec(**settings))

    call(build_and_plan, "MotionSpec, plan_motion", **CALLS["MotionSpec"][1])
    call(pg.OnlineForces, normal_forces=(0.1, 20.0), max_rate=100.0, ramp=0.1, period=1e-3, max_steps=50)
    poses = np.tile(np.eye(4), (len(w.contacts), 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = w.contacts.rotations_oc, w.contacts.points_o
    call(w.online.step, poses=poses, mu=np.array([0.7, 0.7, 0.7]))
    call(w.online.engage, contact="thumb", touches=True)
    options = pg.PlanOptions(objective="work", motion=w.spec)
    call(pg.plan_grasp, options=options)
    gridded = {"grid": w.grid, "search": "hybrid", "solver": "daqp", "objective": None, "motion": w.spec}
    call(pg.PlanOptions, **gridded)
    call(pg.plan_grasp, "plan_grasp on a grid", problem=w.paper, options=pg.PlanOptions(**gridded))
    call(pg.plan_grasp_on, body=w.closure, options=options)
    call(pg.GraspConditions, max_normal_force=20.0, torque_limit="effort")
    call(w.conditions.problem)
    call(synthesis.find_grasps, body=w.ball, count=1)
    call(synthesis.hold, closure=w.closure)


def _add_hands(call: Callable) -> None:
    from pinograsp import hands
    from pinograsp.hands import dh

    hand = WORLD.hand
    call(hand.configuration, angles=WORLD.finger_angles)
    for method in (hand.finger, hand.finger_mass, hand.is_prismatic, hand.ratio):
        call(method)
    call(hand.frame_id, name=hand.fingers[0].tip)
    call(hand.frame_placements, names=[hand.fingers[0].tip])
    call(hand.placed)
    call(hand.with_limits, limits={hand.joint_names[0]: (-0.5, 0.5)})
    moved = {"joints": hand.joint_names[:2], "arms": (0.01, 0.02)}
    drive = {"name": "d", **moved, "control": "position", "limit": 3.0, "stiffness": 2.0, "damping": 0.1}
    spring = {"joint": hand.joint_names[0], "stiffness": 0.1, "rest": 0.2}
    call(hands.Drive, **drive)
    call(hands.Spring, **spring)
    call(hand.with_drives, drives=[hands.Drive(**drive)], springs=[hands.Spring(**spring)])
    call(hand.fingers[0].joint_of, link=hand.fingers[0].links[0])
    jaw = "panda_finger_joint1"
    actuators = {
        "drives": [hands.Drive(name="d", joints=(jaw,), arms=(1.0,))],
        "springs": [hands.Spring(joint=jaw, stiffness=1.0)],
    }
    call(pg.load_hand, source="panda", limits={jaw: (0.0, 0.03)}, posture=None, **actuators)
    link = {"joint": "j", "link": "l", "d": 0.0, "a": 0.03, "alpha": 0.0, "lower": -1.0, "upper": 1.0, "phalanx": None}
    call(dh.Link, **link)
    finger = dh.FingerDescription(name="f", base=np.eye(4), links=(dh.Link(**link),))
    call(dh.FingerDescription, name="f", base=np.eye(4), links=(dh.Link(**link),), metacarpal=None)
    call(finger.frames, q=[0.1])
    call(dh.HandDescription, name="h", fingers=(finger,), density=1000.0, effort=1.0, velocity=1.0, notes="")


def _add_files(call: Callable) -> None:
    from pinograsp import handover, report, storage
    from pinograsp.cases import builtin_cases
    from pinograsp.sweep import load_sweep
    from pinograsp.viz import checks, figures
    from pinograsp.writing import write_file

    w = WORLD
    call(pg.load_case, source="paper", changes={"forces.search": "convex", "friction.mu": 0.7})
    call(pg.load_case, "load_case, lines", source="paper", texts=["forces.search=convex"])
    for method in (w.case.make_contacts, w.case.make_problem, builtin_cases):
        call(method)
    call(load_sweep, source={"case": "paper", "over": {"friction.mu": [0.6, 0.7]}, "set": {"forces.search": "convex"}})
    call(handover.joint_trajectory, start=w.q, lead=0.5, blend=0.02)
    trajectory = handover.joint_trajectory(w.plan, rate=100.0)
    call(trajectory.at, times=[0.1, 0.2])
    call(trajectory.to_csv, path="motion.csv")
    call(trajectory.to_ros2, path="motion.yaml", frame="world")
    call(trajectory.to_mujoco, path="motion.xml", model=None, prefix="")
    servo = {"stiffness": 5.0, "damping": np.full(w.hand.n, 0.1), "shortfall": 0.05}
    call(handover.drive_commands, command="impedance", start=w.q, **servo)
    for name, export, arguments in (
        ("", w.plan.to_csv, {"path": "plan.csv", "followers": False}),
        (
            "",
            w.plan.to_ros2,
            {"path": None, "followers": False, "effort": True, "goal": True, "frame": "", "start": w.q},
        ),
        ("", w.plan.to_mujoco, {"path": "plan.xml", "feed_forward": True, "prefix": "hand_"}),
        (" of drives", w.plan.to_csv, {"path": "drives.csv", "command": "position", "stiffness": 5.0}),
        (" of drives", w.plan.to_ros2, {"path": "drives.yaml", "command": "torque", "goal": True}),
        (" of drives", w.plan.to_mujoco, {"path": "drives.xml", "command": "torque"}),
        (", scene", w.plan.to_mujoco, {"path": "s.xml", "scene": True, "command": "impedance", "hold": 0.1, **servo}),
    ):
        call(export, export.__qualname__ + name, rate=100.0, **arguments)
    target = handover.JointTarget(joint="j", position=0.01, closed=0.0, effort=3.0, follows=False)
    widths = {"coordinate": 0.02, "width": 0.02, "touch_width": 0.021}
    jaw = handover.JawCommand(
        drive="jaws",
        **widths,
        touch_speed=0.1,
        other_width=5e-3,
        effort=3.0,
        jaw_force=3.0,
        total_force=6.0,
        joints=(target,),
    )
    call(handover.gripper_message, jaws=[jaw], path="grip.yaml", followers=True, frame="world")
    call(handover.write_jaws, jaws=[jaw], path="jaws.csv")
    call(handover.read_csv, path="kept/motion.csv")
    call(handover.read_ros2, path="kept/motion.yaml")
    call(pg.save_run, plan=w.run, folder="run")
    call(pg.load_run, folder="kept/run")
    for function in (storage.newest_check, storage.read_check):
        call(function, folder="absent")
    call(write_file, path="file", content=b"abc")
    call(report.report_plan, plan=w.run)
    call(report.write_report, run=w.run, folder=".")
    for figure in (figures.joint_angles, figures.contact_forces, figures.friction_use, figures.wrench_margin):
        call(figure, plan=w.run)
    call(figures.joint_torques, plan=w.run, finger="thumb")
    table = {"mu": [0.6, 0.6, 0.7, 0.7], "mass": [1.0, 2.0] * 2, "energy": [1.0, 2.0, 3.0, 4.0], "status": ["ok"] * 4}
    call(figures.sweep_map, columns=table, value="energy", x="mu", y="mass")
    for figure in (checks.forces_beside_plan, checks.object_motion):
        call(figure, simulation=w.simulation)


def _add_checks(call: Callable) -> None:
    from pinograsp import simulation

    w = WORLD
    n = w.hand.n
    push = {"wrench_o": [0, 0, -0.5, 0, 0, 0], "start": 0.2, "duration": 0.1}
    call(simulation.Push, **push)
    call(simulation.BaseMotion, times=[0.0, 0.02], accelerations=np.zeros((2, 3)))
    motion = simulation.BaseMotion(times=[0.0, 0.02], accelerations=np.zeros((2, 3)))
    call(motion.at, since=0.01)
    call(simulation.BaseMotion.through, times=[0.0, 0.02], positions=np.zeros((2, 3)))
    disturbance = {
        **dict(pushes=(simulation.Push(**push),), shake=[0.1, 0.0, 0.0], shake_frequency=3.0, mu=0.65, mass_factor=1.1),
        **dict(object_offset=[1e-4, 0.0, 0.0], object_turn=[0.0, 0.01, 0.0], start_error=np.zeros(n), stiffness=2.0),
        **dict(base_motion=motion, joint_offset=1e-4, joint_friction=np.full(n, 1e-4), servo_gain=1.1),
    }
    call(simulation.Disturbance, **disturbance)
    call(simulation.Disturbance(**disturbance).wrench, since_release=0.01)
    call(simulation.Disturbance(**disturbance).acceleration, since=0.01)
    call(simulation.Servo, stiffness=np.ones(n), damping=np.ones(n), rotor=np.zeros(n))
    call(simulation.Servo.of, stiffness=50.0, damping=0.5, control="position")
    call(simulation.Servo.of(w.hand).scale_gains, factor=1.1)
    errors = {
        **dict(position=2e-3, rotation=0.03, friction=(0.05, 0.1), mass=0.1, posture=0.01, push=0.2, servo_gain=0.1),
        **dict(stiffness=(0.5, 2.0), joint_offset=0.01, joint_friction=0.01),
    }
    call(simulation.Errors, **errors)
    quick = {"hold": 0.01, "time_step": 2e-3}
    servo = {"mode": "servo", "disturbance": simulation.Disturbance(), "servo": simulation.Servo.of(w.hand)}
    call(pg.simulate, **quick, **servo, sample=5e-3, letting_go=0.01)
    call(simulation.monte_carlo, count=1, errors=simulation.Errors(), hold=0.31, time_step=2e-3)
    for threshold in (simulation.slip_threshold, simulation.load_threshold):
        call(threshold, tolerance=1.0, planned=0.7, disturbance=None, **quick)
    call(simulation.what_holds, disturbance=simulation.Disturbance(mu=0.0), tolerance=1.0, **quick)


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


def _nest(depth: int) -> list:
    value = [1.0]
    for _ in range(depth):
        value = [value]
    return value


def _contain_itself() -> list:
    value = [1.0]
    value.append(value)
    return value


NUMBERS = [
    *material.NUMBERS,
    *(-(10**400), fractions.Fraction(1, 3), fractions.Fraction(10**400, 3), np.float32(0.5), np.float64("nan")),
    *(np.int8(-3), np.uint64(2**63), np.longdouble("1e4000"), Number(0.5), Level.LOW, np.array(0.5), np.float16(65504)),
]
# Never a number, nor numbers in an array.
NOT_NUMBERS = [
    *(True, False, np.True_, 1j, 1 + 0j, np.complex128(2), "abc", "", "0.5", "nan", "1", Text("0.5"), b"0.5"),
    *(bytearray(b"1"), "x" * 100_000, "\0", "é…", datetime.datetime(2020, 1, 1), datetime.timedelta(1)),
    *(np.datetime64("2020-01-01"), np.timedelta64(5, "s"), np.datetime64("NaT"), object(), object, float, len),
    *(Ellipsis, NotImplemented, types, Shy()),
    *(Path("x"), {1.0}, frozenset({1.0, 2.0}), set(), {}, {"a": 1.0}, {0: 1.0, 1: 2.0}, UserDict(a=1)),
    *(OrderedDict(b=2), types.MappingProxyType({"c": 3}), ValueError("x"), np.ma.masked, slice(3), memoryview(b"abc")),
    *(np.dtype(float), np.array("0.5"), np.array(1j), np.array(True), np.array(None), np.str_("1"), Shy, math, print),
    np.array("2020-01-01", dtype="M8[D]"),
]
# Neither a number nor, by their values, an array of finite numbers.
NOT_ARRAYS = [
    *(np.ones(3, dtype=complex), np.ones((3, 3)) * 1j, np.array(["1", "2", "3"]), np.array([b"1", b"2"])),
    *(np.array([True, False, True]), np.array([None, 1.0, 2.0]), np.array(["2020", "2021", "2022"], dtype="M8[Y]")),
    *(np.zeros(3, dtype="m8[s]"), np.zeros(3, dtype="i4,f8"), np.full(3, np.nan), np.array([1.0, np.inf, 2.0])),
    *(np.ma.masked_array([1.0, 2.0, 3.0], mask=[0, 1, 0]), np.full((3, 3), np.inf), [np.nan] * 6),
    *([1.0, "a", 2.0], ["1", "2", "3"], [[1, 2], [3]], [None, None, None], [{}], [1j, 2, 3], [object()] * 3),
    *(_nest(70), _nest(5000), _contain_itself(), ["x" * 1000] * 1000, [10**400, 1, 2], [True, False, True]),
    *([1.0, [2.0, 3.0]], [datetime.date(2020, 1, 1)] * 3, [Shy()] * 3, [decimal.Decimal("NaN")] * 3),
    *(Column(["a", "b", "c"]), Column([1j, 2, 3]), Column([np.nan] * 3)),
]
ARRAYS = [
    *([], (), [[]], np.zeros(0), np.zeros((0, 3)), np.zeros((3, 0)), np.zeros((2, 0, 3)), Column([]), range(0)),
    *(np.ones(1), np.ones(3), np.ones(6), np.zeros(3), np.zeros(6), np.ones((3, 3)), np.ones((2, 3)), np.ones((3, 2))),
    *(np.ones((4, 4)), np.eye(4), -np.eye(4), np.eye(3)[::-1], np.ones((1, 1, 1, 1, 1)), np.arange(20.0), np.zeros(20)),
    *(np.full(3, 1e308), np.full(6, 1e308), np.full(3, 1e-320), np.full(6, -1e200), np.full((3, 3), 1e308)),
    *([1, 2], [1, 2, 3], (1.0, 2.0), (2.0, 1.0), (0.0, 0.0), (-1.0, 1.0), [2**63, 1, 1], [10**30, 1, 1], range(3)),
    *(array.array("d", [1, 2, 3]), Pair(1.0, 2.0), Column([1.0, 2.0, 3.0]), np.ones(3).view(Numbers)),
    *(np.asmatrix(np.ones((1, 3))), np.ma.masked_array([1.0, 2.0, 3.0]), np.ones(3, dtype=np.float16)),
    *(np.ones(3, dtype=">f8"), np.arange(3, dtype=np.int8), np.broadcast_to(1.0, (3,)), np.ones((6, 2))[:, 0]),
    *(np.ones(10_000), np.broadcast_to(1.0, (1000, 3)), np.ones((100, 100))),
    *([decimal.Decimal("0.5")] * 3, [fractions.Fraction(1, 2)] * 3),
]
STREAMS = [
    lambda: (float(i) for i in range(3)),
    lambda: iter([1.0, 2.0]),
    lambda: map(float, [1, 2, 3]),
    lambda: {"a": 1}.keys(),
    lambda: zip([1], [2]),
]
WORDS = [*material.NAMES, *material.UNWRITABLE, *"wrench work daqp thumb THUMB index cone paper auto".split(), "thumb "]


def _draw_strange(rng) -> object:
    w = WORLD
    ours = [
        *vars(w).values(),
        *(pg.Friction(), pg.MarhefkaOrin(), pg.Status.OK, pg.MotionSpec(), pg.Friction, pg.Sphere),
        *(w.contacts[0], w.contacts.contacts),
    ]
    pools = [NUMBERS, NOT_NUMBERS, NOT_ARRAYS, ARRAYS, WORDS, ours, STREAMS, [None]]
    pool = pools[rng.choice(len(pools), p=[0.25, 0.2, 0.15, 0.15, 0.08, 0.1, 0.03, 0.04])]
    value = pick(rng, pool)
    return value() if pool is STREAMS else value


def _change_number(rng, value: float):
    turns = [
        *(-value, 0.0, value + 1, value * 1e6, value * 1e-6, value * 1e30, value * 1e300, math.nan, bool(value)),
        *(int(value), str(value), complex(value), np.float32(value), decimal.Decimal(value), [value]),
        *(np.array(value), np.array([value]), np.ma.masked_array(value, mask=True)),
    ]
    return pick(rng, turns)


def _change_array(rng, value):
    a = np.array(value, dtype=float)
    flat = a.ravel()
    at = rng.integers(a.size) if a.size else 0

    def changed(number):
        b = a.copy()
        if b.size:
            b.ravel()[at] = number
        return b

    turns = [
        *(partial(changed, number) for number in (np.nan, np.inf, 1e308, 1e-320, 0.0, 10.0 ** rng.uniform(-12, 12))),
        *(partial(a.astype, kind) for kind in (complex, str, object, bool, int, "f4", "S8", ">f8")),
        *(a.tolist, a.ravel, partial(np.asfortranarray, a), partial(np.full, a.shape, None)),
        *(
            lambda: changed(-flat[at] if a.size else 0),
            lambda: a * 1e200,
            lambda: a * 1e-200,
            lambda: -a,
            lambda: 0 * a,
        ),
        *(lambda: a + 0.1, lambda: a + rng.normal(size=a.shape), lambda: a + 1e-3 * rng.normal(size=a.shape)),
        *(lambda: a.T, lambda: a[None], lambda: a[:-1], lambda: a[..., :-1], lambda: a[..., None], lambda: a[::-1]),
        *(lambda: a[:0], lambda: a[0] if a.ndim else a, lambda: np.concatenate([a, a]), lambda: a.view(Numbers)),
        *(lambda: Column(a) if a.ndim else a, lambda: [*a.tolist(), "x"] if a.ndim else a),
        lambda: np.ma.masked_array(a, mask=np.arange(a.size).reshape(a.shape) == at),
    ]
    return pick(rng, turns)()


def _change_mapping(rng, value: Mapping):
    changed = dict(value)
    key = list(changed)[rng.integers(len(changed))] if changed else "a"
    turn = rng.integers(9)
    if turn == 0:
        changed[_draw_key(rng)] = changed.get(key)
    elif turn == 1:
        changed.pop(key, None)
    elif turn < 6:
        changed[key] = _spoil(rng, changed.get(key))
    elif turn == 6:
        changed = {_draw_key(rng) if name == key else name: v for name, v in changed.items()}
    elif turn == 7:
        return pick(rng, [UserDict, types.MappingProxyType, OrderedDict])(changed)
    elif all(isinstance(key, str) for key in changed):
        return pick(rng, [list(changed), list(changed.items()), list(changed.values()), tuple(changed), set(changed)])
    else:
        return list(changed)
    return changed


def _draw_key(rng):
    keys = ["nobody", "", 0, 1.5, None, (), b"thumb", True, math.nan, "thumb", "x" * 1000, Path("a"), frozenset()]
    return pick(rng, [*keys, Shy(), "little"])


def _change_items(rng, value):
    items = list(value)
    turn = rng.integers(8)
    if turn == 0:
        return items[:-1]
    if turn == 1:
        return items + items
    if turn == 2 and items:
        items[rng.integers(len(items))] = _draw_strange(rng)
    elif turn == 3:
        return [*items, _draw_strange(rng)]
    elif turn == 4:
        return iter(items)
    elif turn == 5 and items:
        return items[0]
    elif turn == 6 and items:
        items[rng.integers(len(items))] = _spoil(rng, items[0])
    elif turn == 7:
        return dict(enumerate(items))
    return type(value)(items) if type(value) in (tuple, list) else items


def _spoil(rng, value):
    """Something else instead of a valid value: half of the time a mutation of it."""
    if rng.random() < 0.5:
        return _draw_strange(rng)
    if isinstance(value, bool):
        return pick(rng, [0, 1, "no", "False", None, np.False_, 0.0, [], np.array([True, False])])
    if isinstance(value, (int, float)):
        if rng.random() < 0.7:
            return _change_number(rng, float(value))
        return pick(rng, [value + 1, value - 1, -value, 10**9, 10**6, float(value)])
    if isinstance(value, str):
        turns = [value.upper(), value + " ", value[:-1], value * 1000, value + "\0", value[::-1]]
        return pick(rng, [*turns, value.encode(), Text(value), Path(value), [value], np.str_(value)])
    if isinstance(value, np.ndarray) or _is_numbers(value):
        return _change_array(rng, value)
    if isinstance(value, Mapping):
        return _change_mapping(rng, value)
    if isinstance(value, (list, tuple)):
        return _change_items(rng, value)
    return _draw_strange(rng)


def _is_numbers(value) -> bool:
    return (
        isinstance(value, (list, tuple))
        and bool(value)
        and np.asarray(value, dtype=object).dtype == object
        and all(isinstance(v, (int, float)) or _is_numbers(v) for v in value)
    )


def _is_never_meant(valid, value) -> bool:
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
        return _is_among(value, NOT_NUMBERS[:30]) or isinstance(
            value, (str, bytes, bool, np.bool_, complex, np.datetime64, np.timedelta64, set, np.str_)
        )
    if isinstance(valid, np.ndarray) or _is_numbers(valid):
        if isinstance(value, np.ndarray) and value.size:
            if value.dtype.kind in "cSUbMmV" or np.ma.is_masked(value):
                return True
            return value.dtype.kind == "f" and not np.isfinite(value).all() and not np.isposinf(value).any()
        return _is_among(value, NOT_ARRAYS) or isinstance(value, (str, bytes, bool, complex, set, types.GeneratorType))
    if isinstance(valid, str):
        return isinstance(value, (bytes, bool, int, float, complex, list, set, np.ndarray))
    return False


def _is_among(value, pool) -> bool:
    return any(value is one for one in pool)


# The kind.

# Where infinity stands for something, or a number for a text; and the settings of a closure that has too few contacts
# for anything to be asked of them.
MEANT = {
    *(("GraspConditions", "torque_limit"), ("TorqueLimits", "limit"), ("torque_limits", "limit")),
    *(("hold", "mu"), ("hold", "torque_limit"), ("hold", "impact_time"), ("OnlineForces.engage", "contact")),
    *(("CompliantHand", "gains"), ("CompliantHand", "joint_stiffness")),
    *(("CompliantHand.at", "gains"), ("CompliantHand.at", "joint_stiffness")),
    # What a command or a scene does not use is not looked at.
    *(
        (f"GraspPlan.to_mujoco{what}", name)
        for what in (" of drives", ", scene")
        for name in ("feed_forward", "prefix")
    ),
    *(("object_stiffness", "object_curvature"), ("object_stiffness", "hand_curvature")),
}


# Calls that take a second: fewer of them.
SLOW = set(
    """
    gains_within holding_probability plan_grasp plan_grasp_on simulate monte_carlo slip_threshold load_threshold
    what_holds OnlineForces find_grasps
    """.split()
)


def make(rng: np.random.Generator, folder: Path) -> Case:
    """One call with one to three arguments spoiled."""
    names = list(CALLS)
    name = pick(rng, names)
    if name in SLOW and rng.random() < 0.7:
        name = pick(rng, names)
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
        arguments[argument] = _draw_argument(rng, name, argument, valid[argument])
    return Case(name, arguments, spoiled)


# What may stand where a call has None, by the type that its hint names first.
EXAMPLES = {float: 0.1, int: 1, bool: True, str: "abc", np.ndarray: np.ones(3)}


def _draw_argument(rng, call: str, name: str, valid):
    if valid is None:
        with contextlib.suppress(NameError, TypeError):  # hints that only a type checker can look up
            hint = typing.get_type_hints(CALLS[call][0]).get(name)
            valid = next((EXAMPLES[kind] for kind in typing.get_args(hint) if kind in EXAMPLES), None)
    value = _spoil(rng, valid)
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
        if _is_never_meant(valid[name], case.arguments[name]) and (case.call, name) not in MEANT:
            raise AssertionError(f"accepted {name}={reprlib.repr(case.arguments[name])}")
    _check(result, case.call, 4)
    return "accepted"


# Where NaN stands for what is not known.
UNKNOWN = {"servo_stiffness"}


def _check(value, where: str, depth: int) -> None:
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
            _check(item, f"{where}[{key!r}]", depth - 1)
    elif isinstance(value, (tuple, list)):
        for i, item in enumerate(value[:20]):
            _check(item, f"{where}[{i}]", depth - 1)
    elif type(value).__module__.startswith("pinograsp.") and is_dataclass(value):
        for field in fields(value):
            if not field.name.startswith("_"):
                _check(getattr(value, field.name), f"{where}.{field.name}", depth - 1)
        for name, _kind in inspect.getmembers(type(value), lambda member: isinstance(member, property)):
            if not name.startswith("_") and name not in UNKNOWN:
                try:
                    _check(getattr(value, name), f"{where}.{name}", depth - 1)
                except PinograspError:
                    continue
        for name in ("describe", "explain", "summary"):
            if depth > 2 and callable(getattr(value, name, None)):
                getattr(value, name)()


if os.environ.get("MPLBACKEND") is None:
    os.environ["MPLBACKEND"] = "Agg"
