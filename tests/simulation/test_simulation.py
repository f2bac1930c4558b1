"""Plans simulated in MuJoCo, against the plan, closed forms, Pinocchio, and itself at other steps."""

from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import own_hands
import pinocchio as pin
import pytest

import pinograsp as pg
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.contacts import clearance, touching
from pinograsp.contacts.penetration import Penetration
from pinograsp.errors import ContactNotReached, InvalidInput, SimulationDiverged
from pinograsp.hands import servo_gains
from pinograsp.motion.surfaces import press_closed
from pinograsp.simulation import Disturbance, Push, Servo, simulate
from pinograsp.simulation.naive import naive_grasp, naive_task
from pinograsp.simulation.task import Task
from pinograsp.simulation.trials import prepare_trials, run_trial
from pinograsp.synthesis import find_grasps

SURFACE = {"forces.search": "convex", "forces.balance": "wrench", "friction.safety": 1.1, "motion.touch": "surface"}


@pytest.fixture(scope="module")
def case():
    return pg.load_case("paper", SURFACE)


@pytest.fixture(scope="module")
def plan(case):
    return case.plan()


@pytest.fixture(scope="module")
def brisk():
    """A plan of less than half a second: for what does not depend on how the hand gets there."""
    return pg.load_case("paper", SURFACE | {"limits.final_time": 0.4, "limits.impact_time": [0.2, 0.35]}).plan()


@pytest.fixture(scope="module")
def held(plan):
    return simulate(plan)


@pytest.mark.slow
def test_parts_are_in_the_order_of_the_plans_contacts(brisk):
    """Whatever order the plan has them in; what each part does belongs to its name."""
    task = Task.of(brisk)
    seen = simulate(task, hold=0.05)
    assert seen.parts == brisk.contacts.names
    assert seen.planned_forces == pytest.approx(brisk.forces.normal_forces)
    order = [2, 0, 1]
    arrays = ("points_o", "normal_forces", "settled_forces", "depths", "mu")
    named = {name: getattr(task, name)[order] for name in arrays} | {"forces_o": task.forces_o[:, order]}
    named |= {name: tuple(getattr(task, name)[i] for i in order) for name in ("names", "links")}
    turned = simulate(replace(task, **named), hold=0.05)
    assert turned.parts == tuple(seen.parts[i] for i in order)
    assert turned.normal_forces == pytest.approx(seen.normal_forces[:, order], rel=1e-6, abs=1e-6)
    assert list(turned.summary()["final_forces_N"]) == list(turned.parts)


def closed_plan(hand, body, pose, safety=1.5, **settings):
    """A hand closed on a body at a pose in the hand's frame, planned."""
    conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=safety))
    return pg.plan_grasp_on(hand, body.placed(pose), conditions, **settings)


def at(*position):
    pose = np.eye(4)
    pose[:3, 3] = position
    return pose


# -- the case study ----------------------------------------------------------------------------------------------------


def test_case_study_holds_as_planned(held):
    verdict = held.verdict
    assert verdict.held
    assert verdict.drift < 5e-4
    assert verdict.tilt < 0.5
    assert verdict.force_error < 0.03
    assert not verdict.slipped and not verdict.unplanned and not verdict.saturated
    assert verdict.energy_error < 1e-3


@pytest.mark.slow
def test_case_study_holds_for_ten_seconds(plan, often):
    """With a smaller ``--share`` for three."""
    verdict = simulate(plan, hold=max(3.0, often(10))).verdict
    assert verdict.held
    assert verdict.drift < 5e-4
    assert verdict.tilt < 0.5
    assert verdict.force_error < 0.03


@pytest.mark.slow
def test_half_the_step_gives_the_same(plan, held):
    finer = simulate(plan, time_step=held.time_step / 2)
    assert finer.verdict.held == held.verdict.held
    assert finer.normal_forces[-1] == pytest.approx(held.normal_forces[-1], rel=0.01)
    assert finer.verdict.drift == pytest.approx(held.verdict.drift, rel=0.03)


@pytest.mark.slow
def test_dropped_at_once_it_still_holds(plan):
    assert simulate(plan, letting_go=0.0).verdict.held


@pytest.mark.slow
@pytest.mark.no_cover
def test_forces_alone_in_balance_let_the_object_turn(case, held):
    forces_only = pg.load_case("paper", SURFACE | {"forces.balance": "force"}).plan()
    verdict = simulate(forces_only, time_step=5e-4).verdict
    assert verdict.tilt > 3 * held.verdict.tilt
    assert verdict.force_error > 0.1


