"""Rest of a grasp after the object is let go, and hands that press so that the planned forces are left."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings, strategies as st
from random_grasps import contact_set_of, random_grasp
from scipy.optimize import brentq

import pinograsp as pg
from pinograsp.contacts import PALM
from pinograsp.errors import Status
from pinograsp.forces import ForceProblem
from pinograsp.hands import servo_gains
from pinograsp.motion import surfaces
from pinograsp.motion.contact_springs import TANGENTIAL, Capped, Contacts, Servos
from pinograsp.motion.letting_go import Pressed, friction_built_up, let_go
from pinograsp.planner import plan_best
from pinograsp.simulation import Servo

MU, WEIGHT = 0.5, 2.0


def pinched(torsion: float = 0.0) -> ForceProblem:
    """Two contacts that face each other along x, 30 mm from the centre of mass."""
    contacts = contact_set_of([[0.03, 0, 0], [-0.03, 0, 0]], [[-1.0, 0, 0], [1.0, 0, 0]])
    return ForceProblem(
        contacts=contacts, load=[0, 0, -WEIGHT, 0, 0, 0], mu=MU, friction=pg.Friction(torsion=torsion), max_depth=5e-3
    )


def held_by(friction, joints: int = 0) -> Pressed:
    """Contacts before the object is let go, by joints that have not given way."""
    return Pressed(friction, np.zeros(joints))


def test_friction_builds_up_to_the_cone():
    problem = pinched()
    depth = problem.compliance.depth(np.array([4.0, 4.0]))
    course = np.linspace(0, 1, 9)[:, None]
    slid = np.zeros((9, 2, 4))
    slid[:, 0, 1] = 1e-3 * course[:, 0]  # slides on
    slid[:, 1, 2] = 1e-5 * course[:, 0]  # sticks in the end: 0.2 N are within its cone
    friction = friction_built_up(problem, course * depth, slid).friction
    assert friction[0] == pytest.approx([0.0, MU * 4.0, 0.0, 0.0], abs=1e-9)
    assert friction[1] == pytest.approx([0.0, 0.0, TANGENTIAL * 1e-5, 0.0], rel=0.1)
    assert np.all(friction_built_up(problem, course * depth, np.zeros((9, 2, 4))).friction == 0)


def test_an_object_between_two_fingers_sinks_on_its_springs():
    problem = pinched()
    depth = problem.compliance.depth(np.array([4.0, 4.0]))
    rest = let_go(problem, depth, held_by(np.zeros((2, 4))))
    assert rest.shift[:3] == pytest.approx([0, 0, -WEIGHT / (2 * TANGENTIAL)], abs=1e-12)
    assert rest.normal == pytest.approx([4.0, 4.0]) and rest.friction[:, :3] == pytest.approx(
        np.array([[0, 0, 1.0], [0, 0, 1.0]]), abs=1e-6
    )


def test_what_cannot_rest_is_told():
    """A squeeze that holds no more than half the weight: whatever forces are left over, they are no rest."""
    problem = pinched()
    held, lost = (
        let_go(problem, problem.compliance.depth(np.full(2, F)), held_by(np.zeros((2, 4)))) for F in (2.1, 1.0)
    )
    assert held.balanced and not lost.balanced


def test_unequal_depths_give_each_other_way():
    """Two springs in series: delta_1 + delta_2 stays, and the forces are equal."""
    problem = pinched()
    depth = np.array([2e-3, 1e-3])
    rest = let_go(problem, depth, held_by(np.zeros((2, 4))))
    force = problem.compliance.normal_force(1.5e-3)
    assert rest.normal == pytest.approx([force, force], rel=1e-5)
    assert abs(rest.shift[0]) == pytest.approx(0.5e-3, rel=1e-5)


@settings(max_examples=40)
@given(st.integers(0, 2**32 - 1), st.sampled_from(["cone", "soft"]))
def test_at_rest_the_contacts_balance_the_load_within_their_cones(seed, family):
    """Of random grasps with a reserve of friction: forces as planned stay, others find another rest."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(3, 6))
    grasp = random_grasp(seed, family=family, k=k, torques=False, degenerate="", load="plain")
    problem = replace(grasp.problem, balance="wrench", friction=replace(grasp.problem.friction, safety=1.4))
    solution = pg.optimize_forces(problem, grasp.impact_time)
    assume(solution.status is Status.OK)
    depth, rotations = solution.profile.final_depth, problem.contacts.rotations_oc
    planned, normals = np.einsum("kij,kj->ki", rotations, solution.forces_c), rotations[:, :, 2]
    across = planned - (planned * normals).sum(axis=1, keepdims=True) * normals
    friction = np.column_stack([across, solution.torsion if solution.torsion.size else np.zeros(k)])
    rest = let_go(problem, depth, held_by(friction))
    assert rest.normal == pytest.approx(solution.normal_forces, rel=1e-6)
    assert rest.friction == pytest.approx(friction, abs=1e-6 * rest.normal.sum())
    rest = let_go(problem, depth * rng.uniform(0.98, 1.02, k), held_by(0.9 * friction))
    forces = rest.normal[:, None] * normals + rest.friction[:, :3]
    arms = problem.contacts.points_o - problem.contacts.com_o
    moment = np.cross(arms, forces).sum(axis=0) + rest.friction[:, 3] @ normals + problem.load[3:]
    enough = 1e-4 * rest.normal.sum()
    assert np.abs(forces.sum(axis=0) + problem.load[:3]).max() < enough
    assert np.abs(moment).max() < enough * np.abs(arms).max()
    assert np.all(np.linalg.norm(rest.friction[:, :3], axis=1) <= problem.mu * rest.normal * (1 + 1e-9))
    assert np.all(np.abs(rest.friction[:, 3]) <= problem.friction.torsion * rest.normal * (1 + 1e-9))


