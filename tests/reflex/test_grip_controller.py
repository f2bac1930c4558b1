"""A squeeze that follows what is felt: what it never does, what it estimates, and whether it holds in the simulation."""

from __future__ import annotations

import secrets
from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.errors import InvalidInput, Status
from pinograsp.plan.answer import does_it_hold
from pinograsp.reflex import Command, Felt, GripController, Measured
from pinograsp.simulation import Disturbance, Push, Sensors

SEED = secrets.randbelow(10**9)
PERIOD, CAP = 1e-3, 12.0


def grasp_can(hand, radius):
    conditions, body = pg.GraspConditions(mu=0.6), pg.Cylinder(radius=radius, height=0.12, mass=0.25)
    found = pg.find_grasps(pg.load_hand(hand), body, conditions, count=16, seed=1, jobs=1, progress=False)
    return pg.plan_best(found, conditions, progress=False)


@pytest.fixture(scope="module")
def plan():
    return grasp_can("allegro_right", 0.033)


@pytest.fixture(scope="module")
def jaws():
    """A grasp that some squeeze holds, however slippery it is."""
    return grasp_can("panda", 0.03)


@pytest.fixture
def controller(plan):
    return plan.grip_controller(latency=0.03, max_normal_force=CAP)


def planned_of(plan):
    return np.einsum("kji,kj->ki", plan.contacts.rotations_oc, plan.motion.forces_o[-1])


def ones_of(plan):
    return np.ones(len(plan.contacts.names))


def feel(controller, time, late=0.02, **values):
    """A tick with what was measured a little earlier."""
    measured = {name: Measured(np.array(value, dtype=float), time - late) for name, value in values.items()}
    return controller.step(Felt(time, **measured))


def check_command(plan, controller, command):
    """What holds of every command."""
    normal = controller.forces[:, 2]
    assert np.all(np.isfinite(command.torques)), SEED
    assert normal.max() <= CAP * (1 + 1e-9), SEED
    assert np.all(np.abs(command.torques) <= plan.torque_limit * (1 + 1e-12)), SEED
    # Internal forces besides the planned ones: no wrench on the object, by the grasp map.
    wrench = plan.problem.contacts.G @ (controller.forces - planned_of(plan)).ravel()
    assert np.abs(wrench).max() < 1e-9 * (1 + np.abs(controller.forces).max()), SEED


def test_it_begins_with_the_plan(plan, controller):
    command = controller.step(Felt(0.0))
    assert controller.status is Status.OK and command.references is None
    np.testing.assert_allclose(command.torques, plan.motion.holding_torques, atol=1e-6)
    np.testing.assert_allclose(controller.forces, planned_of(plan), atol=1e-6)
    assert controller.object_mass == pytest.approx(plan.body_mass) and controller.load_bound == np.inf


def test_no_measurement_makes_a_command_beyond_its_limits(plan, controller, count=3000):
    rng = np.random.default_rng(SEED)
    k, n, planned = len(plan.contacts.names), plan.hand.n, planned_of(plan)
    for i in range(count):
        time, values = PERIOD * i, {}
        if rng.random() < 0.7:
            values["forces"] = planned * rng.lognormal(0, 1, (k, 1)) + rng.normal(size=(k, 3)) * 10 ** rng.uniform(
                -3, 4
            )
        if rng.random() < 0.3:
            values["normal_forces"] = 10 ** rng.uniform(-3, 5, k) * rng.choice([-1, 1], k)
        if rng.random() < 0.7:
            values["slips"] = rng.random(k) < rng.random()
        if rng.random() < 0.3:
            values["torques"] = rng.normal(size=n) * 10 ** rng.uniform(-3, 3)
        if rng.random() < 0.2:
            values["wrench"] = rng.normal(size=6) * 10 ** rng.uniform(-3, 4)
        if rng.random() < 0.2:
            values["acceleration"] = rng.normal(size=3) * 10 ** rng.uniform(-3, 3)
        for name in list(values):
            if rng.random() < 0.1:
                values[name] = np.array(values[name], dtype=float)
                values[name].flat[0] = rng.choice([np.nan, np.inf, -np.inf, 1e300])
        late = rng.choice([0.0, 0.02, -0.01, 1.0, np.nan])
        check_command(plan, controller, feel(controller, time, late, **values))


