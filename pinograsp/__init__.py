"""Kinematics, dynamics and contact forces of robotic hands on Pinocchio.

The public names are those of ``__init__.pyi``, and the rooms (``pinograsp.forces``, ``pinograsp.spatial``...); all are
loaded on first use, so that ``import pinograsp`` stays quick.
"""

import importlib

import lazy_loader

from pinograsp.showing import drawn_by as _drawn_by

_named, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """The public names, the rooms, and ``__version__``: that of the installed package, or of the sources around."""
    if name == "__version__":
        return _version()
    if name in __all__:
        return _named(name)
    if not name.startswith("_"):
        if name in (rooms := _rooms()):
            return importlib.import_module(f"{__name__}.{name}")
        from difflib import get_close_matches

        if near := get_close_matches(name, [*__all__, *rooms], n=1):
            raise AttributeError(f"module '{__name__}' has no attribute '{name}': did you mean '{near[0]}'?")
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def _rooms() -> list[str]:
    from pkgutil import iter_modules

    return [module.name for module in iter_modules(__path__)]


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version
    from pathlib import Path

    try:
        return version(__name__)
    except PackageNotFoundError:
        project = Path(__file__).parent.parent / "pyproject.toml"
        lines = project.read_text(encoding="utf-8").splitlines() if project.is_file() else []
        found = [line.split('"')[1] for line in lines if line.startswith('version = "')]
        return found[0] if found else "unknown"


def _html_of(record: object) -> str | None:
    from pinograsp.notebook import html_of

    return html_of(record)


_drawn_by(_html_of)
