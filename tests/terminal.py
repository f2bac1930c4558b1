"""Commands on a terminal of their own."""

from __future__ import annotations

import contextlib
import fcntl
import os
import re
import struct
import subprocess
import sys
import termios


def on_a_terminal(folder, *arguments, columns: int = 80, rows: int = 24) -> tuple[int, list[str]]:
    """Exit code, and the lines on a terminal of that size, without what steers it."""
    screen, other = os.openpty()
    fcntl.ioctl(other, termios.TIOCSWINSZ, struct.pack("HHHH", rows, columns, 0, 0))
    environment = {name: value for name, value in os.environ.items() if name not in ("COLUMNS", "LINES")}
    with subprocess.Popen(
        [sys.executable, "-m", "pinograsp.cli", *arguments],
        cwd=folder,
        stdin=other,
        stdout=other,
        stderr=subprocess.DEVNULL,
        env=environment,
    ) as process:
        os.close(other)
        told = b""
        with contextlib.suppress(OSError):  # the end of the process
            while read := os.read(screen, 65536):
                told += read
        os.close(screen)
    return process.returncode, [re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", line) for line in told.decode().splitlines()]