@pytest.mark.slow
def test_no_measurement_ever_does(plan):
    controller = plan.grip_controller(latency=0.03, max_normal_force=CAP)
    test_no_measurement_makes_a_command_beyond_its_limits(plan, controller, count=100_000)


def hold(plan, controller, seconds, mu=None, weight=1.0, noise=0.0, seed=0, start=0.0, slip=False):
    """Feel the planned forces so many times; ``mu``: with this ratio at all contacts; noise as a share of each force."""
    rng = np.random.default_rng(seed)
    forces = weight * planned_of(plan)
    if mu is not None:
        forces[:, 0], forces[:, 1] = mu * forces[:, 2], 0.0
    size = noise * np.linalg.norm(forces, axis=1, keepdims=True)
    for i in range(round(seconds / PERIOD)):
        shown = forces + size * rng.standard_normal(forces.shape)
        felt = {"forces": shown, "slips": np.full(len(forces), float(slip))}
        check_command(plan, controller, feel(controller, start + PERIOD * i, **felt))


def test_load_and_mass_are_within_their_bounds(plan):
    rng = np.random.default_rng(SEED)
    within = []
    for _ in range(60):
        controller, times = plan.grip_controller(max_normal_force=CAP), rng.uniform(0.5, 2.0)
        hold(plan, controller, 0.2, weight=times, noise=0.1, seed=int(rng.integers(10**9)))
        true = -plan.problem.contacts.G @ (times * planned_of(plan)).ravel()
        within.append(np.linalg.norm(controller.load[:3] - true[:3]) <= controller.load_bound)
        assert controller.object_mass == pytest.approx(times * plan.body_mass, rel=0.5), SEED
    assert np.mean(within) >= 0.9, SEED  # 95 % of them, and what chance does to 60


@pytest.mark.slow
def test_a_contact_that_holds_has_at_least_the_friction_of_its_ratio_and_one_that_slips_no_more(plan):
    told = planned_of(plan)[:, 2] > 0.5
    low, high = [], []
    for seed, mu in enumerate(np.random.default_rng(SEED).uniform(0.25, 1.0, 20)):
        controller = plan.grip_controller(max_normal_force=CAP)
        hold(plan, controller, 1.5, mu, noise=0.1, seed=SEED + seed)
        assert np.all(np.isinf(controller.mu_high)), SEED
        hold(plan, controller, 0.1, mu, noise=0.1, seed=SEED + seed, start=1.5, slip=True)
        assert np.all(controller.mu_high >= controller.mu_low), SEED
        assert np.all(controller.mu_low[told] <= 1.05 * mu), SEED
        low.extend(controller.mu_low[told] / np.tan(np.arctan(mu) - 0.1))  # with a normal tilted so far
        high.extend(controller.mu_high[told] / mu)
    assert np.median(low) >= 0.8, SEED
    assert np.mean(np.array(high) >= 1.0) >= 0.9 and np.mean(np.array(high) <= 1.2) >= 0.9, SEED


def test_what_slips_tells_of_contacts_that_have_not(plan):
    controller, planned = plan.grip_controller(latency=0.03, max_normal_force=CAP), planned_of(plan)
    planned[:, :2] *= 0.1  # none has held with much
    slipping = np.arange(len(planned)) == int(planned[:, 2].argmax())
    planned[slipping, 0], planned[slipping, 1] = 0.3 * planned[slipping, 2], 0.0
    for i in range(200):
        feel(controller, PERIOD * i, forces=planned, slips=1.0 * slipping)
    np.testing.assert_allclose(controller.mu, 0.3, rtol=0.05)
    assert np.all(np.isinf(controller.mu_high[~slipping]))


def test_the_least_squeeze_is_that_of_the_felt_load(jaws):
    controller = jaws.grip_controller(latency=0.03)
    for i in range(300):
        feel(controller, PERIOD * i, forces=planned_of(jaws), slips=0.0 * ones_of(jaws))
    # Two contacts opposite each other hold a weight by friction alone.
    weight = float(np.linalg.norm(jaws.load[:3]))
    assert controller.find_least_squeeze() == pytest.approx(weight / 0.6, rel=0.02)
    before = controller.torques.copy()
    command = feel(controller, 0.3, forces=planned_of(jaws), slips=0.0 * ones_of(jaws))
    np.testing.assert_allclose(command.torques, before, atol=1e-3)  # to ask changes nothing