@pytest.mark.slow
def test_tips_that_stand_for_their_links_press_less_exactly(held):
    """The paper's reading puts the tip of the axis on the point, whatever the surface around it does."""
    tips = simulate(pg.load_case("paper", SURFACE | {"motion.touch": "length"}).plan(), hold=0.1)
    assert tips.verdict.penetration_error > 2 * held.verdict.penetration_error


# -- prescribed motion -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_prescribed_joints_press_with_the_planned_forces(plan):
    simulation = simulate(plan, mode="prescribed", release=False, hold=0.0)
    order = [simulation.parts.index(name) for name in plan.problem.contacts.names]
    # Until the object is let go the joints make up for its shift.
    contacts, law = plan.problem.contacts, plan.problem.compliance
    pressed = press_closed(plan.hand, plan.solution, contacts.posture, servo_gains(plan.hand))
    assert simulation.depths[-1][order] == pytest.approx(pressed.depths[-1], abs=1e-6)
    assert simulation.normal_forces[-1][order] == pytest.approx(law.normal_force(pressed.depths[-1]), rel=1e-3)
    made = plan.forces.work * (pressed.depths[-1] ** 2.5).sum() / (plan.forces.final_depths**2.5).sum()
    assert simulation.grasp_energy == pytest.approx(made, rel=0.01)  # Eq. (9), by another program
    let_go = simulate(plan, mode="prescribed", hold=0.3)
    assert let_go.normal_forces[-1][order] == pytest.approx(plan.forces.normal_forces, rel=0.02)
    # Before anything touches, the torques that move the joints are Pinocchio's.
    early = simulation.times < 0.85
    times = simulation.times[early]
    wanted = np.array([np.interp(times, plan.motion.times, tau) for tau in plan.motion.torques.T]).T
    assert np.abs(simulation.torques[early] - wanted)[5:].max() < 2e-4


@pytest.mark.slow
def test_meshes_press_with_the_planned_forces():
    """Hulls of a real hand with its servos, by another collision library, once the object is let go and has shifted.

    Servos that give way while the hand closes, and objects that move with it, make others.
    """
    hand = pg.load_hand("hey5", hulls=True)
    conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=1.3))
    errors = []
    for seed in range(5):
        found = find_grasps(
            hand, pg.Cylinder(radius=0.02, height=0.12, mass=0.2), conditions, count=8, seed=seed, progress=False
        )
        closure = found.best.closure
        plan = pg.plan_grasp_on(closure.hand, closure, conditions)
        simulation = simulate(plan, hold=0.3, support="fixed", servo=Servo.of(closure.hand))
        off = np.abs(simulation.normal_forces[-1] - simulation.planned_forces)
        errors.append(off.max() / simulation.planned_forces.max())
    # A grasp of many contacts may not settle as foreseen.
    assert np.median(errors) < 0.02 and sorted(errors)[3] < 0.05, errors


# -- disturbances ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "wrong",
    [
        Disturbance(mu=0.25),
        Disturbance(mass_factor=3.0),
        Disturbance(pushes=(Push(wrench_o=[0, 0, -40, 0, 0, 0], start=0.1, duration=0.3),)),
        Disturbance(shake=[0, 0, 60.0], shake_frequency=3.0),
        Disturbance(object_offset=[0, 0.02, 0]),
    ],
    ids=["ice", "heavy", "pushed", "shaken", "beside"],
)
def test_what_is_too_much_is_lost(brisk, wrong):
    simulation = simulate(brisk, disturbance=wrong, hold=0.5, time_step=1e-3)
    assert not simulation.verdict.held
    assert simulation.disturbance == wrong.summary() != {}


@pytest.mark.slow
@pytest.mark.parametrize(
    "wrong",
    [
        pytest.param(Disturbance(mu=0.6), marks=pytest.mark.slow),
        pytest.param(Disturbance(mass_factor=1.05), marks=pytest.mark.slow),
        Disturbance(pushes=(Push(wrench_o=[0, 0, -0.5, 0, 0, 0]),)),
        pytest.param(Disturbance(shake=[0, 0.3, 0]), marks=pytest.mark.slow),
        Disturbance(object_offset=[2e-4, 0, 0], object_turn=[0, 0, 0.01]),
        Disturbance(start_error=np.full(20, 0.02)),
    ],
    ids=["slippery", "heavier", "nudged", "shaken", "off", "start"],
)
def test_what_is_little_is_borne(brisk, wrong):
    assert simulate(brisk, disturbance=wrong, hold=0.5, time_step=1e-3).verdict.held


