"""Work in copies of a process: the same results, in order, and nothing left behind."""

from __future__ import annotations

import multiprocessing
import os
import signal
import subprocess
import sys
import threading
import time

import numpy as np
import pytest

from pinograsp.errors import CarryInfeasible, ContactNotReached, HandNotLoaded, InvalidInput, PinograspError
from pinograsp.processes import count_processes, forked_results

pytestmark = [
    pytest.mark.no_cover,
    pytest.mark.skipif(sys.platform != "linux", reason="processes are copied on Linux alone"),
]


def children():
    return len(multiprocessing.active_children())


def test_results_come_in_order_from_copies():
    before = children()
    late = [0.2, 0.0, 0.1, 0.0]

    def work(i):  # a closure, which no other way of starting processes could send
        time.sleep(late[i])
        return i, os.getpid()

    with forked_results(work, [(i,) for i in range(4)], 2) as results:
        found = list(results)
    assert [i for i, _ in found] == [0, 1, 2, 3]
    assert os.getpid() not in {pid for _, pid in found} and len({pid for _, pid in found}) == 2
    assert children() == before


def test_what_is_known_comes_back_as_itself():
    known, large = threading.Lock(), np.arange(10)  # a lock cannot be pickled
    with forked_results(lambda i: (i, known, large), [(0,), (1,)], 2, known=(known,)) as results:
        for i, (k, one, other) in enumerate(results):
            assert k == i and one is known and other is not large and np.array_equal(other, large)


def test_with_one_job_in_threads_and_in_copies_nothing_is_started():
    with forked_results(os.getpid, [(), ()], 1) as results:
        assert list(results) == [os.getpid()] * 2
    with forked_results(lambda _: count_processes(2), [(0,), (1,)], 2) as results:
        assert list(results) == [1, 1]
    seen = []
    thread = threading.Thread(target=lambda: seen.append(count_processes(2)))
    thread.start()
    thread.join()
    assert seen == [1] and count_processes(2) == 2


def test_what_is_not_asked_for_is_given_up():
    before, started = children(), time.monotonic()
    with forked_results(lambda i: time.sleep(60.0 * (i > 0)), [(i,) for i in range(9)], 2) as results:
        next(results)
    assert time.monotonic() - started < 30.0 and children() == before


def test_what_is_given_up_may_be_large():
    """Copies are ended while they send, which nothing waits for."""
    before = children()
    for _ in range(20):
        with forked_results(lambda i: bytes(i * 10**7), [(i,) for i in range(9)], 3) as results:
            next(results)
    assert children() == before


def test_errors_are_raised_where_they_are_asked_for():
    def fail(i):
        return 1 // i

    with forked_results(fail, [(1,), (0,)], 2) as results:
        assert next(results) == 1
        with pytest.raises(ZeroDivisionError):
            next(results)


def test_a_lost_process_is_told():
    lost = forked_results(lambda i: os._exit(1), [(0,), (1,)], 2)
    with pytest.raises(PinograspError, match="a process was lost"), lost as results:
        list(results)


def test_ctrl_c_is_the_parents_alone():
    def ask(_):
        os.kill(os.getpid(), signal.SIGINT)
        return "went on"

    with forked_results(ask, [(0,), (1,)], 2) as results:
        assert list(results) == ["went on"] * 2


ORPHANS = """
import os, sys, time
from pinograsp.processes import forked_results
def work(i):
    os.write(1, b"%d\\n" % os.getpid())
    time.sleep(600)
with forked_results(work, [(0,), (1,)], 2) as results:
    list(results)
"""


def test_copies_end_with_a_parent_that_is_killed():
    running = subprocess.Popen([sys.executable, "-c", ORPHANS], stdout=subprocess.PIPE, text=True)
    copies = [int(running.stdout.readline()) for _ in range(2)]
    running.kill()
    running.wait()
    left, end = copies, time.monotonic() + 30.0
    while left and time.monotonic() < end:
        left = [pid for pid in left if _runs(pid)]
        time.sleep(0.01)
    assert not left


def _runs(pid: int) -> bool:
    """Whether a process runs, and is not a zombie that nobody waits for."""
    try:
        with open(f"/proc/{pid}/stat") as file:
            return file.read().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    "error",
    [
        InvalidInput("a word"),
        HandNotLoaded("a.urdf", ["one", "two"]),
        ContactNotReached("thumb", "too far"),
        CarryInfeasible("no timing", at=0.5, solution={"any": 1}, factor=0.2),
    ],
)
def test_errors_come_from_copies_as_they_are(error):
    with forked_results(lambda _: error, [(0,), (1,)], 2) as results:
        again = next(results)
    assert type(again) is type(error) and str(again) == str(error) and vars(again) == vars(error)
    assert isinstance(again, PinograspError) and again is not error