def test_a_slip_makes_the_squeeze_jump_once_until_that_is_felt(jaws):
    controller = jaws.grip_controller(latency=0.03, max_normal_force=5 * CAP)
    for i in range(100):
        feel(controller, PERIOD * i, forces=planned_of(jaws), slips=0.0 * ones_of(jaws))
    before = controller.forces[:, 2].copy()
    for i in range(15):
        feel(controller, 0.1 + PERIOD * i, forces=planned_of(jaws), slips=ones_of(jaws))
    assert controller.reflexes == 1 and np.all(controller.forces[:, 2] > 1.7 * before)
    # The forces are not felt to have risen yet, and the controller waits.
    for i in range(20):
        feel(controller, 0.115 + PERIOD * i, forces=planned_of(jaws), slips=ones_of(jaws))
    assert controller.reflexes == 1


def test_where_no_forces_hold_the_load_the_planned_squeeze_rises_as_it_is(plan):
    """Three fingers around a can, which slip at ratios with which none hold it."""
    controller, planned = plan.grip_controller(latency=0.03, max_normal_force=CAP), planned_of(plan)
    for i in range(200):
        feel(controller, PERIOD * i, forces=planned * [0.3, 0.3, 1.0], slips=ones_of(plan))
    assert controller.status is Status.INFEASIBLE and controller.reflexes >= 1
    shares = controller.forces[:, 2] / planned[:, 2]
    assert shares.min() > 1.2 and shares.max() < 1.3 * shares.min()


def test_without_slip_the_squeeze_is_released_slowly_and_no_further_than_its_share(plan, controller):
    squeeze = []
    for i in range(4000):
        # As a hand whose servos give way.
        feel(controller, PERIOD * i, forces=controller.forces.copy(), slips=0.0 * ones_of(plan))
        squeeze.append(controller.forces[:, 2].sum())
    fell = -np.diff(squeeze) / PERIOD
    assert squeeze[-1] < 0.9 * squeeze[0] and fell.max() < 5 * squeeze[0]
    assert np.all(controller.forces[:, 2] > 0.2 * 0.45 * planned_of(plan)[:, 2] - 1e-9)
    assert squeeze[290] == pytest.approx(squeeze[0], rel=0.05)  # nothing before it has settled


def test_an_object_that_something_else_supports_stays_squeezed(plan, controller):
    """What supports it may be taken away at once."""
    P = np.array(controller.constants()["internal"])
    for i in range(4000):
        internal = (P @ controller.forces.ravel()).reshape(-1, 3)
        feel(controller, PERIOD * i, forces=internal, slips=0.0 * ones_of(plan))
    share = controller.forces[:, 2] / planned_of(plan)[:, 2]
    assert share.min() > 0.15


def test_where_no_slip_is_felt_the_squeeze_rises_before_the_load_is_in_the_hand_and_not_at_once(plan, controller):
    squeeze = []
    for i in range(300):
        feel(controller, PERIOD * i, normal_forces=planned_of(plan)[:, 2])
        squeeze.append(controller.forces[:, 2].sum())
    assert squeeze[250] > 1.3 * squeeze[0] and np.diff(squeeze).max() < 0.05 * squeeze[0]


def test_blind_it_holds(plan, controller):
    hold(plan, controller, 0.6, 0.6)
    for i in range(3):
        controller.step(Felt(0.6 + 0.1 * i))
    assert controller.blind
    held = controller.torques.copy()
    for i in range(1000):
        controller.step(Felt(0.9 + PERIOD * i))
    np.testing.assert_allclose(controller.torques, held, rtol=0.02, atol=1e-6)
    hold(plan, controller, 0.01, 0.6, start=2.0)
    assert not controller.blind


def test_late_sensors_are_heard(jaws):
    controller, blind = jaws.grip_controller(latency=0.09, max_normal_force=CAP), []
    for i in range(300):
        feel(controller, PERIOD * i, late=0.06, forces=planned_of(jaws))
        blind.append(controller.blind)
    assert not any(blind)
    for i in range(300, 352):
        controller.step(Felt(PERIOD * i))
        blind.append(controller.blind)
    assert not any(blind[:345]) and blind[-1]  # 50 ms after the last one