# -- scene, servos, couplings ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["humanoid", "allegro_right", "psyonic_left", "panda", "g1_left"])
def test_mujoco_has_the_same_hand(name):
    import mujoco

    from pinograsp.simulation.scene import build

    hand = pg.load_hand(name)
    body = pg.Sphere(radius=0.01, mass=0.1, pose=at(1.0, 0, 0))
    model, _ = build(hand, body, time_step=1e-3, gravity_o=[0, 0, -9.81], servo=Servo.of(hand))
    data, q = mujoco.MjData(model), np.random.default_rng(0).uniform(hand.lower, hand.upper)
    for joint, value in zip(hand.joint_names, q):
        data.qpos[model.joint(joint).qposadr[0]] = value
    for joint, c in hand.couplings.items():
        data.qpos[model.joint(joint).qposadr[0]] = c.factor * q[hand.joint_names.index(c.followed)] + c.offset
    mujoco.mj_forward(model, data)
    wanted = hand.model.createData()
    pin.forwardKinematics(hand.model, wanted, q)
    for j in range(1, hand.model.njoints):
        assert data.body(f"link {j}").xpos == pytest.approx(wanted.oMi[j].translation, abs=1e-12)
    assert data.ncon == 0 or not data.efc_force.any()


@pytest.mark.slow
@pytest.mark.no_cover
def test_coupled_joints_stay_coupled_and_energy_is_kept():
    hand = pg.load_hand("psyonic_left", hulls=True)
    conditions = pg.GraspConditions(mu=0.7, friction=pg.Friction(model="cone", safety=1.3))
    found = find_grasps(hand, pg.Sphere(radius=0.03, mass=0.2), conditions, count=8)
    closure = found.best.closure
    plan = pg.plan_grasp_on(closure.hand, closure, conditions)
    simulation = simulate(plan, hold=0.3)
    assert simulation.verdict.held
    assert simulation.verdict.energy_error < 1e-4


@pytest.mark.slow
def test_torques_stay_within_the_limits(brisk):
    task = Task.of(brisk)
    weak = replace(task, torque_limit=np.full(20, 0.3))
    simulation = simulate(weak, hold=0.2)
    assert np.abs(simulation.torques).max() <= 0.3 * (1 + 1e-9)
    assert simulation.verdict.saturated
    assert not simulation.verdict.held


def test_torques_that_hold_are_those_without_deceleration(plan):
    motion, model = plan.motion, plan.hand.model
    inertia = pin.crba(model, model.createData(), np.array(motion.q[-1]))
    inertia = np.triu(inertia) + np.triu(inertia, 1).T
    assert motion.torques[-1] - inertia @ motion.ddq[-1] == pytest.approx(motion.holding_torques, abs=1e-6)


def test_steps_that_are_too_long_are_told(brisk):
    with pytest.raises((SimulationDiverged, AssertionError), match="diverged|held"):
        simulation = simulate(brisk, time_step=8e-3, servo=Servo.of(brisk.hand, stiffness=5e3, damping=1e-6))
        assert simulation.verdict.held, "not held"


@pytest.mark.slow
def test_nothing_is_held_without_friction_however_short_or_coarse(brisk):
    for settings in ({"hold": 0.1}, {"hold": 0.5, "sample": 0.05}, {"hold": 0.3, "letting_go": 0.0}):
        assert not simulate(brisk, disturbance=Disturbance(mu=0.0), time_step=1e-3, **settings).verdict.held


@pytest.mark.parametrize("settings", [{}, {"mode": "prescribed"}, {"letting_go": 0.0}], ids=str)
def test_an_object_that_flies_off_at_once_is_lost(brisk, settings, tmp_path, monkeypatch):
    """A thing of a milligram among forces of newtons leaves within the first step: far away is not held, whatever was
    seen of it.
    """
    monkeypatch.chdir(tmp_path)
    light = Disturbance(mass_factor=1e-6)
    simulation = simulate(brisk, disturbance=light, time_step=1e-3, **settings)
    assert not simulation.verdict.held and "away" in simulation.verdict.reason
    start = simulation.object_poses[simulation.complete]
    assert start[:3, 3] == pytest.approx(brisk.problem.object.pose[:3, 3], abs=1e-12)  # as planned, when it is let go
    assert simulation.verdict.drift > 0.05 and simulation.drift[-1] == pytest.approx(simulation.verdict.drift)
    outcome = run_trial(prepare_trials(brisk, {"time_step": 1e-3, **settings}), light)
    assert not outcome.held and outcome.drift > 0.05
    assert not any(tmp_path.iterdir())  # no log of MuJoCo's


