"""What imports do: nothing outside the package, and all that they need is declared."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from importlib.metadata import packages_distributions, requires
from typing import Any

import pytest
from test_architecture import FILES, OWNERS, ROOT, imports

# Imported, and brought by another dependency that cannot do without.
BROUGHT = {
    "cloudpickle": "joblib",
    "markupsafe": "jinja2",
    "pillow": "matplotlib",
    "pydantic-core": "pydantic",
    "pyyaml": "xacro",
    "rich": "typer",
    "trimesh": "yourdfpy",
    "typing-extensions": "pydantic",
    "websockets": "viser",
}
# Declared, and reached by another way than an import.
REACHED = {
    "example-robot-data": "files",
    "mujoco": "by mujoco-menagerie, whose choice it bounds",
    "osqp": "by name through qpsolvers",
    "proxsuite": "by name through qpsolvers",
    "ros-rmw-fastrtps-cpp": "by name through rclpy",
    "ros-rmw-implementation": "by name through rclpy",
    "xacro": "by name, as a copy",
}
# Extras whose packages are reached by name as well, or are for those who work on the package.
NOT_IMPORTED = ("solvers", "docs", "test", "dev")


def named(requirement: str) -> str:
    return re.split(r"[^\w.-]", requirement)[0].lower().replace("_", "-")


def read_project() -> dict[str, Any]:
    return tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]


def declared() -> dict[str, set[str]]:
    """Packages by extra, those of the base under "" ."""
    project = read_project()
    groups = {"": project["dependencies"], **project["optional-dependencies"]}
    return {extra: {named(one) for one in group} - {"pinograsp"} for extra, group in groups.items()}


def used() -> set[str]:
    """Packages that the sources import."""
    tops = {name.partition(".")[0] for names in imports().values() for name in names}
    tops -= {"pinograsp", "__future__", "_typeshed", *sys.stdlib_module_names}
    homes = packages_distributions()
    homes |= {"pinocchio": ["pin"], "coal": ["pin"], "mujoco": ["mujoco-core"], "rerun": ["rerun-sdk"]}
    homes |= {top: [f"ros-{top}"] for top, rooms in OWNERS.items() if rooms == {"ros2"}}  # often not installed
    return {named(homes.get(top, [top])[0]) for top in tops}


@pytest.mark.slow
def test_what_is_imported_is_declared_and_what_is_declared_is_imported():
    groups = declared()
    base, imported = groups[""], used()
    wanted = set().union(*(group for extra, group in groups.items() if extra not in NOT_IMPORTED))
    assert wanted - imported <= REACHED.keys()
    assert imported - wanted == BROUGHT.keys()
    for package, bringer in BROUGHT.items():
        needs = [named(one) for one in requires(bringer) if "extra ==" not in one]
        assert bringer in wanted and package in needs, package
    assert len(base) <= 20, sorted(base)


STATE = """
import contextlib, importlib, locale, logging, os, signal, sys, threading, warnings

for name in {others}:
    with contextlib.suppress(ImportError):
        importlib.import_module(name)
import matplotlib, mujoco, numpy
strangers = [module for module in list(sys.modules.values()) if module is not None]

def state():
    root = logging.getLogger()
    return {{
        "warnings": list(warnings.filters), "matplotlib": dict(matplotlib.rcParams), "numpy": numpy.geterr(),
        "printing": numpy.get_printoptions(), "environment": dict(os.environ), "path": list(sys.path),
        "hooks": (sys.excepthook, sys.displayhook, sys.unraisablehook, sys.meta_path[:], threading.excepthook),
        "signals": [signal.getsignal(one) for one in signal.valid_signals()], "locale": locale.setlocale(locale.LC_ALL),
        "logging": (root.level, root.handlers[:], logging.root.manager.disable), "directory": os.getcwd(),
        "mujoco": [getattr(mujoco, name)() for name in dir(mujoco) if name.startswith("get_mjcb")],
        "recursion": sys.getrecursionlimit(), "threads": threading.active_count(),
    }}

before = state()
held = [(module, key, value) for module in strangers for key, value in vars(module).items() if not key.startswith("__")]
for name in {ours}:
    importlib.import_module(name)
after = state()
changed = [name for name in before if before[name] != after[name]]
import types
changed += [
    f"{{module.__name__}}.{{key}}" for module, key, value in held
    if vars(module).get(key) is not value and callable(value)
]
print(changed)
"""


def test_importing_the_package_changes_nothing_outside_it():
    """Of other libraries, only what importing these alone has not changed before."""
    others = [name for name in OWNERS if name not in ("distributed",)]
    ours = [name for name in FILES if not name.endswith("__main__")]
    script = STATE.format(others=others, ours=ours)
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    assert done.stdout.strip() == "[]"


# What a plan and its run folder do without (trimesh and scipy.ndimage come with yourdfpy).
UNUSED = (
    "mujoco",
    "joblib",
    "qpsolvers",
    "urllib.request",
    "scipy.cluster",
    "scipy.integrate",
)


def test_a_plan_imports_nothing_that_it_does_without(tmp_path):
    """The case of the paper, planned and written with its report and its figures."""
    script = (
        "import sys; from pinograsp.cli import run; code = run(); "
        f"print(code, [name for name in {UNUSED} if name in sys.modules])"
    )
    command = [sys.executable, "-c", script, "plan", "paper", "--json", "--out", str(tmp_path / "run")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300)
    assert done.stdout.splitlines()[-1] == "0 []", done.stderr


@pytest.mark.slow
def test_nothing_draws_that_was_not_asked_to():
    """Planning, carrying, judging: none of them waits for matplotlib."""
    rooms = ("planner", "carry", "synthesis", "certification", "simulation", "sweep", "handover", "storage", "cli")
    script = f"import sys; import {', '.join(f'pinograsp.{room}' for room in rooms)}; print('matplotlib.figure' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
