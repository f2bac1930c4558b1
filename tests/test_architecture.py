"""The package's walls: import direction, who may import which third party, and the equation table of the README."""

from __future__ import annotations

import ast
import importlib
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE = ROOT / "pinograsp"

# The way of the data: a room imports only from itself and from rooms before it.
ROOMS = [
    "errors",
    "checks",
    "words",
    "interrupts",
    "writing",
    "spatial",
    "hands",
    "objects",
    "contacts",
    "forces",
    "motion",
    "placement",
    "run_files",
    "storage",
    "handover",
    "referee",
    "viz",
    "plan",
    "cases",
    "sweep",
    "report",
    "cli",
]
OWNERS = {
    "pinocchio": {"hands", "contacts", "motion", "placement", "referee"},
    "coal": {"hands", "objects", "contacts", "referee"},
    "mujoco": {"referee"},
    "trimesh": {"hands", "objects"},
    "yourdfpy": {"hands"},
    "xacro": {"hands"},
    "qpsolvers": {"forces"},
    "daqp": {"forces"},
    "clarabel": {"forces"},
    "numba": {"forces"},
    "matplotlib": {"viz"},
    "viser": {"viz"},
    "websockets": {"viz"},
    "pydantic": {"cases", "run_files"},
    "ruamel": {"cases", "handover"},
    "typer": {"cli"},
    "rich": {"cli"},
    "tqdm": {"forces", "placement", "referee", "sweep"},
    "joblib": {"interrupts", "placement", "referee", "sweep"},
    "cloudpickle": {"placement", "referee"},
    "pyarrow": {"sweep"},
    "distributed": {"sweep"},
}
# Rooms that must work without the solvers: pictures and reports of stored runs.
WITHOUT_SOLVERS = ("words", "writing", "run_files", "storage", "viz", "report")


def room_of(path: Path) -> str:
    return path.relative_to(PACKAGE).with_suffix("").parts[0]


def imports():
    for path in sorted(PACKAGE.rglob("*.py")):
        if path == PACKAGE / "__init__.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            if isinstance(node, ast.Import):
                names = [alias.name for alias in node.names]
            elif isinstance(node, ast.ImportFrom):
                assert node.level == 0, f"{path}: relative import"
                names = [node.module]
            else:
                continue
            for name in names:
                yield path, name


def test_every_module_lives_in_a_known_room():
    assert {room_of(path) for path in PACKAGE.rglob("*.py") if path != PACKAGE / "__init__.py"} == set(ROOMS)


def test_rooms_import_only_rooms_before_their_own():
    wrong = []
    for path, name in imports():
        if name.startswith("pinograsp."):
            room, other = room_of(path), name.split(".")[1]
            if ROOMS.index(other) > ROOMS.index(room):
                wrong.append(f"{path.relative_to(ROOT)} imports {name}")
    assert not wrong


def test_third_parties_stay_with_their_owners():
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path, name in imports()
        if (top := name.split(".")[0]) in OWNERS and room_of(path) not in OWNERS[top]
    ]
    assert not wrong


def test_pictures_and_reports_need_no_solver():
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path, name in imports()
        if room_of(path) in WITHOUT_SOLVERS and name.startswith(("pinograsp.forces", "pinograsp.motion"))
    ]
    assert not wrong


def test_the_referee_shares_nothing_with_what_it_judges():
    judged = ("contacts", "forces", "motion", "placement", "plan")
    wrong = [
        f"{path.relative_to(ROOT)} imports {name}"
        for path, name in imports()
        if room_of(path) == "referee" and name.startswith("pinograsp.") and name.split(".")[1] in judged
    ]
    assert not wrong


def test_modules_stay_readable():
    # One longer: numba's cache on disk sees changes of a function's own file only, so all compiled functions share one.
    longest = {"kernels.py": 1950}
    for path in PACKAGE.rglob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= longest.get(path.name, 520), path.name


def test_public_names_resolve():
    import pinograsp

    assert len(pinograsp.__all__) <= 50
    for name in pinograsp.__all__:
        assert getattr(pinograsp, name) is not None
        assert name in dir(pinograsp)
    with pytest.raises(AttributeError, match="no attribute"):
        pinograsp.no_such_name  # noqa: B018


def test_readme_equation_table_names_things_that_exist():
    text = (ROOT / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| \(\S.*?\| `(pinograsp[\w.]+)` \| `(tests/[\w/]+\.py)::(\w+)` \|$", text, re.M)
    assert len(rows) >= 15
    for function, file, test in rows:
        module, _, name = function.rpartition(".")
        try:
            home = importlib.import_module(module)
        except ModuleNotFoundError:  # a method: module.Class.method
            module, _, owner = module.rpartition(".")
            home = getattr(importlib.import_module(module), owner)
        assert hasattr(home, name), function
        assert f"def {test}(" in (ROOT / file).read_text(encoding="utf-8"), test


def test_readme_and_ci_type_the_same_commands():
    readme = (ROOT / "README.md").read_text(encoding="utf-8")
    ci = (ROOT / ".ci" / "run").read_text(encoding="utf-8")
    for command in ("pip install . && pinograsp plan paper", 'pip install ".[test]" && pytest'):
        assert f"\n{command}\n" in readme
        assert f"\n{command}\n" in ci
