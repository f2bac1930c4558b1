"""Contact forces tick by tick: how long a step takes, and whether a 1 kHz loop keeps its time.

    python benchmarks/online.py [--steps 1000000] [--seconds 60] [--quick]

``OnlineForces.step`` with a new load and a new posture at every tick, Pinocchio (joint Jacobians, gravity) and joint
torques included: the paper's hand with 3 contacts, and a hand of 20 joints with 16, four to a finger, on a cylinder,
also with limits of 80 % of the torques that joints would bear at rest ("torque limits"). Loads wander: each component
is a sum of sines of unrelated periods, half to all of what the weight is. Every step is timed by itself; the garbage
collector is off, as in a real-time loop. "cold" starts from nothing at every tick. Then the loop: a tick every
millisecond for 60 s; a tick is missed when its forces come after the next one is due, late when it begins half a tick
after its time. The loop spins: on a system without real-time scheduling other processes still delay it, and pauses of a
virtual machine always do. "1 kHz loop of nothing" is the same loop without a step: what it misses the machine misses.
Then the multiplier QP of the paper's three contacts at fixed normal forces, in alternating blocks of 500 loads, and one
by one in turn, beside DAQP's own interface on matrices that are ready. Writes online.csv beside this file."""

from __future__ import annotations

import argparse
import gc
import time
from dataclasses import replace
from pathlib import Path

import daqp
import numpy as np
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.cases.published import AS_PUBLISHED
from pinograsp.forces import MultiplierQP

HERE = Path(__file__).resolve().parent
PERIOD = 1e-3
MOVES = 0.02  # [rad] of the joints about their posture
COLUMNS = (
    "case",
    "contacts",
    "joints",
    "mode",
    "steps",
    "median_us",
    "p99_us",
    "p99_9_us",
    "worst_us",
    "ok",
    "newton_steps_mean",
    "newton_steps_most",
    "seconds",
    "missed_ticks",
    "late_ticks",
    "daqp_median_us",
    "daqp_over_this",
)


def papers_hand() -> tuple:
    plan = pg.load_case("paper", {"forces.search": "convex", "friction.safety": 1.0, "friction.model": "cone"}).plan()
    return plan.hand, plan.motion.q[-1], plan.problem, (0.05, 60.0)


def many_contacts() -> tuple:
    """Four contacts on each of the four fingers of a hand of 20 joints, at the links' joints, facing a common axis."""
    hand = pg.load_hand("humanoid")
    q = 0.5 * (hand.lower + hand.upper)
    fingers = [finger for finger in hand.fingers if len(finger.links) >= 4][:4]
    origins = {f.name: hand.frame_placements(q, f.links[-4:])[:, :3, 3] for f in fingers}
    points = np.concatenate(list(origins.values()))
    centre = points.mean(axis=0)
    body = pg.Cylinder(
        radius=float(np.linalg.norm((points - centre)[:, :2], axis=1).mean()), height=1.0, mass=0.5, pose=placed(centre)
    )
    links = {f.name: list(f.links[-4:]) for f in fingers}
    contacts = pg.contacts_at(hand, body, origins, links=links, tolerance=1.0)
    problem = pg.ForceProblem.holding(body, contacts, mu=0.8, friction=pg.Friction(model="cone"), max_depth=5e-3)
    return hand, q, problem, (0.02, 60.0)


def placed(centre) -> np.ndarray:
    pose = np.eye(4)
    pose[:3, 3] = centre
    return pose


