"""How numba (extra ``fast``) compiles the kernels: with a cache on disk where one can be written, and with one message,
because compiling takes a minute or two.

A function's code contains that of the functions that it calls. Numba takes it from the cache as long as the function's
own file is as it was; here, as long as all Python files of its folder, and this one, are.
"""

from __future__ import annotations

import contextlib
import functools
import hashlib
import logging
import sys
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, ParamSpec, TypedDict, TypeVar

import numba
from numba.core import event
from numba.core.caching import FunctionCache
from numba.core.options import DefaultOptions

if TYPE_CHECKING:
    from typing_extensions import Unpack

_Parameters = ParamSpec("_Parameters")
_Result = TypeVar("_Result")

_LOG = logging.getLogger("pinograsp")
_NOT_KEPT = "again in every process, because no cache folder can be written: set NUMBA_CACHE_DIR to one that can"


class Flags(TypedDict, total=False):
    """Those of numba's options that the kernels use."""

    fastmath: set[str]
    error_model: Literal["python", "numpy"]
    nogil: bool
    inline: Literal["always"]
    counted: bool  # False: without counting references to arrays, where numba can


def jit(**flags: Unpack[Flags]) -> Callable[[Callable[_Parameters, _Result]], Callable[_Parameters, _Result]]:
    """``numba.njit`` with a cache on disk; a cache that cannot be read or written is no error."""
    options: dict[str, Any] = {**flags}
    counted = options.pop("counted", True)
    if hasattr(DefaultOptions, "_nrt"):  # it has no public name; without it everything counts, which is slower
        options["_nrt"] = counted

    def decorate(function: Callable[_Parameters, _Result]) -> Callable[_Parameters, _Result]:
        dispatcher: Any = numba.njit(**options)(function)  # more than a function, and of older numba without types
        try:
            dispatcher._cache = _Cache(function)
        except RuntimeError:  # neither the package's folder nor the user's can be written, or there are no sources
            _Announcer.kept = False
        compiled: Callable[_Parameters, _Result] = dispatcher
        return compiled

    return decorate


@functools.cache
def _digest(times: tuple[tuple[Path, int], ...]) -> str:
    """Of the contents of files; their times of change are there so that a file that has changed is read again."""
    digest = hashlib.sha256()
    for source, _ in times:
        digest.update(source.name.encode() + hashlib.sha256(source.read_bytes()).digest())
    return digest.hexdigest()


class _Cache(FunctionCache):
    """A function that cannot be read is compiled again; one that cannot be written is not kept."""

    def __init__(self, function: Callable[..., object]):
        super().__init__(function)
        sources = sorted(Path(function.__code__.co_filename).parent.glob("*.py"))
        if not sources and not getattr(sys, "frozen", False):  # frozen programs are one file, which numba looks at
            raise RuntimeError(f"no sources beside {function.__code__.co_filename}")
        sources += [Path(__file__)] if sources else []
        times = tuple((source, source.stat().st_mtime_ns) for source in sources)
        self._cache_file._source_stamp = self._cache_file._source_stamp, _digest(times)

    def load_overload(self, sig: object, target_context: object) -> object:
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # damaged bytes: unpickling them may raise anything
            with contextlib.suppress(OSError):
                self.flush()
            return None

    def save_overload(self, sig: object, data: object) -> None:
        try:
            super().save_overload(sig, data)
        except OSError as error:
            _LOG.warning("pinograsp: compiled solvers cannot be kept (%s): %s", error, _NOT_KEPT)
            self.disable()


class _Announcer(event.Listener):
    """Logs once that functions are being compiled, so that nobody waits without knowing why."""

    kept = True
    announced = False

    def on_start(self, started: event.Event) -> None:
        if not self.announced and started.data["dispatcher"].py_func.__module__.startswith("pinograsp."):
            self.announced = True
            _LOG.warning(
                "pinograsp: compiling solvers, %s: one minute or two", "once per machine" if self.kept else _NOT_KEPT
            )

    def on_end(self, ended: event.Event) -> None:
        pass


event.register("numba:compile", _Announcer())
