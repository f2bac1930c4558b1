"""Bulk runs: sweeps of a case over its inputs, and certificates of data sets of grasps."""

from pinograsp.cases.sweep_file import SweepSpec, load_sweep
from pinograsp.sweep.certified import (
    Certified,
    DataSet,
    certify_files,
    find_missing_grasps,
    read_certified,
    written_back,
)
from pinograsp.sweep.rows import FIGURES
from pinograsp.sweep.run import Sweep, find_missing_rows, sweep
from pinograsp.sweep.shards import Missing
from pinograsp.sweep.store import read_sweep

__all__ = [
    "FIGURES",
    "Certified",
    "DataSet",
    "Missing",
    "Sweep",
    "SweepSpec",
    "certify_files",
    "find_missing_grasps",
    "find_missing_rows",
    "load_sweep",
    "read_certified",
    "read_sweep",
    "sweep",
    "written_back",
]