class Wander:
    """A load and a posture at any tick."""

    def __init__(self, problem, q, seed: int = 0):
        rng = np.random.default_rng(seed)
        self.base, self.q = np.array(problem.load), np.array(q)
        weight = float(np.linalg.norm(self.base[:3]))
        size = weight * np.array([1.0, 1.0, 1.0, *[problem.moment_length] * 3])
        self.parts = [
            (size * rng.uniform(-0.12, 0.12, 6), rng.uniform(0.2, 3.0, 6), rng.uniform(0, 6.3, 6)) for _ in range(3)
        ]
        self.turns = rng.uniform(0.2, 2.0, len(q)), rng.uniform(0, 6.3, len(q))

    def block(self, start: int, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Loads (count, 6) and postures (count, n)."""
        t = PERIOD * np.arange(start, start + count)[:, None]
        loads = self.base + sum(size * np.sin(6.2832 * rate * t + phase) for size, rate, phase in self.parts)
        rate, phase = self.turns
        return loads, self.q + MOVES * np.sin(6.2832 * rate * t + phase)


def timed(online, wander: Wander, steps: int, mode: str, label: str) -> dict:
    spent, newton, ok = np.empty(steps), np.empty(steps, dtype=int), 0
    clock, step, reset = time.perf_counter_ns, online.step, online.reset
    online.reset()
    for at in tqdm(range(0, steps, 10_000), desc=f"{label} {mode}", unit="10^4 steps", leave=False):
        count = min(10_000, steps - at)
        loads, postures = wander.block(at, count)
        gc.collect()
        gc.disable()
        for i in range(count):
            load, q = loads[i], postures[i]
            if mode == "cold":
                reset()
            before = clock()
            _, _, status = step(load, q=q)
            spent[at + i] = clock() - before
            newton[at + i] = online.steps
            ok += status is pg.Status.OK
        gc.enable()
    spent /= 1e3
    return {
        "mode": mode,
        "steps": steps,
        "median_us": f"{np.median(spent):.1f}",
        "p99_us": f"{np.percentile(spent, 99):.1f}",
        "p99_9_us": f"{np.percentile(spent, 99.9):.1f}",
        "worst_us": f"{spent.max():.0f}",
        "ok": ok,
        "newton_steps_mean": f"{newton.mean():.2f}",
        "newton_steps_most": newton.max(),
    }


def loop(step, wander: Wander, seconds: float, mode: str) -> dict:
    """A tick every millisecond: how many forces came too late."""
    ticks = round(seconds / PERIOD)
    loads, postures = wander.block(0, ticks)
    spent, missed, late, ok = np.empty(ticks), 0, 0, 0
    clock = time.perf_counter
    gc.collect()
    gc.disable()
    start = clock() + 0.01
    for i in range(ticks):
        due = start + i * PERIOD
        while clock() < due:  # sleeping would add the system's own delays
            pass
        begun = clock()
        late += begun - due > 0.5 * PERIOD
        _, _, status = step(loads[i], q=postures[i])
        done = clock()
        spent[i], ok = done - begun, ok + (status is pg.Status.OK)
        missed += done > due + PERIOD
    gc.enable()
    return {
        "mode": mode,
        "steps": ticks,
        "median_us": f"{1e6 * np.median(spent):.1f}",
        "p99_us": f"{1e6 * np.percentile(spent, 99):.1f}",
        "p99_9_us": f"{1e6 * np.percentile(spent, 99.9):.1f}",
        "worst_us": f"{1e6 * spent.max():.0f}",
        "ok": ok,
        "seconds": f"{seconds:g}",
        "missed_ticks": missed,
        "late_ticks": late,
    }


def multipliers(blocks: int = 10) -> list[dict]:
    """MultiplierQP and DAQP on the same loads."""
    case = pg.load_case("paper", AS_PUBLISHED)
    problem = case.make_problem(case.load_hand())
    normal = pg.grid_search(problem, progress=False).normal_forces
    own, rng = MultiplierQP(problem, normal), np.random.default_rng(0)
    loads = problem.load * (1 + 0.2 * rng.normal(size=(500 * blocks, 1)))
    loads[:, :3] += 0.2 * rng.normal(size=(len(loads), 3))
    columns = problem.scaled_columns
    H = (columns[:, :, :2] * (problem.pyramid * normal)[None, :, None]).reshape(problem.rows, -1)
    P, Ht, fixed = H.T @ H + 1e-9 * np.eye(6), np.ascontiguousarray(H.T), columns[:, :, 2] @ normal
    none, high, low, sense = np.zeros((0, 6)), np.ones(6), -np.ones(6), np.zeros(6, dtype=np.intc)
    methods = {
        "this": own.solve,
        "daqp": lambda load: daqp.solve(P, Ht @ (fixed + load[:3]), none, high, low, sense)[0],
    }
    rows, clock = [], time.perf_counter
    for mode in ("blocks", "interleaved"):
        spent = {name: [] for name in methods}
        if mode == "blocks":
            order = [(name, load) for block in np.split(loads, blocks) for name in methods for load in block]
        else:
            order = [(name, load) for load in loads for name in methods]
        for name, load in order:
            begun = clock()
            methods[name](load)
            spent[name].append(clock() - begun)
        this, other = (1e6 * np.median(spent[name]) for name in methods)
        rows.append(
            {
                "case": "multiplier QP",
                "contacts": 3,
                "mode": mode,
                "steps": len(loads),
                "median_us": f"{this:.2f}",
                "p99_us": f"{1e6 * np.percentile(spent['this'], 99):.2f}",
                "p99_9_us": f"{1e6 * np.percentile(spent['this'], 99.9):.2f}",
                "daqp_median_us": f"{other:.2f}",
                "daqp_over_this": f"{other / this:.2f}",
            }
        )
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--steps", type=int, default=1_000_000)
    parser.add_argument("--seconds", type=float, default=60.0, help="of the loop")
    parser.add_argument("--quick", action="store_true", help="10^4 steps, a loop of 1 s, nothing written")
    options = parser.parse_args()
    steps, seconds = (10_000, 1.0) if options.quick else (options.steps, options.seconds)
    rows = []
    for label, made in (("the paper's hand", papers_hand()), ("16 contacts", many_contacts())):
        hand, q, problem, limits = made
        online = pg.OnlineForces(problem, hand=hand, q=q, normal_forces=limits)
        wander = Wander(problem, q)
        base = {"case": label, "contacts": problem.k, "joints": hand.n}
        rows += [
            base | timed(online, wander, steps, "warm", label),
            base | timed(online, wander, max(steps // 20, 1000), "cold", label),
        ]
        rows.append(base | loop(online.step, wander, seconds, "1 kHz loop"))
        rows.append(base | loop(lambda load, q: (None, None, None), wander, seconds, "1 kHz loop of nothing"))
        torques = np.maximum(0.8 * np.abs(online.step(problem.load, q=q)[1]), 0.02)
        limited = replace(problem, torques=pg.torque_limits(hand, problem.contacts, q, limit=torques))
        limited = pg.OnlineForces(limited, hand=hand, q=q, normal_forces=limits)
        rows.append(base | timed(limited, wander, max(steps // 20, 1000), "torque limits", label))
    rows += multipliers(2 if options.quick else 20)
    print(table([{c: row.get(c, "") for c in COLUMNS} for row in rows]))
    if not options.quick:
        write_rows(
            HERE / "online.csv",
            header(("numpy", "pin"), "seed 0"),
            [{c: row.get(c, "") for c in COLUMNS} for row in rows],
        )


if __name__ == "__main__":
    main()
