"""Simulated logs with hidden truths: torque constants, masses, contact stiffness and friction, as they are identified.

    python benchmarks/identified_logs.py --seed 7 [--logs 200] [--motors DIR] [--json]

Each log is of an Allegro hand's index finger, whose drives are servos drawn from files of Rhoban's BAM (``--motors``,
its ``*_m6.json``), or from ranges like theirs: friction by load and speed (model m6), backlash up to 0.01 rad,
registers that lag up to 20 ms, are noisy and whole numbers, positions in 4096 steps a turn. In one of five gravity
lies along the axes of the joints and no mass is fixed to the tip: the motion takes next to no torque, and what drives
make can hardly be told. Then the finger carries an unknown mass of 50 to 300 g. A finger of its own closes on a stop,
with an unknown contact law, sensor lag and latency; a contact slips with an unknown friction coefficient. Writes
identified_logs.csv beside this file; the last line is JSON with ``--json``.
"""

from __future__ import annotations

import argparse
import json
import time
from pathlib import Path

import numpy as np
import pinocchio as pin
from results import header, table, write_rows

import pinograsp as pg
from pinograsp.identification import (
    Log,
    MotionLog,
    identify_closings,
    identify_friction,
    identify_load,
    identify_motion,
)

HERE = Path(__file__).resolve().parent
HAND, JOINTS, TIP = "allegro_right", (1, 2, 3), "link_3.0_tip"
STEP, RATE, LONG = 5e-4, 100.0, 12.0  # [s], [Hz], [s]
KNOWN_MASS = 0.1  # [kg] fixed to the tip as drives are identified
# Of the motors where no files are given: (least, largest), those of MX, XL and STS servos in model m6.
RANGES = {
    "kt": (0.4, 2.7),
    "friction_base": (0.0, 0.05),
    "friction_stribeck": (0.0, 0.15),
    "load_friction_motor": (0.0, 0.3),
    "load_friction_external": (0.0, 0.3),
    "load_friction_motor_stribeck": (0.0, 0.2),
    "load_friction_external_stribeck": (0.0, 0.2),
    "load_friction_motor_quad": (0.0, 0.01),
    "load_friction_external_quad": (0.0, 0.01),
    "dtheta_stribeck": (0.02, 3.0),
    "alpha": (0.5, 3.0),
    "friction_viscous": (0.005, 0.08),
    "armature": (0.002, 0.03),
}


def draw_motor(rng, motors):
    """A servo of the size of a finger's: the shares of friction as measured, torques scaled."""
    motor = dict(motors[rng.integers(len(motors))]) if motors else {k: rng.uniform(*v) for k, v in RANGES.items()}
    size = rng.uniform(0.1, 0.3) if motor["kt"] > 1 else rng.uniform(0.6, 1.8)
    for name in ("kt", "friction_base", "friction_stribeck", "friction_viscous"):
        motor[name] *= size
    motor["kt"] *= 1e-3  # of a register that counts milliamperes
    motor["armature"] *= 0.3 * size
    return motor | {"backlash": rng.uniform(0, 0.01), "lag": rng.uniform(0, 0.02), "offset": rng.normal(0, 0.005)}


def drive_effort(motor, torque, dq, ddq):
    """Effort of the motor that makes a joint's torque: friction of BAM's model m6."""
    sign, load = np.sign(dq), -torque
    wanted = torque + motor["armature"] * ddq + motor["friction_viscous"] * dq + motor["offset"]
    slow = np.exp(-(np.abs(dq / motor["dtheta_stribeck"]) ** motor["alpha"]))
    effort = wanted
    for _ in range(40):
        gears = np.abs(load * motor["load_friction_external"] - effort * motor["load_friction_motor"])
        gears += slow * np.abs(
            load * motor["load_friction_external_stribeck"] - effort * motor["load_friction_motor_stribeck"]
        )
        quad = np.abs(effort**2 * motor["load_friction_motor_quad"] - load**2 * motor["load_friction_external_quad"])
        effort = wanted + sign * (motor["friction_base"] + slow * motor["friction_stribeck"] + gears + quad)
    return effort


