"""What shells are offered, asked as they ask."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import get_args

import pytest
from marks import slow_except

from pinograsp.cli import completion


def offered(folder, *words: str) -> list[str]:
    """The values that bash is offered for the last of the words."""
    asked = {"_PINOGRASP_COMPLETE": "complete_bash", "COMP_WORDS": " ".join(words), "COMP_CWORD": str(len(words) - 1)}
    done = subprocess.run(
        [sys.executable, "-m", "pinograsp.cli"],
        cwd=folder,
        env={**os.environ, **asked},
        capture_output=True,
        text=True,
        timeout=120,
    )
    assert done.returncode == 0 and done.stderr == "", done.stderr
    return done.stdout.split()


@pytest.fixture
def folder(tmp_path):
    """With a run, a carry plan and a case."""
    for place, name in (
        ("runs/paper", "plan.json"),
        ("elsewhere/deep/mine", "plan.json"),
        ("carries/box", "carry.json"),
    ):
        (tmp_path / place).mkdir(parents=True)
        (tmp_path / place / name).write_text("{}")
    (tmp_path / "case.yaml").write_text("")
    return tmp_path


COMPLETIONS = [
    (["pinograsp", "pl"], ["plan"]),
    (["pinograsp", "plan", "--hand", "allegro"], ["allegro_left", "allegro_right"]),
    (["pinograsp", "hands", "pan"], ["panda"]),
    (["pinograsp", "plan", ""], ["mug", "paper", "case.yaml"]),
    (["pinograsp", "plan", "--search", "paper"], ["paper", "paper+qp"]),
    (["pinograsp", "plan", "--measure", ""], ["impulse", "work"]),
    (["pinograsp", "plan", "--object", "sph"], ["sphere:radius=0.03,mass=0.2"]),
    (["pinograsp", "plan", "paper", "--set", "friction.m"], ["friction.mu=", "friction.model="]),
    (["pinograsp", "check", ""], ["runs/paper"]),
    (["pinograsp", "check", "elsewhere/deep/"], ["elsewhere/deep/mine"]),
    (["pinograsp", "check", "runs/paper", "--control", "pos"], ["position"]),
    (["pinograsp", "export", ""], ["carries/box", "runs/paper"]),
    (["pinograsp", "export", "runs/paper", "--command", "im"], ["impedance"]),
    (["pinograsp", "certify", "--format", "graspn"], ["graspnet"]),
    (["pinograsp", "certify", "--convention", "leap"], ["leap_base", "leap_mjcf"]),
    (["pinograsp", "plan", "--out", "r"], []),  # left to the shell, which knows files
    (["pinograsp", "plan", "--hand", "my_hand"], []),
    (["pinograsp", "plan", "--compa"], ["--compare"]),
]


@pytest.mark.parametrize(
    ("words", "expected"),
    slow_except(COMPLETIONS, *COMPLETIONS[::4]),
    ids=lambda words: " ".join(words[1:]),
)
def test_values_complete(folder, words, expected):
    assert offered(folder, *words) == expected


def test_choices_are_those_that_the_package_takes():
    from pinograsp.carry.plan import TimingName
    from pinograsp.contacts import FrictionModel
    from pinograsp.contacts.compliance import MEASURES
    from pinograsp.forces import SOLVERS
    from pinograsp.handover.commands import COMMANDS
    from pinograsp.hands.load import Masses
    from pinograsp.planner import Search
    from pinograsp.simulation.settings import CONTROLS, SUPPORTS
    from pinograsp.sweep.runner import EXECUTORS

    for ours, theirs in (
        (completion.SEARCHES, get_args(Search)),
        (completion.MEASURES, MEASURES),
        (completion.SOLVERS, SOLVERS),
        (completion.FRICTION, get_args(FrictionModel)),
        (completion.MASSES, get_args(Masses)),
        (completion.CONTROLS, CONTROLS),
        (completion.SUPPORTS, SUPPORTS),
        (completion.EXECUTORS, EXECUTORS),
        (completion.COMMANDS, COMMANDS),
        (completion.TIMINGS, get_args(TimingName)),
    ):
        assert sorted(ours) == sorted(theirs)


def test_shells_can_be_told(command):
    assert "--install-completion" in command("--help")[1]
