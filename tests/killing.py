"""Writers that are killed at any moment."""

import functools
import multiprocessing
import signal
import subprocess
import sys
import time

import numpy as np


def start_and_kill(programs: list[list], after: float) -> None:
    """Run Python ``programs``, each a text and its arguments, and kill them ``after`` seconds from when all have said
    "ready".
    """
    started = []
    try:
        for program in programs:
            started.append(subprocess.Popen([sys.executable, "-c", *map(str, program)], stdout=subprocess.PIPE))
        for process in started:
            assert process.stdout.readline() == b"ready\n"
        time.sleep(after)
    finally:
        for process in started:
            process.kill()
            process.wait()
            process.stdout.close()


def finish_in_spite_of_kills(target, shards: int, kills: int, lasts: float, rng, at_once: int = 2) -> int:
    """Run ``target(begun, number)``, a partial function that calls ``begun()``, for each shard in a process of its own,
    some at once, and kill ``kills`` of them at random moments of their ``lasts`` seconds from then; start these again,
    until all are done.

    Returns:
        How many were killed.
    """
    context = multiprocessing.get_context("forkserver")
    context.set_forkserver_preload(
        ["pytest", "trimesh", "pyarrow.parquet", "pinograsp.certification", "pinograsp.sweep", "pinograsp.cases"]
    )
    waiting, running, killed = rng.permutation(np.arange(1, shards + 1)).tolist(), {}, 0
    try:
        while waiting or running:
            while waiting and len(running) < at_once:
                number, (begun, begins) = waiting.pop(0), context.Pipe(duplex=False)
                process = context.Process(target=_begin, args=(begins, target, number))
                process.start()
                running[process] = number, begun, rng.uniform(0, lasts)
            for process, (number, begun, after) in list(running.items()):
                if killed < kills and begun.poll():
                    time.sleep(after)
                    process.kill()
                    process.join()
                process.join(0.005)
                if process.exitcode is None:
                    continue
                del running[process]
                if process.exitcode == -signal.SIGKILL:
                    killed += 1
                    waiting.insert(int(rng.integers(len(waiting) + 1)), number)
                else:
                    assert process.exitcode == 0
    finally:
        for process in running:
            process.kill()
            process.join()
    return killed


def _begin(begins, target, number: int) -> None:
    target(functools.partial(begins.send, None), number)