@pytest.mark.parametrize("quantity", ["forces", "normal_forces"])
def test_a_slip_before_the_silence_makes_it_jump_no_more(jaws, quantity):
    controller, planned = jaws.grip_controller(latency=0.025, max_normal_force=20 * CAP), planned_of(jaws)
    planned = planned if quantity == "forces" else planned[:, 2]
    for i in range(112):
        slips = float(i >= 100) * ones_of(jaws)
        feel(controller, PERIOD * i, late=0.01, slips=slips, **{quantity: planned})
    jumps = controller.reflexes
    assert jumps >= 1
    for i in range(112, 600):
        controller.step(Felt(PERIOD * i))
    assert controller.blind and controller.reflexes == jumps


def test_what_is_old_or_no_number_is_not_measured(plan, controller):
    hold(plan, controller, 0.1, 0.6)
    load = controller.load.copy()
    feel(controller, 0.1, late=0.09, forces=9 * planned_of(plan))
    feel(controller, 0.102, forces=np.full((len(controller.forces), 3), np.nan))
    np.testing.assert_array_equal(controller.load, load)
    controller.step(Felt(0.05))
    assert controller.status is Status.INVALID_INPUT


def test_references_make_the_torques(jaws):
    controller = jaws.grip_controller(max_normal_force=5 * CAP, stiffness=2e4)
    for i in range(60):
        command = feel(controller, PERIOD * i, forces=planned_of(jaws), slips=ones_of(jaws))
    extra = 2e4 * (command.references - jaws.motion.q[-1])
    np.testing.assert_allclose(extra, command.torques, atol=1e-9)
    assert np.abs(extra - jaws.motion.holding_torques).max() > 1.0


def test_the_arm_s_acceleration_and_the_wrist_tell_the_load(plan, controller):
    feel(controller, 0.0, acceleration=[0.0, 2.0, 0.0])
    expected = plan.body_mass * (plan.gravity_o - [0.0, 2.0, 0.0])
    np.testing.assert_allclose(controller.load[:3], expected, atol=1e-9)
    controller.reset()
    feel(controller, 0.0, wrench=[0.0, 0.0, 7.0, 0.0, 0.1, 0.0])
    np.testing.assert_allclose(controller.load, [0.0, 0.0, -7.0, 0.0, -0.1, 0.0], atol=1e-9)
    assert controller.object_mass == pytest.approx(7.0 / 9.81)


def test_constants_are_plain(plan, controller):
    constants = controller.constants()
    assert len(constants["joint_map"]) == plan.hand.n and constants["loop"]["contacts"] == len(controller.forces)
    assert np.shape(constants["internal"]) == (3 * len(controller.forces),) * 2


def test_measurements_are_arrays_of_their_shapes(plan, controller):
    feel(controller, 0.0, forces=planned_of(plan).tolist(), slips=[False] * len(planned_of(plan)))
    assert controller.load_bound < np.inf
    for values, match in (({"forces": np.ones(5)}, r"expected shape \(3, 3\), got"), ({"wrench": [1.0]}, r"\(6,\)")):
        with pytest.raises(InvalidInput, match=match):
            feel(controller, 0.01, **values)
    with pytest.raises(InvalidInput, match="felt slips: expected numbers"):
        controller.step(Felt(0.02, slips=Measured(["much", "little"], 0.01)))


def test_unusable_settings_are_refused(plan):
    for settings, match in (
        ({"max_normal_force": 0.1}, "caps: expected at least the planned"),
        ({"margin": 0.5}, "margin"),
        ({"latency": -1.0}, "latency"),
        ({"stiffness": 0.0}, "stiffness"),
        ({"marginn": 1.5}, "did you mean 'margin'"),
        ({"noise": np.nan}, "noise"),
    ):
        with pytest.raises(InvalidInput, match=match):
            plan.grip_controller(**settings)
    with pytest.raises(InvalidInput, match="forces"):
        GripController(plan.problem, hand=plan.hand, q=plan.motion.q[-1], forces=[1.0], torques=[0.0])


# -- in the simulation


QUICK = {"hold": 0.4, "sample": 5e-3}


def test_a_controller_that_sends_the_plan_s_torques_changes_nothing(plan):
    torques = plan.motion.holding_torques
    plain = pg.simulate(plan, **QUICK)
    looped = pg.simulate(plan, controller=lambda felt: Command(torques), **QUICK)
    np.testing.assert_array_equal(looped.q, plain.q)
    np.testing.assert_array_equal(looped.object_poses, plain.object_poses)
    assert looped.disturbance["controller_feels"][0] == "forces" and "with a controller that measures" in str(looped)
    assert "Held in simulation with a controller that measures forces" in does_it_hold(plan, looped).text
    assert not plain.disturbance and plain.describe_controller() == ""