def test_what_nothing_touches_is_not_held(brisk):
    """Without weight and without contacts an object stays where it is: nobody holds it."""
    task = Task.of(brisk)
    open_hand = replace(task, q=np.tile(task.q[0], (len(task.q), 1)), dq=np.zeros_like(task.dq), gravity_o=np.zeros(3))
    verdict = simulate(open_hand, hold=0.1, time_step=1e-3).verdict
    assert verdict.drift < 1e-6 and not verdict.held and "nothing touched" in verdict.reason


@pytest.mark.slow
def test_pushes_act_before_the_end_or_are_refused(brisk):
    push = Push(wrench_o=[0, 0, -1000, 0, 0, 0], start=0.1, duration=0.1)
    with pytest.raises(InvalidInput, match=r"hold: expected at least 0\.2 s"):
        simulate(brisk, disturbance=Disturbance(pushes=push), hold=0.15)
    assert not simulate(brisk, disturbance=Disturbance(pushes=push), hold=0.2, time_step=5e-4).verdict.held


def test_numbers_out_of_hand_are_no_verdict(brisk):
    huge = Disturbance(pushes=(Push(wrench_o=[0, 0, 0, 1e160, 0, 0], start=0.0),))
    with pytest.raises(SimulationDiverged):
        simulate(brisk, disturbance=huge, mode="prescribed", hold=0.2, time_step=1e-3)


@pytest.mark.slow
def test_the_weight_of_an_object_that_the_plan_does_not_know_counts_once(brisk):
    blind = replace(brisk, body=None, body_mass=0.0)
    known, told = simulate(brisk, hold=0.1), simulate(blind, hold=0.1, body=brisk.body)
    assert told.verdict.drift == pytest.approx(known.verdict.drift, rel=1e-6)


def test_rotors_of_the_description_are_simulated(plan):
    from pinograsp.simulation.mujoco_engine import MujocoEngine

    task = Task.of(plan)
    model = task.hand.model.copy()
    model.armature = np.full(20, 0.003)
    heavy = replace(task, hand=replace(task.hand, model=model))
    made = MujocoEngine(heavy, time_step=1e-3, servo=Servo.of(heavy.hand), mass_factor=1.0)
    assert made.model.dof_armature[made.dofs] == pytest.approx(np.full(20, 0.003))


# -- contacts of surfaces ----------------------------------------------------------------------------------------------


def test_surfaces_touch_at_the_given_points(case, plan):
    contacts = plan.problem.contacts
    hand, body = plan.hand, case.make_object()
    assert abs(clearance(hand, body, contacts.posture)) < 1e-8
    depth, _normal, point = Penetration(hand, body, contacts).at(contacts.posture)
    assert np.abs(depth).max() < 1e-8
    assert point == pytest.approx(contacts.points_o, abs=1e-6)
    assert np.linalg.norm(contacts.points_o[:, :2], axis=1) == pytest.approx(0.01, abs=1e-12)


def test_surfaces_that_cannot_touch_there_are_told(case):
    hand, body = case.load_hand(), case.make_object()
    contacts = pg.contacts_at(hand, body, {"little": [0.0, -0.01, 0.06]})
    with pytest.raises(ContactNotReached, match="near the given one|deep into"):
        touching(hand, body, contacts, np.zeros(hand.n))


