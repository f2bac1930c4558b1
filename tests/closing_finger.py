"""A finger that closes on a stop, simulated: not the package's model, but a loop of its own."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np


def close_on_stop(
    rng: np.random.Generator,
    *,
    speed: float,
    limit: float,
    trials: int = 8,
    lag: float = 0.12,
    latency: float = 0.02,
    stiffness: float = 0.5,
    exponent: float = 1.6,
    stall: float = 1500.0,
    noise: float = 0.0,
    rate: float = 200.0,
) -> dict[str, np.ndarray]:
    """Register values of closings from 1000 to a stop at 700 counts: speed in counts/s, forces in counts."""
    step = 1e-3
    every = round(1 / rate / step)
    rows, time = [], 0.0
    for _ in range(trials):
        x, register, stopped = 1000.0, 0.0, None
        stop_at = 700.0 + rng.normal(0, 0.3)
        phase = "close"
        since = 0.0
        while phase != "done":
            depth = max(stop_at - x, 0.0)
            force = stiffness * depth**exponent
            register += (force - register) * step / lag
            if phase == "close":
                if register >= limit and stopped is None:
                    stopped = since + latency
                if (stopped is None or since < stopped) and force < stall:
                    x -= speed * step * (1 if depth == 0 else 0.7)
                elif stopped is None and force >= stall:
                    stopped = since
                if stopped is not None and since > stopped + 8 * lag:
                    phase, since = "open", 0.0
            elif phase == "open":
                x = min(x + 2000 * step, 1000.0)
                if since > 8 * lag + 0.3:
                    phase = "done"
            if round(time / step) % every == 0:
                rows.append((time, x, register + rng.normal(0, noise) if noise else register, speed, limit))
            time += step
            since += step
    table = np.array(rows)
    table[:, 1:3] = np.round(table[:, 1:3])
    return dict(zip(("time", "position", "force", "speed", "limit"), table.T))


def write_log(path: Path, columns: dict[str, np.ndarray]) -> Path:
    with path.open("w", newline="") as stream:
        table = csv.writer(stream)
        table.writerow(columns)
        table.writerows(zip(*(values.tolist() for values in columns.values())))
    return path
