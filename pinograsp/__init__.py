"""Kinematics, dynamics and contact forces of robotic hands on Pinocchio.

The public names are those of ``__init__.pyi``, and the rooms (``pinograsp.forces``, ``pinograsp.spatial``...); all are
loaded on first use, so that ``import pinograsp`` stays quick.
"""

import ast
import importlib.util
from pathlib import Path


def _read_stub() -> dict[str, str]:
    """The module of each public name, as the stub beside this file tells type checkers."""
    tree = ast.parse(Path(__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    imports = [node for node in tree.body if isinstance(node, ast.ImportFrom)]
    return {alias.name: f"{__name__}.{node.module or alias.name}" for node in imports for alias in node.names}


_MODULES = _read_stub()
__all__ = sorted(_MODULES)  # pyright: ignore[reportUnsupportedDunderAll]  # the stub has them


def __dir__() -> list[str]:
    return [*__all__, "__version__"]


def __getattr__(name: str) -> object:
    """The public names, the rooms, and ``__version__``: that of the installed package, or of the sources around."""
    if name == "__version__":
        return _version()
    if name in _MODULES:
        module = importlib.import_module(_MODULES[name])
        return globals().setdefault(name, getattr(module, name, module))
    if not name.startswith("_"):
        if importlib.util.find_spec(f"{__name__}.{name}") is not None:
            return importlib.import_module(f"{__name__}.{name}")
        from difflib import get_close_matches
        from pkgutil import iter_modules

        if near := get_close_matches(name, [*__all__, *(room.name for room in iter_modules(__path__))], n=1):
            raise AttributeError(f"module '{__name__}' has no attribute '{name}': did you mean '{near[0]}'?")
    raise AttributeError(f"module '{__name__}' has no attribute '{name}'")


def _version() -> str:
    from importlib.metadata import PackageNotFoundError, version

    try:
        return version(__name__)
    except PackageNotFoundError:
        project = Path(__file__).parent.parent / "pyproject.toml"
        lines = project.read_text(encoding="utf-8").splitlines() if project.is_file() else []
        found = [line.split('"')[1] for line in lines if line.startswith('version = "')]
        return found[0] if found else "unknown"
