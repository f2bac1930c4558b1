"""Computing time by stage."""

from __future__ import annotations

import time


class Stopwatch:
    """Seconds by stage, from when it is made.

    Attributes:
        elapsed: of each stage [s].
    """

    def __init__(self, *stages: str):
        self.elapsed = dict.fromkeys(stages, 0.0)
        self._since = time.perf_counter()

    def stop(self, stage: str) -> None:
        """Count the time since the last stop as that of a stage."""
        now = time.perf_counter()
        self.elapsed[stage] += now - self._since
        self._since = now
