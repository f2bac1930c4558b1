"""Writers that are killed at any moment."""

import subprocess
import sys
import time


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
