"""
A taxel's curve
===============

Counts of a tactile sensor and newtons of a load cell give the curve between them, even
if their clocks differ.
"""

import matplotlib.pyplot as plt
import numpy as np

from pinograsp.identification import find_lag, identify_taxel

rng = np.random.default_rng(1)  # a simulated log in place of yours
stroke = np.sin(np.linspace(0, np.pi, 80)).clip(0.1) - 0.1
newtons = np.tile(8 * stroke, 6)
counts = 300 + 900 * np.sqrt(newtons) + 20 * rng.standard_normal(len(newtons))
newtons = np.roll(newtons, 3)  # its clock is three samples late

lag = find_lag(counts, newtons, most=10)
curve = identify_taxel(counts, newtons, lag=lag)
print(f"{lag} samples late, within {curve.noise.max():.2f} N")

figure, axes = plt.subplots(figsize=(6.4, 4), layout="constrained")
axes.plot(counts, newtons, ".", color="0.8", label="log as it is")
axes.plot(counts, np.roll(newtons, -lag), ".", label="clocks aligned")
axes.plot(curve.counts, curve.forces, color="k", label="calibration")
axes.set(xlabel="counts of the taxel", ylabel="normal force [N]")
axes.legend()
figure.savefig("taxel.png", dpi=120)
