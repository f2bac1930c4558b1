"""Bulk runs: sweeps of a case over its inputs, and certificates of data sets of grasps."""

from pinograsp.cases.sweep_file import SweepSpec, load_sweep
from pinograsp.sweep.certified import Certified, DataSet, certify_files, read_certified, written_back
from pinograsp.sweep.rows import FIGURES
from pinograsp.sweep.run import Sweep, sweep
from pinograsp.sweep.store import read_sweep

__all__ = [
    "FIGURES",
    "Certified",
    "DataSet",
    "Sweep",
    "SweepSpec",
    "certify_files",
    "load_sweep",
    "read_certified",
    "read_sweep",
    "sweep",
    "written_back",
]
