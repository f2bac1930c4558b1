"""How long it takes to plan a motion, with its torques, for forces that are known.

    python benchmarks/motion.py [--repeats 50]

The paper's case (certified optimum, wrench balance), once with its hand closed on the object and once with the points
of its table alone, where dozens of postures are tried; and hands of the catalogue on the objects of ``grasps.py``:
the best grasp that a small search finds, and the motion that its plan ends with. Timed in turn, so that all meet the
same machine; processor time tells what a busy machine adds. ``presses`` is how often a closed hand's press was worked
out until friction and servos leave the planned forces: the time goes with it. Writes motion.csv beside this file.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable
from pathlib import Path
from unittest.mock import patch

import numpy as np
from grasps import MU, objects, width
from results import header, table, write_rows

import pinograsp as pg
from pinograsp.forces import optimize_grasp
from pinograsp.motion import MotionSpec, plan_motion, surfaces
from pinograsp.plan import Motion
from pinograsp.planner import plan_best, rounds

HERE = Path(__file__).resolve().parent
PAIRS = (
    *(("allegro_right", shape) for shape in ("sphere", "box", "cylinder")),
    ("g1_right", "box"),
    ("psyonic_right", "sphere"),
)
SAMPLES, SEED = 16, 7
# The paper's contact points [m] and final angles [deg].
POINTS = {"thumb": (-2.6e-3, -9.6e-3, 61.5e-3), "index": (4.7e-3, 8.8e-3, 71.0e-3), "middle": (1.7e-3, 9.7e-3, 50.0e-3)}


def last_motion(plan: Callable[[], object]) -> Callable[[], Motion]:
    """The last call of ``plan_motion`` that a planner makes, to be made again."""
    calls: list[Callable[[], Motion]] = []

    def noted(*values, **options):
        calls.append(lambda: plan_motion(*values, **options))
        return plan_motion(*values, **options)

    with patch.object(rounds, "plan_motion", noted):
        plan()
    return calls[-1]


def paper() -> Callable[[], Motion]:
    return last_motion(pg.load_case("paper", {"forces.search": "convex", "forces.balance": "wrench"}).plan)


def points() -> Callable[[], Motion]:
    """The paper's points without the posture of a closed hand: every posture that reaches them is tried."""
    case = pg.load_case("paper")
    hand, plan = case.load_hand(), case.plan()
    body = plan.problem.object
    angles = {finger.name: plan.motion.q[plan.motion.impact, finger.dofs] for finger in hand.fingers}
    problem = pg.ForceProblem.holding(
        body, pg.contacts_at(hand, body, POINTS), mu=0.7, balance="force", friction=pg.Friction(), max_depth=5e-3
    )
    forces = optimize_grasp(problem, progress=False)
    spec = MotionSpec(posture={name: angles[name] for name in POINTS})
    return lambda: plan_motion(hand, forces, spec)


def closed(name: str, shape: str) -> Callable[[], Motion]:
    """A hand of the catalogue on an object of its size."""
    hand = pg.load_hand(name)
    body, conditions = objects(width(hand))[shape], pg.GraspConditions(mu=MU)
    search = pg.find_grasps(hand, body, conditions, count=SAMPLES, seed=SEED, jobs=1, progress=False)
    return last_motion(lambda: plan_best(search, conditions))


def presses(call: Callable[[], Motion]) -> int:
    with patch.object(surfaces, "_press", wraps=surfaces._press) as counted:
        call()
    return counted.call_count


def in_turn(calls: dict, repeats: int) -> dict[str, np.ndarray]:
    """Seconds of each call, of the clock and of the processor (repeats, 2), one after the other in every round."""
    spent: dict[str, list[tuple[float, float]]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(repeats):
        for name, call in calls.items():
            clock, process = time.perf_counter(), time.process_time()
            call()
            spent[name].append((time.perf_counter() - clock, time.process_time() - process))
    return {name: np.array(times) for name, times in spent.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--repeats", type=int, default=50)
    parser.add_argument("--out", type=Path, default=HERE / "motion.csv")
    options = parser.parse_args()
    calls = {"paper": paper(), "paper, points alone": points()}
    calls |= {f"{name}, {shape}": closed(name, shape) for name, shape in PAIRS}
    found = []
    for name, times in in_turn(calls, options.repeats).items():
        motion = calls[name]()
        clock, process = 1e3 * times.T
        found.append(
            {
                "case": name,
                "contacts": motion.forces_o.shape[1],
                "joints": motion.q.shape[1],
                "samples": len(motion.times),
                "postures": sum(motion.postures.values()),
                "presses": presses(calls[name]),
                "status": str(motion.status),
                "median_ms": f"{np.median(clock):.1f}",
                "p99_ms": f"{np.percentile(clock, 99):.1f}",
                "process_median_ms": f"{np.median(process):.1f}",
                "process_p99_ms": f"{np.percentile(process, 99):.1f}",
            }
        )
    print(table(found))
    notes = (f"{options.repeats} in turn", f"{SAMPLES} samples a pair, seed {SEED}")
    write_rows(options.out, header(("numpy", "scipy", "pin", "coal"), *notes), found)


if __name__ == "__main__":
    main()
