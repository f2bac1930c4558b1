"""MuJoCo's callbacks belong to whoever set them: importing the package and simulating leave them as found."""

from __future__ import annotations

import importlib
import subprocess
import sys
import threading

import mujoco
import numpy as np
import pytest

import pinograsp as pg
from pinograsp.simulation.mujoco_engine import MujocoEngine

NAMES = [name.removeprefix("get_") for name in dir(mujoco) if name.startswith(("get_mjcb_", "get_mju_user_"))]
IMPORTING = """
import importlib, pkgutil, mujoco
read = [getattr(mujoco, name) for name in dir(mujoco) if name.startswith(("get_mjcb_", "get_mju_user_"))]
before = [get() for get in read]
import pinograsp
for module in pkgutil.walk_packages(pinograsp.__path__, "pinograsp."):
    # Of the core's modules, those for other processors cannot be loaded by this one.
    if not module.name.endswith("__main__") and "._core_" not in module.name:
        importlib.import_module(module.name)
assert [get() for get in read] == before
"""


def callbacks():
    return {name: getattr(mujoco, f"get_{name}")() for name in NAMES}


@pytest.fixture(scope="module")
def plan():
    settings = {"forces.search": "convex", "limits.final_time": 0.4, "limits.impact_time": [0.2, 0.35]}
    return pg.load_case("paper", settings).plan()


@pytest.fixture
def own():
    """Callbacks of a user; the calls of the first one are counted."""
    calls = []

    def control(model, data):
        calls.append(1)
        data.ctrl[:] = 100.0

    def warning(text):
        calls.append(text)

    mujoco.set_mjcb_control(control)
    mujoco.set_mjcb_passive(lambda model, data: data.qfrc_passive.fill(1.0))
    mujoco.set_mjcb_contactfilter(lambda model, data, one, other: 1)
    mujoco.set_mju_user_warning(warning)
    yield calls
    for name in ("mjcb_control", "mjcb_passive", "mjcb_contactfilter", "mju_user_warning"):
        getattr(mujoco, f"set_{name}")(None)


def test_what_uses_mujoco_sets_none_as_it_is_imported():
    for module in (
        "pinograsp.handover.scene",
        "pinograsp.handover.model_controls",
        "pinograsp.simulation.mujoco_engine",
    ):
        importlib.import_module(module)
    assert not any(callbacks().values())


@pytest.mark.slow
def test_no_module_sets_any():
    subprocess.run([sys.executable, "-c", IMPORTING], check=True, timeout=120)


@pytest.mark.slow
def test_simulations_neither_hear_them_nor_change_them(plan, own, tmp_path):
    before = callbacks()
    with_them = pg.simulate(plan, hold=0.02, time_step=1e-3)
    plan.to_mujoco(tmp_path / "scene.xml", scene=True, hold=0.0, rate=200.0)
    assert callbacks() == before and not own
    for name in ("mjcb_control", "mjcb_passive", "mjcb_contactfilter"):
        getattr(mujoco, f"set_{name}")(None)
    assert np.array_equal(with_them.normal_forces, pg.simulate(plan, hold=0.02, time_step=1e-3).normal_forces)


@pytest.mark.parametrize("error", [RuntimeError, KeyboardInterrupt])
def test_they_are_there_again_after_an_error(plan, own, monkeypatch, error):
    before = callbacks()

    def broken(*_):
        raise error

    monkeypatch.setattr(MujocoEngine, "step", broken)
    with pytest.raises(error):
        pg.simulate(plan, hold=0.02, time_step=1e-3)
    assert callbacks() == before


def test_simulations_in_threads_leave_them_too(plan, own):
    before = callbacks()
    threads = [
        threading.Thread(target=pg.simulate, args=(plan,), kwargs={"hold": hold, "time_step": 2e-3})
        for hold in (0.01, 0.02)
    ]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert callbacks() == before