def log_motion(hand, motors, rng, mass):
    """A log of the finger that swings slowly and shakes a little, with a mass at its tip."""
    model = hand.model.copy()
    frame = model.frames[hand.frame_id(TIP)]
    model.appendBodyToJoint(frame.parentJoint, pin.Inertia(mass, np.zeros(3), np.zeros((3, 3))), frame.placement)
    data, times = model.createData(), np.arange(0, LONG, STEP)
    q = np.tile(hand.resting, (len(times), 1))
    dq, ddq = np.zeros_like(q), np.zeros_like(q)
    for j in JOINTS:
        middle, far = (hand.lower[j] + hand.upper[j]) / 2, 0.35 * (hand.upper[j] - hand.lower[j])
        for share, low, high in ((0.8, 0.15, 0.3), (0.2, 0.8, 1.6)):
            w, phase = 2 * np.pi * rng.uniform(low, high), rng.uniform(0, 2 * np.pi)
            q[:, j] += share * far * np.sin(w * times + phase)
            dq[:, j] += share * far * w * np.cos(w * times + phase)
            ddq[:, j] -= share * far * w**2 * np.sin(w * times + phase)
        q[:, j] += middle - hand.resting[j]
    torques = np.array([pin.rnea(model, data, *one) for one in zip(q, dq, ddq)])
    rows = np.arange(0, len(times), round(1 / RATE / STEP))
    positions, registers = q[rows], np.full((len(rows), len(hand.drives)), np.nan)
    for j, motor in zip(JOINTS, motors):
        effort = drive_effort(motor, torques[:, j], dq[:, j], ddq[:, j])
        late = np.clip(rows - round(motor["lag"] / STEP), 0, None)
        registers[:, j] = np.round(effort[late] / motor["kt"] + rng.normal(0, 3, len(rows)))
        positions[:, j] += motor["backlash"] / 2 * np.sign(effort[rows])
    encoder = 2 * np.pi / 4096
    return MotionLog(source="simulated", times=times[rows], q=np.round(positions / encoder) * encoder, effort=registers)


def log_closings(rng):
    """Closings of a finger on a stop at two speeds and three limits, and the slope of its contact law at a force."""
    lag, latency, exponent = rng.uniform(0.02, 0.2), rng.uniform(0.005, 0.03), rng.uniform(1.0, 2.2)
    stiffness, dt, logs = rng.uniform(150, 500) / 20**exponent, 1e-3, []
    for speed in (40.0, 120.0):
        for limit in (60.0, 150.0, 350.0):
            rows, now = [], 0.0
            for _ in range(8):
                stop, x, register, halt = 700 + rng.normal(0, 0.3), 760.0, 0.0, None
                while True:
                    force = stiffness * max(stop - x, 0.0) ** exponent
                    register += (force - register) * dt / lag
                    if halt is None and register >= limit:
                        halt = now + latency
                    if halt is None or now < halt:
                        x -= speed * (0.6 if x < stop else 1.0) * dt
                    elif now > halt + 8 * lag:
                        x = min(x + 2000 * dt, 760.0)
                        if now > halt + 16 * lag + 0.2:
                            break
                    rows.append((now, x, register + rng.normal(0, 1.0), speed, limit))
                    now += dt
            values = np.array(rows)[::8]
            values[:, 1:3] = np.round(values[:, 1:3])
            named = dict(zip(("time", "position", "force", "speed", "limit"), values.T))
            logs.append(Log(source="simulated", units={"position": "count", "force": "count"}, **named))
    return logs, lambda force: exponent * stiffness ** (1 / exponent) * force ** (1 - 1 / exponent)


def log_slip(rng):
    """Normal and tangential forces of a contact that sticks, slips and sticks, with its coefficient."""
    mu, n = rng.uniform(0.2, 1.2), 600
    normal = rng.uniform(1, 8) * (1 + 0.2 * np.sin(np.linspace(0, 9, n)))
    pull = np.interp(np.arange(n), [0, 300, 450, n], [0, 1.3, 1.3, 0.2]) * mu * normal
    slips = pull > mu * normal
    tangential = np.where(slips, mu * normal, pull)
    noise = rng.normal(0, 0.02 * normal.mean(), (2, n))
    return mu, normal + noise[0], tangential + noise[1], slips


