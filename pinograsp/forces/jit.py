"""How numba (extra ``fast``) compiles the kernels: kept on disk wherever it can be, and told once, because it takes its
time.
"""

from __future__ import annotations

import contextlib
import logging

import numba
from numba.core import event
from numba.core.caching import FunctionCache

_LOG = logging.getLogger("pinograsp")
_NOT_KEPT = "in every process again, because no folder for it can be written: set NUMBA_CACHE_DIR to one that can"


def jit(**flags):
    """``numba.njit`` with a cache on disk that is never in the way."""

    def compiled(function):
        made = numba.njit(**flags)(function)
        try:
            made._cache = _Cache(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written
            _Announcer.kept = False
        return made

    return compiled


class _Cache(FunctionCache):
    """What cannot be read is compiled again, what cannot be written is not kept."""

    def load_overload(self, sig, target_context):
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damaged bytes: unpickling them may raise anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig, data):
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _LOG.warning("pinograsp: compiled solvers cannot be kept (%s): %s", error, _NOT_KEPT)
            self.disable()


class _Announcer(event.Listener):
    """Says that functions are compiled, which were not found in the cache, so that nobody waits in silence."""

    kept = True
    told = False

    def on_start(self, started):
        if not self.told and started.data["dispatcher"].py_func.__module__.startswith("pinograsp."):
            self.told = True
            _LOG.warning(
                "pinograsp: compiling solvers, %s: one minute or two", "once per machine" if self.kept else _NOT_KEPT
            )

    def on_end(self, ended):
        pass


event.register("numba:compile", _Announcer())
