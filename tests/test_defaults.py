"""Defaults are the same by every door: Python's records and functions, case files and the command line."""

from __future__ import annotations

import dataclasses
import inspect

import numpy as np
import pytest
import typer

import pinograsp as pg
from pinograsp.carry import plan_carry
from pinograsp.cases.case import Case
from pinograsp.cases.object_case import ObjectCase
from pinograsp.cli import app
from pinograsp.motion import MotionSpec
from pinograsp.simulation.options import SimulationOptions
from pinograsp.sweep import certify_files

BALL = pg.Sphere(radius=0.03, mass=0.2)
AROUND = 0.03 * np.array([[1, 0, 0], [-0.5, 0.75**0.5, 0], [-0.5, -(0.75**0.5), 0], [0, 0, -1]])


@pytest.mark.parametrize("k", [2, 3, 4])
def test_a_problem_is_the_same_by_conditions_and_by_itself(k):
    contacts = pg.contacts_at(None, BALL, AROUND[:k])
    own = pg.ForceProblem.holding(BALL, contacts, mu=0.6)
    other = pg.GraspConditions(mu=0.6).problem(BALL, contacts)
    for field in dataclasses.fields(pg.ForceProblem):
        one, two = getattr(own, field.name), getattr(other, field.name)
        assert np.array_equal(one, two) if isinstance(one, np.ndarray) else repr(one) == repr(two), field.name
    assert own.friction.model == ("soft" if k == 2 else "cone") and own.max_depth == 0.01
    assert pg.ForceBatch.of([own], 0.9).high.max() == other.normal_force_range(0.9)[1].max()


def test_a_case_file_has_the_defaults_of_the_records():
    case = pg.load_case("paper", {"forces.search": "convex"})
    bare = {
        key: value for key, value in case.settings().items() if key in ("schema", "name", "hand", "object", "motion")
    }
    bare |= {"contacts": case.settings()["contacts"], "friction": {"mu": 0.7}, "forces": {"search": "convex"}}
    hand = case.load_hand()
    found = Case(**bare, folder=case.folder).make_problem(hand)
    own = pg.ForceProblem.holding(case.make_object(), case.make_contacts(hand), mu=0.7)
    for field in dataclasses.fields(pg.ForceProblem):
        one, two = getattr(found, field.name), getattr(own, field.name)
        assert np.array_equal(one, two) if isinstance(one, np.ndarray) else repr(one) == repr(two), field.name


def test_the_papers_case_keeps_its_own_limits():
    problem = pg.load_case("paper").make_problem(pg.load_case("paper").load_hand())
    assert problem.friction.is_paper and problem.max_depth == 5e-3


# What each option of the command line ends up as.
TAKEN = {
    "plan": {"samples": (pg.find_grasps, "count"), "seed": (pg.find_grasps, "seed"), "wrap": (pg.find_grasps, "wrap")},
    "close": {"samples": (pg.find_grasps, "count"), "seed": (pg.find_grasps, "seed")},
    "certify": {"tolerance": (certify_files, "tolerance"), "commanded": (certify_files, "commanded")},
    "check": {"hold": (SimulationOptions, "hold"), "time_step": (SimulationOptions, "time_step")},
    "carry": {"intervals": (plan_carry, "intervals"), "reserve": (plan_carry, "reserve")},
}


def test_the_command_line_has_the_defaults_of_the_functions():
    commands = typer.main.get_command(app).commands
    for name, options in TAKEN.items():
        given = {parameter.name: parameter.default for parameter in commands[name].params}
        for option, (function, argument) in options.items():
            assert given[option] == inspect.signature(function).parameters[argument].default, (name, option)
    case = {name: field.default for name, field in ObjectCase.model_fields.items()}
    for name in ("plan", "close"):
        given = {parameter.name: parameter.default for parameter in commands[name].params}
        assert all(given[option] == case[option] for option in ("mu", "safety", "samples", "seed", "wrap", "hulls"))
    mus = [
        p.default for command in commands.values() for p in command.params if p.name == "mu" and p.default is not None
    ]
    assert len(mus) >= 3 and len(set(mus)) == 1
    assert Case.model_fields["motion"].default.samples == MotionSpec().samples
