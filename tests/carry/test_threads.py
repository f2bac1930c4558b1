"""Carrying leaves BLAS's threads asleep: woken, each of them waits for more work on a processor of its own."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

# How often threads other than the main one ran, by the kernel's count, before and after.
RUN = """
import os, time
import numpy as np
import scipy.linalg
from pinograsp.carry.path import ArmPath
from pinograsp.spatial import multiply_rows

def count():
    time.sleep(0.3)
    others = [task for task in os.listdir("/proc/self/task") if int(task) != os.getpid()]
    return [int(open(f"/proc/self/task/{task}/schedstat").read().split()[2]) for task in others]

rows, matrix, before = np.ones((8000, 48)), np.ones((48, 32)), count()
ArmPath.through({"a": [0.0, 1.0, 0.5], "b": [0.0, 0.5, 1.0]})
multiply_rows(rows, matrix)
quiet = count()
rows @ matrix
print(len(before), quiet == before, count() != quiet)
"""


@pytest.mark.no_cover
def test_splines_and_products_of_many_rows_wake_no_threads():
    done = subprocess.run(
        [sys.executable, "-c", RUN],
        capture_output=True,
        text=True,
        check=True,
        env=os.environ | {"OPENBLAS_NUM_THREADS": "2"},
    )
    threads, asleep, would_wake = done.stdout.split()
    if threads == "0" or would_wake == "False":
        pytest.skip("this BLAS has no threads that a product of this size wakes")
    assert asleep == "True"