def run(seed, motors):
    rng = np.random.default_rng(seed)
    flat = rng.uniform() < 0.2
    # Gravity along the hand, or along the axes of the finger's joints, which it then loads not at all.
    gravity = (
        np.array([0.0, -9.81, 0.0])
        if flat
        else np.array([9.81 * np.cos(a := rng.uniform(-0.6, 0.6)), 0, 9.81 * np.sin(a)])
    )
    hand = pg.load_hand(HAND)
    turned = pin.SE3(pin.Quaternion.FromTwoVectors(gravity, np.array([0, 0, -9.81])).matrix(), np.zeros(3))
    hand = hand.placed(turned.homogeneous)
    drawn = [draw_motor(rng, motors) for _ in JOINTS]
    mass = 0.0 if flat else KNOWN_MASS
    found = identify_motion(hand, log_motion(hand, drawn, rng, mass), masses={TIP: mass} if mass else None)
    rows = []
    for j, motor in zip(JOINTS, drawn):
        name = hand.joint_names[j]
        told = found.drives.get(name)
        rows.append(("torque constant", motor["kt"], told and told.effort_step, flat))
    if found.drives and not flat:
        held = rng.uniform(0.05, 0.3)
        rows.append(("mass", held, identify_load(hand, log_motion(hand, drawn, rng, held), found, TIP)[0], False))
    logs, slope = log_closings(rng)
    contact = identify_closings(logs, seed=seed).contact
    at = float(np.median(contact.forces))
    rows.append(("contact stiffness", slope(at), contact.slope(at), False))
    mu, *contact_log = log_slip(rng)
    rows.append(("mu", mu, identify_friction(*contact_log)[0], False))
    return [
        {"seed": seed, "figure": name, "truth": truth, "told": told, "hidden": hidden}
        for name, truth, told, hidden in rows
    ]


def summarize(rows):
    summary = {}
    for name in ("torque constant", "mass", "contact stiffness", "mu"):
        own = [row for row in rows if row["figure"] == name]
        told = [row for row in own if row["told"] is not None and not row["hidden"]]
        errors = np.array([abs(row["told"][0] / row["truth"] - 1) for row in told])
        inside = [row["told"][1] <= row["truth"] <= row["told"][2] for row in told]
        hidden = [row for row in own if row["hidden"]]
        guessed = [row for row in hidden if row["told"] is not None]
        summary[name] = {
            "logs": len(told),
            "median_error": round(float(np.median(errors)), 4),
            "error_95": round(float(np.quantile(errors, 0.95)), 4),
            "inside_interval": round(float(np.mean(inside)), 4),
            "not_told": sum(row["told"] is None and not row["hidden"] for row in own),
            "hidden": len(hidden),
            "told_of_hidden": len(guessed),
            "hidden_inside": sum(row["told"][1] <= row["truth"] <= row["told"][2] for row in guessed),
        }
    return summary


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seed", type=int, required=True)
    parser.add_argument("--logs", type=int, default=200)
    parser.add_argument("--motors", type=Path)
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    files = [] if given.motors is None else sorted(given.motors.rglob("*_m6.json"))
    motors = [found for found in map(json.loads, (file.read_text() for file in files)) if found["kt"] < 10]
    begun, rows = time.perf_counter(), []
    for seed in np.random.SeedSequence(given.seed).generate_state(given.logs).tolist():
        rows += run(seed, motors)
    first = header(["numpy", "scipy", "pin"], f"seed {given.seed}, {given.logs} logs, {len(motors) or 'drawn'} motors")
    plain = [{**row, **dict(zip(("told", "low", "high"), row["told"] or ("", "", "")))} for row in rows]
    write_rows(HERE / "identified_logs.csv", first, plain)
    summary = summarize(rows)
    print(first)
    print(table([{"figure": name, **values} for name, values in summary.items()]))
    print(f"{time.perf_counter() - begun:.0f} s")
    if given.json:
        print(json.dumps(summary))


if __name__ == "__main__":
    main()