def test_its_stiffness_is_the_slope_of_the_wrench():
    problem, rng = pinched(torsion=0.01), np.random.default_rng(4)
    contacts = Contacts(problem, problem.compliance.depth(np.array([4.0, 5.0])), servos=servos_of(rng, 3))
    stretched = np.array([[0.0, 3e-4, 1e-4, 0.05], [0.0, 1e-5, 0.0, 1e-4]])  # the first one slips, the second sticks
    shift, since = 1e-6 * rng.normal(size=9), np.zeros(9)
    now = contacts.at(shift, since, stretched)
    step = 1e-9
    slope = [(contacts.at(shift + step * e, since, stretched).left - now.left) / step for e in np.eye(9)]
    scale = np.abs(now.stiffness).max()
    assert pytest.approx(now.stiffness, abs=2e-3 * scale) == -np.array(slope).T


def test_the_energy_falls_along_what_is_left():
    """Of contacts with fixed limits of friction, what is left is the slope of the energy, and stiffness its own."""
    problem, rng = pinched(torsion=0.01), np.random.default_rng(5)
    contacts = Contacts(problem, problem.compliance.depth(np.array([4.0, 5.0])), servos=servos_of(rng, 3))
    stretched, normal = np.array([[0.0, 3e-4, 1e-4, 0.05], [0.0, 1e-5, 0.0, 1e-4]]), np.array([3.0, 6.0])
    y, since, step = 1e-6 * rng.normal(size=9), np.zeros(9), 1e-7

    def beside(way: float, e: np.ndarray) -> Capped:
        return Capped(contacts, contacts.displace(since, stretched), y + way * e, normal)

    slope = [(beside(step, e).energy - beside(-step, e).energy) / (2 * step) for e in np.eye(9)]
    assert beside(0, np.eye(9)[0]).left == pytest.approx(-np.array(slope), rel=1e-5, abs=1e-6)
    bend = [(beside(step, e).left - beside(-step, e).left) / (2 * step) for e in np.eye(9)]
    stiffness = beside(0, np.eye(9)[0]).stiffness
    assert pytest.approx(stiffness, abs=2e-3 * np.abs(stiffness).max()) == -np.array(bend)


def servos_of(rng: np.random.Generator, n: int) -> Servos:
    """Of n joints under two contacts, in any direction."""
    return Servos(
        deepening=0.05 * rng.normal(size=(2, n)),
        across=0.05 * rng.normal(size=(2, 4, n)),
        stiffness=np.full(n, 2.0),
        torques=np.zeros(n),
    )


@pytest.mark.parametrize("gain", [1e2, 3e3, 1e5])
def test_a_servo_gives_way_to_what_differs_from_the_planned_force(gain):
    """A jaw that slides into the object along its normal, against a fixed one: three springs in series."""
    problem = pinched()
    law, depth, planned = problem.compliance, np.array([2e-3, 1e-3]), 4.0
    slides = Servos(
        deepening=np.array([[1.0], [0.0]]),
        across=np.zeros((2, 4, 1)),
        stiffness=np.array([gain]),
        torques=np.array([planned]),
    )
    rest = let_go(problem, depth, held_by(np.zeros((2, 4)), 1), slides)
    force = brentq(lambda F: 2 * law.depth(F) - depth.sum() - (planned - F) / gain, 0.0, 100.0, xtol=1e-12)
    assert rest.balanced and rest.normal == pytest.approx([force, force], rel=1e-5)
    # Before that the object is held: the jaw gives way to its own contact alone.
    held = friction_built_up(problem, np.array([np.zeros(2), depth]), np.zeros((2, 2, 4)), (idle(slides), slides))
    alone = brentq(lambda F: law.depth(F) - depth[0] - (planned - F) / gain, 0.0, 100.0, xtol=1e-12)
    assert held.given == pytest.approx([(planned - alone) / gain], rel=1e-4)


def idle(servos: Servos) -> Servos:
    """Before anything presses."""
    return replace(servos, torques=np.zeros(len(servos.torques)))


@pytest.mark.slow
@pytest.mark.parametrize("source", ["allegro_right", "g1_left"])
def test_hands_press_so_that_the_planned_forces_are_left(source):
    """The simulation, with the hand's servos as they are, of an object that is fixed until t_F, has the normal forces
    that are foreseen, nearly the planned.
    """
    box = pg.Box(size=(0.045, 0.045, 0.12), density=300)
    conditions = pg.GraspConditions(mu=0.6)
    found = pg.find_grasps(pg.load_hand(source), box, conditions, count=8, seed=3, jobs=1, progress=False)
    plan = plan_best(found, conditions)
    contacts = plan.problem.contacts
    pressed = surfaces.press_closed(plan.hand, plan.solution, contacts.posture, servo_gains(plan.hand))
    planned = plan.forces.normal_forces
    assert pressed.off(planned) < 0.02
    seen = pg.simulate(plan, hold=0.5, support="fixed", servo=Servo.of(plan.hand))
    assert seen.verdict.held
    joints = np.array(
        [0 if one.finger == PALM else plan.hand.finger(one.finger).joint_of(one.link) for one in contacts]
    )
    sums = {float(round(planned[joints == j].sum(), 9)): pressed.rest.normal[joints == j].sum() for j in set(joints)}
    for force, asked in zip(seen.normal_forces[-1], seen.planned_forces):
        assert force == pytest.approx(sums[float(round(asked, 9))], rel=0.06, abs=0.03)
