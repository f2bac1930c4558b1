"""Arguments of a wrong kind: our own exceptions, whatever function is called."""

from __future__ import annotations

import numpy as np
import pytest

import pinograsp as pg
from pinograsp import contacts, forces, motion, planner, synthesis
from pinograsp.contacts import edges
from pinograsp.errors import InvalidInput
from pinograsp.viz import figures, still

BALL = pg.Sphere(radius=0.03, mass=0.2)
THREE = pg.contacts_at(None, BALL, 0.03 * np.array([[1.0, 0, 0], [-0.5, 0.75**0.5, 0], [-0.5, -(0.75**0.5), 0]]))
PROBLEM = pg.ForceProblem.holding(BALL, THREE, mu=0.6)
ANSWER = pg.optimize_forces(PROBLEM, 0.9)
WRONG = [None, "x", 7, [[1, [2]], 3], np.full(3, np.nan), object(), PROBLEM]
CALLS = {
    "conditions.problem": lambda x: pg.GraspConditions(mu=0.6).problem(BALL, x),
    "normal_force_limits": PROBLEM.normal_force_limits,
    "is_optimal": ANSWER.certificate.is_optimal,
    "active": ANSWER.certificate.active,
    "kept_friction": pg.Reserve().kept_friction,
    "reserve.problem": lambda x: pg.Reserve().problem(None if x is PROBLEM else x),
    "disturbance_margin": lambda x: forces.disturbance_margin(PROBLEM, np.eye(6)[0], impact_time=0.9, reaction=x),
    "load_factor": lambda x: forces.load_factor(BALL if x is PROBLEM else x, impact_time=0.9),
    "fingertips": lambda x: contacts.fingertips(x, None),
    "link_centre": lambda x: contacts.link_centre(x, None, 1),
    "on_edges": lambda x: edges.on_edges(BALL, x),
    "past_edges": lambda x: edges.past_edges(BALL, THREE, x),
    "effort_of": lambda x: motion.effort_of(x, "effort"),
    "normal_at_rest": lambda x: motion.normal_at_rest(x, ANSWER),
    "record_failure": lambda x: planner.record_failure(x, "hand", {}),
    "problem_of": lambda x: synthesis.problem_of(None, BALL, THREE, x),
    "figure_files": figures.figure_files,
    "draw_picture": lambda x: still.draw_picture(x, 0.5),
    "inertia": lambda x: pg.Box(size=(0.1, 0.1, 0.1), mass=1.0, inertia="x" if x is None else x),
    "notes": lambda x: pg.Sphere(radius=0.1, mass=1.0, notes=x),
    "skew": pg.spatial.skew,
    "tangent_frame": pg.spatial.tangent_frame,
    "rotation_rpy": lambda x: pg.spatial.rotation_rpy(x, 0.0, 0.0),
    "inverse_of": pg.spatial.inverse_of,
    "pose_of": pg.spatial.pose_of,
}


@pytest.mark.parametrize("name", CALLS)
def test_wrong_kinds_are_refused_in_words(name):
    for wrong in WRONG:
        if name == "rotation_rpy" and isinstance(wrong, int):
            continue  # an angle
        with pytest.raises(InvalidInput):
            CALLS[name](wrong)