def test_sensors_tell_what_there_is_late_and_not_always(plan):
    seen = list[Felt]()

    def control(felt):
        seen.append(felt)
        return Command(plan.motion.holding_torques)

    quantities = ("forces", "normal_forces", "slips", "torques", "joint_positions", "wrench", "acceleration")
    sensors = Sensors(quantities=quantities, delay=0.02, loss=0.3, resolution=0.05)
    pg.simulate(plan, controller=control, sensors=sensors, **QUICK)
    final = plan.motion.times[-1]
    assert seen[0].time == pytest.approx(final) and all(one is None for one in seen[0][1:])
    told = [felt for felt in seen if felt.forces is not None]
    assert 0.6 < len(told) / len(seen) < 0.8
    assert all(0.02 - 1e-9 <= felt.time - felt.forces.time < 0.03 for felt in told)
    last = told[-1]
    np.testing.assert_allclose(last.forces.value[:, 2], last.normal_forces.value, atol=0.2)
    # What holds the object is its weight, about its centre of mass.
    np.testing.assert_allclose(last.wrench.value[:3], [0.0, 0.0, 0.25 * 9.81], atol=0.1)
    assert not last.slips.value.any() and not last.acceleration.value.any()
    np.testing.assert_allclose(last.torques.value, plan.motion.holding_torques, atol=0.1)
    steps = last.normal_forces.value / 0.05
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-6)


def test_controllers_that_send_nonsense_are_refused(plan):
    for command in (Command(np.zeros(3)), Command(np.full(16, np.nan)), Command(np.zeros(16), np.zeros(2))):
        with pytest.raises(InvalidInput, match="controller"):
            pg.simulate(plan, controller=lambda felt, command=command: command, **QUICK)
    with pytest.raises(InvalidInput, match="controller: expected"):
        pg.simulate(plan, mode="prescribed", controller=lambda felt: Command(np.zeros(16)), **QUICK)
    for settings in ({"loss": 1.0}, {"delay": -1.0}, {"quantities": ("sound",)}, {"period": 0.0}):
        with pytest.raises(InvalidInput):
            Sensors(**settings)


@pytest.mark.slow
def test_a_weight_that_doubles_on_slippery_contacts_is_held(jaws):
    """Jaws of a planned friction of 0.6, which is 0.3: what the plan squeezes with cannot hold twice the weight. A grip
    that keeps enough holds it; one that keeps less, as by default, answers while it slides by what its delays allow.
    """
    weight = 2.0 * 0.25 * 9.81
    assert 0.3 * planned_of(jaws)[:, 2].sum() < 2 * weight
    doubled = Push(wrench_o=[0.0, 0.0, -weight, 0.0, 0.0, 0.0], start=0.3, duration=1.2)
    disturbance = Disturbance(mu=0.3, mass_factor=2.0, pushes=(doubled,), command_delay=0.005)
    sensors = Sensors(quantities=("forces", "slips"), noise=0.1, delay=0.02, loss=0.05, seed=SEED)
    settings = {"hold": 1.5, "support": "fixed", "disturbance": disturbance}

    def moves(controller):
        seen = pg.simulate(jaws, controller=controller, sensors=sensors, **settings)
        away = np.linalg.norm(seen.object_poses[:, :3, 3] - seen.object_poses[seen.complete, :3, 3], axis=1)
        return float(away.max())

    assert moves(lambda felt: Command(jaws.motion.holding_torques)) > 8e-3  # it falls on the palm
    controller = jaws.grip_controller(latency=0.025, max_normal_force=5 * CAP, kept=0.7)
    assert moves(controller) < 4e-3, SEED
    assert controller.object_mass == pytest.approx(2 * 2.0 * 0.25, rel=0.25), SEED


def test_the_same_controller_without_a_load_s_direction_in_the_plan_still_steps(plan):
    problem = replace(plan.problem, load=np.zeros(6))
    controller = GripController(
        problem,
        hand=plan.hand,
        q=plan.motion.q[-1],
        forces=planned_of(plan),
        torques=plan.motion.holding_torques,
    )
    for i in range(500):
        feel(controller, PERIOD * i, forces=planned_of(plan), slips=0.0 * ones_of(plan))
    assert np.all(np.isfinite(controller.torques))
