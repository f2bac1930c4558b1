"""Sixteen contacts: three phalanges of five fingers and the palm, against closed forms, to the end of the motion."""

from __future__ import annotations

import importlib.util
import math
import sys
from pathlib import Path

import numpy as np
import pytest

from pinograsp.contacts import PALM
from pinograsp.errors import Status

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture(scope="module")
def benchmark():
    sys.path.insert(0, str(BENCHMARKS))
    try:
        spec = importlib.util.spec_from_file_location("power_grasp", BENCHMARKS / "power_grasp.py")
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
    finally:
        sys.path.remove(str(BENCHMARKS))
    return module


@pytest.fixture(scope="module")
def plan(benchmark):
    return benchmark.grasp()[0]


def test_every_phalanx_touches_where_it_must(benchmark, plan):
    """Links tangent to a circle about the axis: knuckle, and from there half a phalanx to every point of touch."""
    contacts = plan.problem.contacts
    assert len(contacts) == 16 and sum(contact.finger == PALM for contact in contacts) == 1
    reach = benchmark.RADIUS + benchmark.THICKNESS
    half = math.atan(benchmark.PHALANX / 2 / reach)
    high = benchmark.RADIUS + benchmark.PALM
    knuckle = math.atan2(-high, math.sqrt(reach**2 + (benchmark.PHALANX / 2) ** 2 - high**2))
    for contact in contacts:
        point = contact.point_o - plan.closure.object.com_o
        if contact.finger == PALM:
            assert point[[0, 2]] == pytest.approx([0, -benchmark.RADIUS], abs=1e-6)
            continue
        part = ("proximal", "middle", "distal").index(contact.link.split("_")[1])
        angle = knuckle + (1 + 2 * part) * half
        x = benchmark.RADIUS * math.cos(angle) * (-1 if contact.finger == "thumb" else 1)
        assert point[[0, 2]] == pytest.approx([x, benchmark.RADIUS * math.sin(angle)], abs=2e-6)
        assert contact.normal_o[[0, 2]] == pytest.approx(-point[[0, 2]] / benchmark.RADIUS, abs=1e-4)


def test_planned_to_the_end(plan):
    certificate, motion = plan.forces.certificate, plan.motion
    assert plan.status is Status.OK and plan.problem.balance == "wrench"
    assert certificate.relative_gap <= 1e-6
    assert plan.forces.residual_force < 1e-9 and plan.forces.residual_moment < 1e-9
    assert np.all(np.abs(motion.torques[-1]) <= plan.hand.effort)
    # Three joints move three points of a finger along their normals exactly; across them they slip, which is told.
    assert motion.tracking_error.max() < 1e-6 and 1e-4 < motion.slip.max() < 5e-3
