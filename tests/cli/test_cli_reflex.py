"""``pinograsp check --reflex``: a plan in the loop of its grip controller."""

from __future__ import annotations

import json

import pytest

from pinograsp.cli.reflex import ReflexOptions
from pinograsp.errors import InvalidInput
from pinograsp.storage import read_check

LIGHT = ("--set", "motion.samples=1", "--set", "motion.time_step=0.01")
pytestmark = pytest.mark.usefixtures("no_rendering")


def test_what_is_felt_and_how_well():
    assert ReflexOptions().read() is None
    assert ReflexOptions(reflex=True).read().quantities == ("forces", "slips")
    sensors = ReflexOptions(reflex=True, feels="torques", sensors="noise=0.1,delay=0.02,seed=3").read()
    assert (sensors.quantities, sensors.noise, sensors.delay, sensors.seed) == (("torques",), 0.1, 0.02, 3)


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ({"feels": "forces"}, "--feels: expected with --reflex"),
        ({"sensors": "noise=0.1"}, "--sensors: expected with --reflex"),
        ({"reflex": True, "feels": "sound"}, "quantity: expected one of"),
        ({"reflex": True, "sensors": "noise"}, "--sensors: expected NAME=VALUE"),
        ({"reflex": True, "sensors": "noise=0.1,noise=0.2"}, "each once"),
        ({"reflex": True, "sensors": "noise=much"}, "--sensors: expected 1 number"),
        ({"reflex": True, "sensors": "seed=0.5"}, "seed"),
    ],
)
def test_what_cannot_be_felt(options, told):
    with pytest.raises(InvalidInput, match=told):
        ReflexOptions(**options).read()


@pytest.mark.slow
def test_the_same_with_the_reflex_and_without_it(command, tmp_path):
    assert command("plan", "paper", "--out", "run", *LIGHT)[0] == 0
    light = ("check", "run", "--reflex", "--mass", "0.9", "--hold", "0.1", "--time-step", "1e-3")
    code, out, err = command(*light, "--sensors", "noise=0.1,delay=0.01", "--json")
    told = json.loads(out)
    assert code == (0 if told["held"] else 3), err
    reflex = told["reflex"]
    assert reflex["feels"] == ["forces", "slips"] and reflex["status"] == "ok" and not reflex["blind"]
    assert reflex["object_mass_kg"] == pytest.approx(0.9, rel=0.1) and reflex["load_bound_N"] > 0
    assert reflex["mu_low"].keys() == {"thumb", "index", "middle"} and None in reflex["mu_high"].values()
    assert {"held", "reason"} <= reflex["without_reflex"].keys()
    stored = json.loads((tmp_path / "run" / "check" / "check.json").read_text())
    assert stored["reflex"] == reflex and stored["disturbance"]["controller_feels"] == ["forces", "slips"]
    assert "with a controller that measures" in read_check(tmp_path / "run" / "check").describe()
    assert "with a controller that measures forces, slips" in (tmp_path / "run" / "check" / "check.md").read_text()
    code, out, _ = command(*light, "--feels", "normal_forces")
    shown = " ".join(out.split())
    assert "Without reflex?" in shown and "no load measured" in shown and "friction thumb 0.70 (at least" in shown
    code, _, err = command(*light, "--thresholds")
    assert code == 2 and "--reflex: expected without further trials" in err
    code, _, err = command(*light, "--prescribed")
    assert code == 2 and "controller: expected" in err
