"""Kinematics, dynamics and contact forces of robotic hands on Pinocchio.

The public names are those of ``__init__.pyi``, loaded on first use, so that ``import pinograsp`` stays quick.
"""

import lazy_loader

from pinograsp.showing import drawn_by as _drawn_by

_named, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)


def __getattr__(name: str) -> object:
    """The public names, and ``__version__``: of the installed package, or of the sources around this file."""
    if name == "__version__":
        return _version()
    return _named(name)


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
