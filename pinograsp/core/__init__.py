"""The compiled core, its headers and its CMake package. Installed without a compiler, the core is missing."""

from __future__ import annotations

import contextlib
import functools
import importlib
import importlib.util
import os
from importlib.metadata import PackageNotFoundError, distribution
from pathlib import Path
from types import ModuleType

from pinograsp.errors import ExtraMissing

CONVERGED, STALLED, INFEASIBLE = 0, 1, 2  # what the core answers
REMEDY = "install pinograsp with a C++17 compiler at hand, or from a wheel"  # for a missing core

_FOLDER = Path(__file__).resolve().parent
_LEVELS = ("base", "v3", "v4")  # instructions of x86-64; other processors have one

if not any(_FOLDER.glob("_core_base.*")):
    # Started in a checkout, Python takes the sources there, without modules: then those of the installed package.
    with contextlib.suppress(PackageNotFoundError):
        __path__.append(str(distribution("pinograsp").locate_file("pinograsp/core")))


@functools.cache
def is_installed() -> bool:
    """Whether the compiled core is there."""
    return importlib.util.find_spec(f"{__name__}._core_base") is not None


@functools.cache
def load() -> ModuleType:
    """The core for this processor; the environment variable PINOGRASP_CORE_LEVEL chooses a simpler one.

    Raises:
        ExtraMissing: it is not installed.
    """
    try:
        base = importlib.import_module(f"{__name__}._core_base")
    except ImportError as error:
        raise ExtraMissing(f"the compiled core is missing ({error}): {REMEDY}") from error
    best: str = base.best_level()
    wanted = os.environ.get("PINOGRASP_CORE_LEVEL", best)
    level = min(best, wanted, key=_LEVELS.index) if wanted in _LEVELS else best
    return base if level == "base" else importlib.import_module(f"{__name__}._core_{level}")


def get_include() -> str:
    """Folder of the C++ headers, to be searched by a compiler."""
    return str(_FOLDER / "include")


def get_cmake_dir() -> str:
    """Folder of the CMake package ``pinograsp-core``, for ``-Dpinograsp-core_DIR=``."""
    return str(_FOLDER / "cmake")
