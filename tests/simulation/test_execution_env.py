"""The environment of the benchmark of controllers: Gymnasium's own check, and the benchmark's result by its policy."""

from __future__ import annotations

import importlib
import sys
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pinograsp as pg

gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is not installed")
BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark():
    """execution.py and execution_env.py, which import each other by name."""
    names = ("results", "execution", "execution_env")
    sys.path.insert(0, str(BENCHMARKS))
    try:
        yield [importlib.import_module(name) for name in names][1:]
    finally:
        sys.path.remove(str(BENCHMARKS))
        for name in names:
            sys.modules.pop(name, None)


@pytest.fixture(scope="module")
def plan():
    """Two jaws on a box."""
    hand = pg.load_hand("panda")
    box = pg.Box(size=(0.04, 0.05, 0.08), mass=0.2)
    conditions = pg.GraspConditions(mu=0.6)
    found = pg.find_grasps(hand, box, conditions, count=8, seed=1, jobs=1, progress=False)
    plan = pg.plan_best(found, conditions, progress=False)
    assert plan.status is pg.Status.OK
    return plan


@pytest.fixture
def environment(benchmark, plan):
    env = benchmark[1].ExecutionEnv(plan, quantities=("forces", "normal_forces", "slips", "torques"))
    yield env
    env.close()


@pytest.mark.slow  # begins a dozen episodes
def test_it_is_an_environment(environment):
    from gymnasium.utils.env_checker import check_env

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of spaces without bounds, and of what is not rendered
        check_env(environment, skip_render_check=True)


@pytest.mark.slow  # two whole trials
def test_the_policy_of_the_benchmark_has_its_result(benchmark, environment, plan):
    execution, _ = benchmark
    drawn = execution.Happening.draw(np.random.default_rng(3))
    happening = replace(drawn, mu=0.5, mass=1.2, event="none", stiffness=1.0)
    grip = plan.grip_controller(latency=execution.DELAY + happening.delay, max_normal_force=execution.cap_of(plan))
    policy = execution.Reflex(grip, ("forces", "slips"))
    observation, info = environment.reset(options={"happening": happening})
    ended, steps, reward = False, 0, 0.0
    while not ended:
        assert environment.observation_space.contains(observation)
        observation, reward, ended, cut, info = environment.step(policy(info["felt"]).torques)
        steps += 1
    expected = execution.run_trial(plan, happening, "reflex")
    assert info["row"] == {name: expected[name] for name in info["row"]} and not cut
    assert reward == float(expected["kept"] and not expected["over_cap"])
    assert steps == pytest.approx(1e3 * (execution.HOLD + execution.LETTING_GO + happening.delay), abs=3)


def test_without_torques_the_object_is_lost(benchmark, environment):
    drawn = benchmark[0].Happening.draw(np.random.default_rng(3))
    happening = replace(drawn, mu=0.5, mass=2.0, event="none", stiffness=1.0)
    environment.reset(options={"happening": happening})
    ended, reward, push = False, 1.0, np.zeros(environment.action_space.shape)
    while not ended:
        _, reward, ended, _, info = environment.step(push)
    assert reward == 0.0 and not info["row"]["kept"] and "away" in info["row"]["why"]