def test_depth_of_a_ball_in_a_ball():
    """Deepest points of an overlap, where they are known."""
    rng = np.random.default_rng(3)
    hand = pg.load_hand("humanoid")
    model, data = hand.model, hand.model.createData()
    finger = hand.finger("index")
    joint = finger.joint_ids[-1]
    one = next(o for o in hand.geometry.geometryObjects if o.parentJoint == joint)
    axes = np.array(one.geometry.radii)
    for _ in range(5):
        q = rng.uniform(hand.lower, hand.upper)
        pin.forwardKinematics(model, data, q)
        placed = data.oMi[joint] * one.placement
        # A ball on the end of the ellipsoid's long axis overlaps it by exactly what it is moved in.
        outward = placed.rotation[:, 0]
        end, depth, radius = placed.translation + axes[0] * outward, rng.uniform(1e-4, 3e-3), 0.02
        ball = pg.Sphere(radius=radius, mass=0.1, pose=at(*(end + (radius - depth) * outward)))
        contact = pg.contacts.Contact(
            finger="index",
            link=finger.links[-1],
            point_o=end,
            rotation_oc=pg.spatial.tangent_frame(outward),
            length=None,
            distance=0.0,
            point_l=data.oMi[joint].actInv(end),
        )
        found, normal, _ = Penetration(hand, ball, pg.contacts.ContactSet(contacts=(contact,), com_o=ball.com_o)).at(q)
        assert found[0] == pytest.approx(depth, abs=1e-9)
        assert normal[0] == pytest.approx(outward, abs=1e-5)


# -- warnings, the naive grasp -----------------------------------------------------------------------------------------


def test_cautions_say_what_the_plan_does_not_cover(plan):
    assert all("a limit that is a guess" in caution for caution in plan.cautions)  # the hand's motors are nobody's
    told = pg.load_case("paper", AS_PUBLISHED).plan().cautions
    assert any("moments are not" in caution for caution in told)
    assert any("safety factor" in caution for caution in told)


@pytest.mark.slow
def test_noise_sends_no_finger_to_its_limits():
    """The thumb starts at its limit and can hardly move across its plane: noise of the finite differences once sent it
    elsewhere.
    """
    case = pg.load_case("paper")
    hand, cylinder = case.load_hand(), case.make_object()
    given = pg.load_case("paper", AS_PUBLISHED).make_contacts(hand)
    start = hand.configuration({finger: np.radians(angles) for finger, angles in case.motion.posture_deg.items()})
    flexion, rng = hand.finger("thumb").dofs[1:], np.random.default_rng(0)
    for size in (0.0, *10.0 ** np.arange(-12.0, -7.0)):
        for _ in range(3):
            found = touching(hand, cylinder, given, start - size * rng.uniform(0, 1, hand.n)).posture
            assert np.all(np.abs(found - start)[flexion] < np.radians(15))


def test_the_papers_case_holds_as_shipped_and_falls_with_the_papers_own_choices():
    assert simulate(pg.load_case("paper").plan(progress=False), hold=0.5, time_step=5e-4).verdict.held
    lost = simulate(pg.load_case("paper", AS_PUBLISHED).plan(progress=False), hold=0.5, time_step=5e-4).verdict
    assert not lost.held and lost.drift > 5e-3


@pytest.mark.slow
def test_optimised_grasp_needs_less_than_closing_on(plan):
    task = Task.of(plan)
    cone = pg.load_case("paper", SURFACE | {"friction.model": "cone", "forces.measure": "work"}).plan()
    optimised = simulate(cone, hold=0.5, time_step=5e-4)
    naive = naive_grasp(task, drift=5e-4, tolerance=0.1, hold=0.5)
    assert optimised.verdict.held and optimised.verdict.drift < 5e-4
    assert naive.overclosing > naive.lost > 0
    assert naive.simulation.verdict.drift <= 5e-4
    assert naive.grasp_energy > 1.2 * optimised.grasp_energy


def test_naive_closing_runs_straight_from_rest_to_rest(plan):
    task = naive_task(Task.of(plan), 0.1)
    assert task.q[0] == pytest.approx(plan.motion.q[0])
    assert task.q[-1] == pytest.approx(plan.motion.q[0] + 1.1 * (plan.motion.q[plan.motion.impact] - plan.motion.q[0]))
    assert not task.dq[[0, -1]].any()
    middle = np.gradient(task.q, task.times, axis=0)[1:-1]
    assert task.dq[1:-1] == pytest.approx(middle, abs=2e-3)


# -- folders, commands, errors -----------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_run_folder_gives_the_same_simulation(brisk, tmp_path):
    folder = pg.save_run(brisk, tmp_path / "run")
    one, other = simulate(brisk, hold=0.05), simulate(folder, hold=0.05)
    assert other.normal_forces[-1] == pytest.approx(one.normal_forces[-1], rel=1e-9)
    assert other.parts == one.parts


