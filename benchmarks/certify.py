"""Grasps certified in bulk: how many a second, and whether a simulation agrees.

    python benchmarks/certify.py --seed 7 [--count 20000]
    python benchmarks/certify.py --seed 7 --simulate 500 [--jobs 2]

Postures are found grasps (``find_grasps``), each joint, the hand's place and its direction changed at random. The
objects are simple ones of the hand's size; the throughput is told for a watering can of 20 convex parts, too.

The simulation (MuJoCo, the hand's own servos) closes the hand, sends the certificate's torques, lets the object go and
shakes it with 3 m/s^2 at 2 Hz askew to all axes for a second. Grasps that are certified are to hold. The others that
touch are given the forces that a friction of 1.5 would allow, at the real friction, and pushed with the reserve in the
direction that the squeeze bears least: they are to be lost. Those within 10 % of the threshold, by the friction they
need or by the reserve they bear, are counted apart. Writes certify.csv beside this file.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
import time
from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import trimesh
from grasps import objects, width
from joblib import Parallel, delayed
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.certification import Certificates, Certifier, make_trial
from pinograsp.errors import PinograspError, Status
from pinograsp.simulation.settings import Disturbance, Push

HERE = Path(__file__).resolve().parent
MU, DENSITY, ROUGH, BAND = 0.6, 300.0, 1.5, 0.1
SHAKE = 3.0 * np.array([0.6, 0.48, 0.64])
GEOMETRIC = (Status.PENETRATES, Status.SELF_COLLISION, Status.NO_CONTACT, Status.JOINT_LIMIT)


def watering_can(w: float) -> pg.Mesh:
    """A body of 12 slices, a spout of 4 and a handle of 4, for a hand of width w [m]."""
    radius, height, parts = 0.2 * w, 0.6 * w, []
    for i in range(12):
        turns = 2 * np.pi / 12 * (i + np.array([0.0, 0.5, 1.0]))
        ring = np.column_stack([np.cos(turns), np.sin(turns)]) * radius
        base = np.vstack([[0.0, 0.0], ring])
        parts.append(np.vstack([np.column_stack([base, np.full(4, z)]) for z in (-height / 2, height / 2)]))
    for i in range(4):
        ends = [np.array([radius * (0.9 + 0.35 * j), 0.0, height * (-0.3 + 0.2 * j)]) for j in (i, i + 1)]
        thick = 0.03 * w * (1.6 - 0.3 * i)
        parts.append(np.vstack([end + thick * np.array(corner) for end in ends for corner in np.ndindex(2, 2, 2)]))
        turns = np.pi / 4 * (i + np.array([0.0, 1.0])) - np.pi / 2
        for_handle = [
            -np.array([0.9 * radius + 0.3 * height * np.cos(t), 0.0, 0.35 * height * np.sin(t)]) for t in turns
        ]
        side = 0.035 * w * (np.array(list(np.ndindex(2, 2, 2))) - 0.5)
        parts.append(np.vstack([end + side for end in for_handle]))
    with tempfile.TemporaryDirectory() as folder:
        for i, corners in enumerate(parts):
            trimesh.PointCloud(corners).convex_hull.export(Path(folder) / f"part_{i:02d}.stl")
        return pg.Mesh.load(folder, density=DENSITY)


def perturbed(
    search: pg.synthesis.GraspSearch, count: int, noise: float, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """Postures (N, n) and root poses (N, 4, 4), near the grasps found: joints by ``noise`` [rad], half of it for the
    hand's direction, and a 20th of a metre times it for its place.
    """
    q, roots = [], []
    for i in range(count):
        closure = search.grasps[i % len(search.grasps)].closure
        hand, body = closure.hand, closure.object
        scale = np.where(hand.slides, 0.03, 1.0)
        q.append(np.clip(closure.q + noise * scale * rng.normal(size=hand.n), hand.lower, hand.upper))
        change = np.eye(4)
        change[:3, :3], change[:3, 3] = pin.exp3(noise / 2 * rng.normal(size=3)), noise / 20 * rng.normal(size=3)
        roots.append(body.shape_pose @ change @ np.linalg.inv(body.shape_pose) @ hand.pose)
    return np.array(q), np.array(roots)


def searched(hand: pg.HandModel, body: pg.objects.body.Body, seed: int, samples: int) -> pg.synthesis.GraspSearch:
    return pg.find_grasps(hand, body, pg.GraspConditions(mu=MU), count=samples, seed=seed)


def throughput(count: int, seed: int) -> None:
    """Grasps a second on one thread and on two, best of three runs, and where the time of one goes."""
    rows = []
    for name, shape in (("panda", "box"), ("allegro_right", "sphere"), ("allegro_right", "watering can")):
        hand = pg.load_hand(name)
        w = width(hand)
        body = watering_can(w) if shape == "watering can" else objects(w)[shape]
        q, roots = perturbed(searched(hand, body, seed, 32), count, 0.01, np.random.default_rng(seed))
        row: dict = {"hand": name, "object": shape}
        for threads in (1, 2):
            certifier, least = Certifier(hand, body, pg.GraspConditions(mu=MU), threads=threads), np.inf
            for _ in range(3):
                started = time.perf_counter()
                found = certifier(q, roots)
                least = min(least, time.perf_counter() - started)
            row[f"threads_{threads}"] = f"{count / least:.0f}"
            if threads == 1:
                row |= {f"{stage}_us": f"{1e6 * spent / count:.0f}" for stage, spent in found.elapsed.items()}
        reasons = Counter(str(Status.from_code(one)) for one in found.reason.tolist())
        rows.append(row | {"held": reasons["held"], "reasons": len(reasons)})
    print(table(rows))
    print(f"largest memory {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MiB")


def trial(certificates: Certificates, rough: Certificates, i: int) -> dict:
    """What the simulation makes of grasp i, and whether the certificate said so."""
    reason, reserve, mu = Status.from_code(certificates.reason[i]), certificates.reserve[i], certificates.least_mu[i]
    row = {
        "hand": certificates.hand.name,
        "object": type(certificates.object).__name__,
        "reason": str(reason),
        "reserve": f"{reserve:.3f}",
        "least_mu": f"{mu:.3f}",
        "effort": f"{certificates.effort[i]:.3f}",
        "contacts": int(certificates.counts[i]),
    }
    disturbance = Disturbance(shake=SHAKE, shake_frequency=2.0)
    source, near = certificates, 1 - BAND < certificates.effort[i] < 1 + BAND or abs(mu / MU - 1) < BAND
    if reason is Status.HELD:
        near |= reserve < 1 + BAND
    if reason in (Status.FRICTION, Status.NO_FORCES):
        source = rough
        disturbance = Disturbance(mu=MU)
    elif reason is not Status.HELD:
        near |= reserve > 1 - BAND
        push = Push(wrench_o=certificates.weakest[i], start=0.2, duration=0.8)
        disturbance = Disturbance(pushes=(push,))
    if source is rough and not rough.normal_forces[i].any():
        source = squeezing(certificates, i)
    try:
        task = make_trial(source, i)
        verdict = pg.simulate(task, disturbance=disturbance).verdict
    except PinograspError as error:
        return row | {"near": near, "held": "", "agrees": "", "why": str(error)[:200]}
    why = "; ".join(verdict.causes) if not verdict.held else ""
    agrees = verdict.held == (reason is Status.HELD)
    force = f"{source.normal_forces[i].max():.3g}"
    return row | {"force_N": force, "near": near, "held": verdict.held, "agrees": agrees, "why": why[:200]}


def squeezing(found: Certificates, i: int) -> Certificates:
    """Grasp i with all contacts pressing with the weight, where no friction has forces that balance."""
    weight = found.object.mass * 9.81
    forces = weight * found.normals_o
    count, hand = int(found.counts[i]), found.hand.placed(found.roots[i])
    limits = pg.torque_limits(hand, found.contacts(i), found.q[i], limit=np.inf)
    torques = np.array(found.torques)
    torques[i] = limits.torques(forces[i, :count])
    return replace(found, forces_o=forces, torques=torques)


def simulate_certified(count: int, seed: int, jobs: int, hands: list[str], noise: float) -> list[dict]:
    """Trials of ``count`` grasps that touch, in equal parts of hands and simple objects."""
    rng = np.random.default_rng(seed)
    tasks = []
    pairs = [(hand, shape) for hand in hands for shape in ("cylinder", "sphere", "box")]
    for name, shape in pairs:
        hand = pg.load_hand(name)
        body = objects(width(hand))[shape]
        search = searched(hand, body, seed, 32)
        q, roots = perturbed(search, 4 * (count // len(pairs) + 1), noise, rng)
        found = pg.certify(hand, body, q, pg.GraspConditions(mu=MU), roots=roots)
        rough = pg.certify(hand, body, q, pg.GraspConditions(mu=ROUGH), roots=roots)
        touching = [i for i in range(len(q)) if Status.from_code(found.reason[i]) not in GEOMETRIC]
        tasks += [delayed(trial)(found, rough, i) for i in touching[: count // len(pairs) + 1]]
    done = Parallel(jobs, return_as="generator")(tasks)
    return list(tqdm(done, total=len(tasks)))


COLUMNS = (
    *("hand", "object", "reason", "reserve", "least_mu", "effort", "contacts", "force_N", "near", "held", "agrees"),
    "why",
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--count", type=int, default=20000, help="postures of the throughput")
    parser.add_argument("--simulate", type=int, default=0, help="grasps to simulate")
    parser.add_argument(
        "--hands", nargs="+", default=["allegro_right", "psyonic_right", "hey5", "panda", "baxter_left"]
    )
    parser.add_argument("--noise", type=float, default=0.02, help="of the joints [rad]")
    parser.add_argument("--jobs", type=int, default=2)
    args = parser.parse_args()
    if not args.simulate:
        throughput(args.count, args.seed)
        return
    rows = simulate_certified(args.simulate, args.seed, args.jobs, args.hands, args.noise)
    notes = (f"seed {args.seed}", f"noise {args.noise:g}", f"mu {MU}", f"{DENSITY:g} kg/m^3")
    whole = [{name: row.get(name, "") for name in COLUMNS} for row in rows]
    write_rows(HERE / "certify.csv", header(("numpy", "pin", "coal", "mujoco-core"), *notes), whole)
    print_agreement(rows)


def print_agreement(rows: list[dict]) -> None:
    """By reason: how many were held, lost and not tried; and the share that agrees, away from the threshold."""
    found = Counter((row["reason"], bool(row["near"]), str(row["held"])) for row in rows)
    lines = []
    for reason, near in sorted({key[:2] for key in found}):
        held, lost, none = (found[reason, near, value] for value in ("True", "False", ""))
        line = {"reason": reason, "near": "near" if near else "", "held": held, "lost": lost, "not tried": none}
        lines.append(line)
    print(table(lines))
    clear = [bool(row["agrees"]) for row in rows if not row["near"] and row["held"] != ""]
    print(f"{sum(clear)} of {len(clear)} agree away from the threshold: {100 * np.mean(clear):.1f} %")


if __name__ == "__main__":
    main()
