"""MuJoCo's callbacks, which are those of the whole process: set aside while it reads or simulates a model, as found
afterwards.
"""

from __future__ import annotations

import contextlib
import threading
from collections.abc import Iterator
from typing import Any

import mujoco

# What changes motion or contacts of every model in the process. Warnings: MuJoCo would print that a state is unstable
# and write MUJOCO_LOG.TXT into the working folder, and the simulation reports divergence itself.
_NAMES = (
    "mju_user_warning",
    "mjcb_control",
    "mjcb_passive",
    "mjcb_contactfilter",
    "mjcb_sensor",
    "mjcb_act_dyn",
    "mjcb_act_gain",
    "mjcb_act_bias",
)
_LOCK = threading.Lock()
_found: dict[str, Any] = {}
_running = 0  # simulations in all threads: the first sets aside, the last puts back


@contextlib.contextmanager
def without_callbacks() -> Iterator[None]:
    """The caller's callbacks do not act within, and are there again at the end, whatever happens.

    Other threads that simulate models of their own meanwhile are without them, too.
    """
    global _running
    with _LOCK:
        _running += 1
        if _running == 1:
            for name in _NAMES:
                _found[name] = getattr(mujoco, f"get_{name}")()
                _put(name, _ignore if name == "mju_user_warning" else None)
    try:
        yield
    finally:
        with _LOCK:
            _running -= 1
            if _running == 0:
                for name in _NAMES:
                    _put(name, _found.pop(name))


def _put(name: str, callback: Any) -> None:
    getattr(mujoco, f"set_{name}")(callback)


def _ignore(text: str) -> None:
    """A warning that nobody hears."""
