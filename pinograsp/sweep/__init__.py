"""Sweeps: plans over ranges or random draws of a case's inputs, as rows on disk."""

from pinograsp.cases.sweep_file import SweepSpec, load_sweep
from pinograsp.sweep.rows import FIGURES
from pinograsp.sweep.run import Sweep, sweep
from pinograsp.sweep.store import read_sweep

__all__ = ["FIGURES", "Sweep", "SweepSpec", "load_sweep", "read_sweep", "sweep"]
