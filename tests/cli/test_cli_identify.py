"""``pinograsp identify``, and sheets at the command line."""

from __future__ import annotations

import json

import numpy as np
import pytest
from closing_finger import close_on_stop, write_log

import pinograsp as pg
from pinograsp.hands.sheets import read_sheet

COUNTS = ["--unit", "position=count", "--unit", "force=count"]


@pytest.fixture
def log(tmp_path):
    rng = np.random.default_rng(1)
    parts = [
        close_on_stop(rng, speed=speed, limit=limit, trials=4)
        for speed in (60.0, 240.0)
        for limit in (100.0, 200.0, 400.0)
    ]
    ends = np.cumsum([0, *(part["time"][-1] + 1 for part in parts[:-1])])
    for part, end in zip(parts, ends, strict=True):
        part["time"] = part["time"] + end
    return write_log(tmp_path / "log.csv", {name: np.concatenate([part[name] for part in parts]) for name in parts[0]})


def test_closings_are_told_and_written_as_a_sheet_that_plans_read(command, log, tmp_path):
    sheet = tmp_path / "hand.drives.toml"
    options = [*COUNTS, "--newtons", "0.01,0.1", "--cap", "3", "--for-force", "2.5", "--out", str(sheet)]
    code, out, err = command("identify", str(log), *options)
    assert code == 0, err
    assert "under 3 N" in out and "for 2.5 N" in out and "24 closings" in out and "not identified" in out
    (values,) = read_sheet(sheet)
    assert values["closing"]["unit"] == "N" and len(values["closing"]["peaks"]) == 6
    assert pg.load_hand("panda", drives=sheet).drives[0].closing.trials == (4,) * 6
    code, out, err = command("identify", str(log), *options)
    assert code == 2 and "hand.drives.toml" in err
    code, out, _ = command("identify", str(log), *options, "--force", "--json")
    told = json.loads(out)
    assert code == 0 and 2.5 <= told["commands"]["for 2.5"]["peak"]["value"] < 2.51
    assert told["closing"]["peaks"] == values["closing"]["peaks"]


@pytest.mark.parametrize(
    ("options", "told"),
    [
        ([], "unit of position"),
        (["--unit", "position=count", "--unit", "force=N"], "whole numbers alone"),
        ([*COUNTS, "--column", "force=forse"], "did you mean 'force'"),
        ([*COUNTS, "--cap", "1"], "gentlest"),
        ([*COUNTS, "--out", "a.csv"], ".toml"),
        ([*COUNTS, "--newtons", "1"], "slope and offset"),
        (["--hand", "panda", *COUNTS], "with --hand"),
        (["--hand", "panda"], "expected columns as"),
        ([*COUNTS, "--mass", "tip=0.1"], "expected with --hand"),
        (["--hand", "panda", "--gravity", "0,0"], "--gravity"),
    ],
)
def test_what_cannot_be_is_refused(command, log, options, told):
    code, out, err = command("identify", str(log), *options)
    assert code == 2 and out == "" and told in err


def test_motion_is_identified_with_a_hand(command, tmp_path):
    """A gripper's jaws go up and down: 20 units a newton, 1.5 N of friction."""
    hand = pg.load_hand("panda")
    times = np.arange(0, 8, 0.01)
    q = 0.02 + 0.015 * np.sin(2 * times)
    columns = {"time": times, "panda_finger_joint1/position": q, "jaws/effort": 20.0 * np.sign(np.cos(2 * times))}
    path = write_log(tmp_path / "motion.csv", columns)
    code, out, err = command("identify", str(path), "--hand", "panda", "--out", str(tmp_path / "a.toml"))
    assert code == 0, err
    assert "0 of 1 drives" in out and "lost in friction" in out  # level jaws do not lift
    assert pg.load_hand("panda", drives=tmp_path / "a.toml").drives == hand.drives
    # Jaws that lift: a known mass and gravity along their way.
    pull = (0.4 * 9.81 + 0.1 * 9.81 * np.sign(np.cos(2 * times))) / 0.05
    path = write_log(tmp_path / "motion.csv", {**columns, "jaws/effort": pull})
    code, out, err = command("identify", str(path), "--hand", "panda", "--gravity", "0,9.81,0", "--mass", "nothing=1")
    assert code == 2 and "nothing" in err


@pytest.mark.slow
def test_sheets_at_the_command_line(command, tmp_path):
    code, out, _ = command("hands", "so101", "--drives")
    assert code == 0 and command("hands", "so101", "--write-drives")[1] == out
    (tmp_path / "a.toml").write_text(out)
    assert pg.load_hand("so101", drives=tmp_path / "a.toml").drives == pg.load_hand("so101").drives
    code, out, _ = command("hands", "allegro_right", "--drives", "leap", "--json")
    assert code == 0 and json.loads(out)["drives"][0]["limit"] == 0.284
    code, _, err = command("hands", "--drives")
    assert code == 2 and "NAME" in err
    sheet = tmp_path / "floor.drives.toml"
    sheet.write_text('[[drives]]\nname = "jaws"\nfloor = 30.0\n')
    plan = ["--hand", "panda", "--object", "sphere:radius=0.03,mass=0.1", "--samples", "2"]
    code, out, _ = command("plan", *plan, "--drives", str(sheet), "--out", str(tmp_path / "run"), "--json")
    assert code == 0 and any("presses with 30 at least" in text for text in json.loads(out)["cautions"])
