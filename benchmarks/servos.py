"""Hands whose motors take positions only, on contacts softer and harder than planned: forces told, forces that come.

    python benchmarks/servos.py --seed 7 [--hands NAME ...] [--jobs 2]

Every plan of ``grasps.py`` is played by joint servos of 1, 3, 10 and 50 N m/rad (sliding joints 1 / (30 mm)^2 times as
stiff) on contacts a fifth, once and 20 times as stiff as planned. Four rules give the positions that are sent:

- ``plan``: q + tau / kp, what ``plan.to_csv(command="position", stiffness=kp)`` hands over: tau are the plan's torques;
- ``stiffness``: the same of a plan that is to bear these contacts, ``Reserve(softer=5, stiffer=20)``;
- ``twice``: from t_I on to 2 q_touch - q_before, q_before being the posture on the straight way from the open hand in
  which fingertips still have 10 mm to go: squeeze as far beyond the touch as the fingers were open before it;
- ``contact``: q_touch + J^T f / kp, the planned forces on the posture of touch, without gravity and depth.

Told by the plan, where it is ``ok``: whether friction and limits hold and the equilibrium is stable with these servos
on these contacts (``plan.force_band``, ``plan.object_stiffness``), and the band of every link's normal force over the
three stiffnesses.
Simulated by MuJoCo with the simulation's own contact law: whether the object is held, and the forces at the end. Writes
servos.csv beside this file, and prints how often what was told holds came to be held, and how often forces lay in the
band.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
from grasps import MU, SHAPES, thing, width
from joblib import Parallel, delayed
from results import header, table, write_rows
from tqdm import tqdm

import pinograsp as pg
from pinograsp.contacts import fingertips
from pinograsp.errors import PinograspError, Status
from pinograsp.hands import servo_gains
from pinograsp.planner import plan_best
from pinograsp.simulation.settings import Disturbance, Servo

HERE = Path(__file__).resolve().parent
GAINS, FACTORS, RULES = (1.0, 3.0, 10.0, 50.0), (0.2, 1.0, 20.0), ("plan", "stiffness", "twice", "contact")
HANDS = ("allegro_left", "psyonic_left", "g1_left", "talos_left", "tiago_pro_left")
EMPTY = dict.fromkeys(
    [
        "hand",
        "object",
        "rule",
        "gain",
        "factor",
        "told",
        "held",
        "off",
        "planned_N",
        "lowest_N",
        "highest_N",
        "simulated_N",
        "why",
    ],
    "",
)
BEFORE, HOLD, LEVER, ROOM = 0.01, 0.6, 0.03, (0.02, 0.05, 0.1)  # [m], [s], [m], shares of the largest force


def with_servos(hand: pg.HandModel, gain: float) -> pg.HandModel:
    """The hand with a position servo at every joint that has a motor of its own."""
    drives = []
    for drive in hand.drives:
        if len(drive.joints) == 1:
            slides = hand.is_prismatic(hand.model.getJointId(drive.joints[0]))
            own = gain / LEVER**2 if slides else gain
            drive = replace(drive, control="position", stiffness=own / drive.arms[0] ** 2)
        drives.append(drive)
    return hand.with_drives(drives)


def sent(plan: pg.GraspPlan, rule: str, gains: np.ndarray) -> tuple[pg.GraspPlan, Servo]:
    """The plan with the positions that a rule sends, and the servos that follow them."""
    if rule in ("plan", "stiffness"):  # q + tau / kp at the motors is the same as servos with tau as feed-forward
        return plan, Servo.of(plan.hand, gains)
    motion = plan.motion
    # At rest the torques are J^T f and gravity's.
    still = plan.closure.q
    share = np.clip((motion.times - motion.times[motion.impact]) / np.ptp(motion.times[motion.impact :]), 0.0, 1.0)
    if rule == "contact":
        torques = plan.solution.problem.torques
        pressed = still + (motion.holding_torques - (0.0 if torques is None else torques.bias)) / gains
    else:
        data, tips = plan.hand.model.createData(), []
        for q in (motion.q[0], still):
            pin.forwardKinematics(plan.hand.model, data, q)
            tips.append(fingertips(plan.hand, data))
        before = min(1.0, BEFORE / float(np.linalg.norm(tips[0] - tips[1], axis=1).mean()))
        pressed = still + before * (still - motion.q[0])
    q = np.where(share[:, None] > 0, still + share[:, None] * (pressed - still), motion.q)
    dq = np.gradient(q, motion.times, axis=0)
    moved = replace(plan, motion=replace(motion, q=q, dq=dq))
    return moved, Servo.of(plan.hand, gains, control="position")


def rows(hand_name: str, shape: str, seed: int) -> list[dict]:
    """What came of one hand and one object."""
    bare, conditions, found = pg.load_hand(hand_name), pg.GraspConditions(mu=MU), []
    body = thing(shape, width(bare))
    bearing = replace(conditions, reserve=pg.Reserve(softer=1 / FACTORS[0], stiffer=FACTORS[-1]))
    for gain in GAINS:
        hand, plans = with_servos(bare, gain), {}
        gains = servo_gains(hand)
        try:
            grasps = pg.find_grasps(hand, body, conditions, count=16, seed=seed, jobs=1, progress=False)
        except PinograspError as error:
            found.append(EMPTY | {"hand": hand_name, "object": shape, "gain": gain, "why": str(error)[:200]})
            continue
        for rule in RULES:
            try:
                if rule in ("plan", "stiffness"):
                    plans[rule] = plan_best(grasps, bearing if rule == "stiffness" else conditions)
                plan = plans[rule] if rule in plans else plans["plan"]
            except (PinograspError, KeyError) as error:
                none = {"hand": hand_name, "object": shape, "rule": rule, "gain": gain, "why": str(error)[:200]}
                found.append(EMPTY | none)
                continue
            band, stable = plan.force_band(gains, FACTORS), plan.object_stiffness(gains).is_stable()
            moved, servo = sent(plan, rule, gains)
            for i, factor in enumerate(FACTORS):
                seen = pg.simulate(
                    moved, servo=servo, hold=HOLD, support="fixed", disturbance=Disturbance(stiffness=factor)
                )
                links, last = list(dict.fromkeys(plan.contacts.links)), seen.times > seen.times[-1] - 0.1
                # A link's contacts press as one in the simulation; parts are named by finger or by link.
                of = np.array([[own == link for own in plan.contacts.links] for link in links], dtype=float)
                own = [{link, *np.array(plan.contacts.names)[row > 0]} for link, row in zip(links, of)]
                by_part = dict(zip(seen.parts, seen.normal_forces[last].mean(axis=0)))
                forces = np.array([sum(by_part.get(name, 0.0) for name in names) for names in own])
                told = band.normal_forces @ of.T
                off = np.maximum(told.min(axis=0) - forces, forces - told.max(axis=0)) / told.max()
                found.append(
                    {
                        "hand": hand_name,
                        "object": shape,
                        "rule": rule,
                        "gain": gain,
                        "factor": factor,
                        "told": bool(plan.status is Status.OK and band.holds[i] and stable),
                        "held": bool(seen.verdict.held),
                        "off": listed(np.maximum(off, 0.0)),
                        "planned_N": listed(of @ plan.forces.normal_forces),
                        "lowest_N": listed(told.min(axis=0)),
                        "highest_N": listed(told.max(axis=0)),
                        "simulated_N": listed(forces),
                        "why": seen.verdict.reason if not seen.verdict.held else band.remarks[i],
                    }
                )
    return found


def listed(forces: np.ndarray) -> str:
    return " ".join(f"{force:.3g}" for force in forces)


def summary(found: list[dict]) -> str:
    rooms = ", ".join(f"{100 * room:g} %" for room in ROOM)
    lines = []
    for rule in RULES:
        for gain in (*GAINS, None):
            own = [one for one in found if one["rule"] == rule and gain in (None, one["gain"]) and one["held"] != ""]
            told = [one for one in own if one["told"]]
            if own:
                off = np.array([float(value) for one in told for value in one["off"].split()])
                inside = ", ".join(f"{100 * np.mean(off <= room):.1f} %" for room in ROOM) if told else "-"
                lines.append(
                    {
                        "rule": rule,
                        "kp [N m/rad]": "all" if gain is None else f"{gain:g}",
                        "held": share(own),
                        "held where told": share(told),
                        "told": f"{len(told)} of {len(own)}",
                        f"forces in the band where told, to {rooms} of the largest": inside,
                    }
                )
    return table(lines)


def share(own: list[dict]) -> str:
    return f"{100 * np.mean([one['held'] for one in own]):.1f} %" if own else "-"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--hands", nargs="+", default=HANDS)
    parser.add_argument("--objects", nargs="+", default=SHAPES[:3], choices=SHAPES)
    parser.add_argument("--jobs", type=int, default=-1, help="pairs at the same time; -1: all cores")
    parser.add_argument("--out", type=Path, default=HERE / "servos.csv")
    options = parser.parse_args()
    pairs = [(hand, shape) for hand in options.hands for shape in options.objects]
    work = (delayed(rows)(hand, shape, options.seed) for hand, shape in pairs)
    found: list[dict] = []
    for own in tqdm(Parallel(options.jobs, return_as="generator")(work), total=len(pairs), unit="pair"):
        found += own
        notes = (f"seed {options.seed}", f"{HOLD:g} s held")
        write_rows(options.out, header(("numpy", "pin", "mujoco-core"), *notes), found)
    print(summary(found))


if __name__ == "__main__":
    main()