@pytest.mark.slow
def test_check_writes_a_verdict_with_figures(command, brisk, tmp_path):
    folder = pg.save_run(brisk, tmp_path / "run")
    code, out, _ = command("check", str(folder), "--hold", "0.3", "--time-step", "1e-3")
    assert code == 0 and "HELD" in out
    assert {path.name for path in (folder / "check").iterdir()} == {
        "check.json",
        "check.md",
        "check.npz",
        "energy.png",
        "files.txt",
        "forces.png",
        "object.png",
        "record.json",
    }
    kept = json.loads((folder / "check" / "check.json").read_text())
    assert kept["held"] and kept["drift_mm"] < 0.5
    code, out, _ = command(
        "check",
        str(folder),
        "--hold",
        "0.3",
        "--time-step",
        "1e-3",
        "--mu",
        "0.2",
        "--push",
        "0,0,-1@0.1+0.1",
        "--json",
    )
    assert code == 3
    told = json.loads(out)
    assert not told["held"] and told["disturbance"]["mu"] == 0.2 and told["folder"].endswith("check-2")
    pg.save_run(brisk, folder, force=True)  # a run with checks in it is still ours to overwrite
    pg.save_run(brisk, folder / "of" / "runs")
    with pytest.raises(InvalidInput, match="no run wrote"):  # a folder of runs is not
        pg.save_run(brisk, folder / "of", force=True)


def test_times_out_of_all_proportion_are_refused_on_the_command_line(command, brisk, tmp_path):
    folder = str(pg.save_run(brisk, tmp_path / "run"))
    for option, value in (("--hold", "1e308"), ("--time-step", "1e-320")):
        code, _, err = command("check", folder, option, value)
        assert code == 2 and "expected at most 2000000 steps" in err and "Traceback" not in err
    code, _, err = command("check", folder, "--monte-carlo", "9" * 20)
    assert code == 2 and "Traceback" not in err


@pytest.mark.slow
def test_check_goes_on_with_trials_that_were_killed(command, plan, tmp_path):
    folder = pg.save_run(plan, tmp_path / "run")
    tries = ("check", str(folder), "--hold", "0.6", "--time-step", "1e-3", "--monte-carlo", "1", "--json")
    first = json.loads(command(*tries)[1])["monte_carlo"]
    (log,) = (folder / "trials").glob("*/monte_carlo.jsonl")
    rows = log.read_text().splitlines()
    log.write_text("\n".join(rows[:-3]) + "\n")  # as if it had been killed
    again = json.loads(command(*tries)[1])["monte_carlo"]
    assert again["held"] == first["held"] and log.read_text().splitlines()[:-3] == rows[:-3]
    assert sorted(log.read_text().splitlines()[-3:]) == sorted(rows[-3:])


@pytest.mark.slow
def test_check_takes_every_disturbance(command, brisk, tmp_path):
    folder = pg.save_run(brisk, tmp_path / "run")
    options = "--push 0,0,-0.1@0.01+0.01 --shake 0.1,0,0@3 --mu 0.65 --mass 1.1 --offset 0.1,0,0 --turn 0,0,0.5"
    short = ("--hold", "0.02", "--time-step", "1e-3", "--start-error", "0.1", "--json")
    code, out, _ = command("check", str(folder), *options.split(), *short)
    assert code in (0, 3)
    got = json.loads(out)["disturbance"]
    assert got["mu"] == 0.65 and got["mass_factor"] == pytest.approx(1.1 / brisk.body.mass)
    assert got["shake_m_s2"] == [0.1, 0.0, 0.0] and got["shake_Hz"] == 3.0
    assert got["object_offset_m"] == pytest.approx([1e-4, 0.0, 0.0])
    assert got["object_turn_rad"] == pytest.approx([0.0, 0.0, np.radians(0.5)])
    assert got["start_error"] == pytest.approx([np.radians(0.1)] * brisk.hand.n)
    assert got["pushes"] == [{"wrench_N_Nm": [0.0, 0.0, -0.1, 0.0, 0.0, 0.0], "start_s": 0.01, "duration_s": 0.01}]


@pytest.mark.slow
def test_check_refuses_what_it_cannot_read(command, brisk, tmp_path):
    assert command("check", str(tmp_path))[0] == 2
    folder = pg.save_run(brisk, tmp_path / "run")
    code, _, told = command("check", str(folder), "--out", str(folder), "--force")
    assert code == 2 and "holds a run" in told and (folder / "plan.json").exists()
    for option in (
        ["--monte-carlo", "-3"],
        ["--monte-carlo", "3", "--mu", "0.5"],
        ["--push", "1,2"],
        ["--shake", "a,b,c"],
        ["--mass", "-1"],
        ["--hold", "-1"],
    ):
        code, _, told = command("check", str(folder), *option)
        assert code == 2, option
        assert "expected" in told
    for out, words in (
        ("n" * 300, "at most 255 bytes"),
        (".", "the one you are in"),
        (str(folder / "plan.json"), "is a file"),
    ):
        code, _, told = command("check", str(folder), "--out", out, "--force")
        assert code == 2 and words in told


def test_what_is_no_plan_is_refused(plan):
    with pytest.raises(InvalidInput, match="plan: expected a PlanRecord, got 42"):
        simulate(42)
    blind = replace(plan, body=None)
    with pytest.raises(InvalidInput, match="does not know its object"):
        simulate(blind)


def built(hand):
    """The hand in MuJoCo beside a ball, and what was changed."""
    from pinograsp.simulation.scene import build

    servo = Servo(stiffness=np.ones(hand.n), damping=np.ones(hand.n), rotor=np.full(hand.n, 1e-4))
    return build(hand, pg.Sphere(radius=0.01, mass=0.1), time_step=1e-3, gravity_o=[0, 0, -9.81], servo=servo)


@pytest.mark.parametrize(
    ("mass", "moments", "expected", "words"),
    [
        (0.06, (1e-5, 1e-5, 1e-3), (5e-4, 5e-4, 1e-3), "impossible moments of inertia"),
        (0.06, (1e-3, 2e-4, 3e-4), (4.5e-4, 5.5e-4, 1e-3), "impossible moments of inertia"),
        (0.06, (1e-5, 1e-5, 2.000000001e-5), (1e-5, 1e-5, 2e-5), ""),  # rounded
        (0.06, (1.1e-5, 2.2e-5, 3.3e-5), (1.1e-5, 2.2e-5, 3.3e-5), ""),  # a plate
        (0.06, (1e-5, 2e-5, 2.5e-5), (1e-5, 2e-5, 2.5e-5), ""),
        (1e-9, (1e-16, 1e-16, 1e-16), (1e-9, 1e-9, 1e-9), "next to no mass: 1e-05 kg"),
        (0.06, (1e-14, 1e-14, 1e-14), (1e-12, 1e-12, 1e-12), "no inertia about some axis"),
    ],
)
def test_inertias_that_mujoco_refuses_are_mended_and_noted(tmp_path, mass, moments, expected, words):
    """The nearest that MuJoCo takes, a body's moments: none larger than the other two together."""
    hand = pg.load_hand(own_hands.write(tmp_path, "parallel_gripper"))
    changed = hand.model.copy()
    changed.inertias[1] = pin.Inertia(mass, np.zeros(3), np.diag(moments))
    hand = replace(hand, model=changed)
    model, notes = built(hand)
    assert np.sort(model.body("link 1").inertia) == pytest.approx(sorted(expected), rel=2e-6)
    assert [words in note for note in notes] == [True] * bool(words)


@pytest.mark.parametrize("moments", ["1e-5 1e-5 0", "0 0 0", "1e-5 1e-5 -1e-15", "1e-300 1e-300 1e-300"])
def test_links_without_inertia_about_an_axis_are_simulated(tmp_path, moments):
    """Thin rods: MuJoCo wants a little about every axis. Point masses have that of their shapes as they are loaded."""
    xx, yy, zz = moments.split()
    text = own_hands.HANDS["parallel_gripper"]
    start = text.index("<inertia ", text.index('<link name="left_jaw">'))
    end = text.index("/>", start)
    path = tmp_path / "rod.urdf"
    path.write_text(f'{text[:start]}<inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="0" ixz="0" iyz="0"{text[end:]}')
    hand = pg.load_hand(path)
    model, notes = built(hand)
    words = "has no inertia about some axis" if moments.startswith("1e-5") else "taken from the shapes instead"
    assert (model.body_inertia[1:] > 0).all() and any(words in note for note in (*notes, *hand.notes))
    sound, none = built(pg.load_hand(own_hands.write(tmp_path, "parallel_gripper")))
    assert not none and (sound.body_inertia[2:] == model.body_inertia[2:]).all()
