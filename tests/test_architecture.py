"""The package's walls: import direction, file by file; who may import which third party; where each room's tests are."""

from __future__ import annotations

import ast
import functools
import graphlib
import importlib
import re
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parent.parent
PACKAGE, TESTS = ROOT / "pinograsp", ROOT / "tests"

# The way of the data: a room imports only from itself and from rooms before it.
ROOMS = [
    "defaults",
    "words",
    "errors",
    "spatial",
    "checks",
    "showing",
    "interrupts",
    "processes",
    "pages",
    "plain",
    "writing",
    "core",
    "hands",
    "objects",
    "plan",
    "contacts",
    "forces",
    "actuation",
    "motion",
    "reflex",
    "identification",
    "data",
    "synthesis",
    "storage",
    "simulation",
    "handover",
    "certification",
    "viz",
    "report",
    "planner",
    "carry",
    "pick",
    "ros2",
    "notebook",
    "cases",
    "sweep",
    "cli",
]
OWNERS = {
    "pinocchio": {
        "hands",
        "contacts",
        "motion",
        "identification",
        "data",
        "synthesis",
        "simulation",
        "certification",
        "carry",
        "pick",
    },
    "coacd": {"objects"},
    "coal": {"hands", "objects", "contacts", "simulation", "pick"},
    "mujoco": {"hands", "objects", "simulation", "handover"},
    "mujoco_menagerie": {"hands"},
    "robot_descriptions": {"hands"},
    "trimesh": {"hands", "objects"},
    "fast_simplification": {"hands"},
    "h5py": {"data"},
    "yourdfpy": {"hands"},
    "xacro": {"hands"},
    "simpleeval": {"hands"},
    "pink": {"pick"},
    "ompl": {"pick"},
    "toppra": {"pick"},
    "rosbags": {"identification"},
    "rclpy": {"ros2"},
    "rcl_interfaces": {"ros2"},
    "builtin_interfaces": {"ros2"},
    "geometry_msgs": {"ros2"},
    "sensor_msgs": {"ros2"},
    "std_msgs": {"ros2"},
    "trajectory_msgs": {"ros2"},
    "qpsolvers": {"forces"},
    "torch": {"forces"},
    "jax": {"forces"},
    "daqp": {"forces"},
    "clarabel": {"forces", "carry"},
    "jinja2": {"pages"},
    "markupsafe": {"pages"},
    "matplotlib": {"viz"},
    "viser": {"viz"},
    "rerun": {"viz"},
    "PIL": {"hands", "viz"},
    "imageio_ffmpeg": {"viz"},
    "websockets": {"viz"},
    "pydantic": {"cases", "storage"},
    "typer": {"cli"},
    "rich": {"cli"},
    "tqdm": {"forces", "synthesis", "simulation", "viz", "sweep"},
    "filelock": {"writing"},
    "joblib": {"processes", "simulation", "sweep"},
    "cloudpickle": {"simulation"},
    "pyarrow": {"identification", "handover", "sweep"},
    "distributed": {"sweep"},
}
# Tests of what no single room does.
ABOUT_ALL = {
    "test_architecture.py",
    "test_examples.py",
    "test_frozen_records.py",
    "test_front_door.py",
    "test_imports.py",
    "test_fuzzing.py",
    "test_packaging.py",
    "test_typing.py",
    "test_documents.py",
}
# Rooms that must work without the solvers: pictures and reports of stored runs.
WITHOUT_SOLVERS = ("words", "writing", "plan", "storage", "viz", "report")


def room_of(module: str) -> str:
    return module.split(".")[1]


def module_of(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


FILES = {module_of(path): path for path in sorted(PACKAGE.rglob("*.py"))}


def imported(tree: ast.AST) -> Iterator[str]:
    """Every module that a file names: imports on top, within functions, for type checkers alone, and modules named in texts."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            assert node.level == 0, "relative import"
            yield from (
                name if (name := f"{node.module}.{alias.name}") in FILES else node.module for alias in node.names
            )
        elif (
            isinstance(node, ast.Constant) and isinstance(node.value, str) and "." in node.value and node.value in FILES
        ):
            yield node.value


@functools.cache
def imports() -> dict[str, frozenset[str]]:
    """What each file of the package imports; the package's front door names every room and is left out."""
    return {
        module: frozenset(imported(ast.parse(path.read_text(encoding="utf-8")))) - {module}
        for module, path in FILES.items()
        if module != "pinograsp"
    }


def arrows() -> list[tuple[str, str]]:
    return [(module, name) for module, names in imports().items() for name in sorted(names)]


def circle(graph: dict[str, frozenset[str]]) -> list[str]:
    """Files that import each other in a circle, [] where there is none."""
    try:
        graphlib.TopologicalSorter(graph).prepare()
    except graphlib.CycleError as error:
        return error.args[1]
    return []


def test_every_module_lives_in_a_known_room():
    assert {room_of(module) for module in imports()} == set(ROOMS)


def test_rooms_import_only_rooms_before_their_own():
    back = [
        f"{module} imports {name}"
        for module, name in arrows()
        if name.startswith("pinograsp.") and ROOMS.index(room_of(name)) > ROOMS.index(room_of(module))
    ]
    assert not back


def test_no_file_imports_the_front_door():
    """`import pinograsp` names every room at once: an arrow to all of them."""
    assert not [module for module, name in arrows() if name == "pinograsp" and room_of(module) != ROOMS[-1]]


def test_no_files_import_each_other_in_a_circle():
    assert not circle({module: frozenset(names & FILES.keys()) for module, names in imports().items()})


@pytest.mark.parametrize(
    "text",
    [
        "import pinograsp.errors",
        "from pinograsp import errors",
        "from pinograsp.errors import Status",
        "def f():\n    from pinograsp.errors import Status",
        "if TYPE_CHECKING:\n    from pinograsp.errors import Status",
        "sys.modules.get('pinograsp.errors')",
    ],
)
def test_every_way_to_import_is_seen(text):
    assert "pinograsp.errors" in set(imported(ast.parse(text)))
    graph = {
        "pinograsp.errors": frozenset({"pinograsp.words"}),
        "pinograsp.words": frozenset(imported(ast.parse(text))),
    }
    assert set(circle(graph)) == graph.keys()


def test_third_parties_stay_with_their_owners():
    strangers = [
        f"{module} imports {name}"
        for module, name in arrows()
        if (top := name.split(".")[0]) in OWNERS and room_of(module) not in OWNERS[top]
    ]
    assert not strangers


def test_pictures_and_reports_need_no_solver():
    solving = [
        f"{module} imports {name}"
        for module, name in arrows()
        if room_of(module) in WITHOUT_SOLVERS and name.startswith(("pinograsp.forces", "pinograsp.motion"))
    ]
    assert not solving


def test_what_reads_plans_loads_nothing_that_made_them():
    """Not even by way of other rooms: the record is below contacts, forces and motion."""
    readers = "pinograsp.storage, pinograsp.simulation, pinograsp.report, pinograsp.viz.figures, pinograsp.viz.scene"
    script = f"import sys, {readers}; print(*sys.modules)"
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300, check=True)
    rooms = {room_of(name) for name in done.stdout.split() if name.startswith("pinograsp.")}
    assert {"plan", "storage"} <= rooms and not rooms & {"contacts", "forces", "motion", "synthesis", "planner"}


def test_the_simulation_shares_nothing_with_what_it_judges():
    judged = ("contacts", "forces", "motion", "synthesis", "planner")
    shared = [
        f"{module} imports {name}"
        for module, name in arrows()
        if room_of(module) == "simulation" and name.startswith("pinograsp.") and room_of(name) in judged
    ]
    assert not shared


def test_modules_stay_readable():
    for path in PACKAGE.rglob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 520, path.name


def test_public_names_resolve():
    import pinograsp

    assert len(set(pinograsp.__all__) - {*ROOMS}) <= 50
    for name in pinograsp.__all__:
        assert getattr(pinograsp, name) is not None
        assert name in dir(pinograsp)
    with pytest.raises(AttributeError, match="no attribute 'no_such_name'"):
        pinograsp.no_such_name  # noqa: B018


def test_the_equation_table_names_things_that_exist():
    text = (ROOT / "docs" / "equations.md").read_text(encoding="utf-8")
    paper, _, beyond = text.partition("\n## Not in the paper\n")
    tables = [re.findall(r"^\| (?!equation |-)", part, re.M) for part in (paper, beyond)]
    assert len(tables[0]) >= 15 and len(tables[1]) >= 30
    rows = re.findall(r"^\| .+ \| `(pinograsp[\w.]+)` \| `(tests/[\w/]+\.py)::(\w+)` \|$", text, re.M)
    assert len(rows) == sum(map(len, tables)), "a row without function and test"
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
    lines = ('pip install ".[viz]"', "pinograsp plan paper", 'pip install ".[test]" && pytest')
    commands = [command for line in lines for command in line.split(" && ")]
    assert all(f"\n{line}\n" in readme for line in lines)
    assert set(commands) <= {line.strip() for line in ci.splitlines()}


def listed_tests() -> dict[str, list[str]]:
    """Room -> its tests, as CONTRIBUTING.md says."""
    text = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8").partition("| room | tests |")[2]
    rows = re.findall(r"^\| `(\w+)` \| (.+) \|$", text, re.M)
    assert len(rows) == len(dict(rows)), "a room stands twice in CONTRIBUTING.md"
    return {room: re.findall(r"`tests/([\w/.]+)`", tests) for room, tests in rows}


def test_every_room_has_tests_where_contributors_look_for_them():
    listed = listed_tests()
    assert listed.keys() == set(ROOMS)
    for room, places in listed.items():
        assert places and all((TESTS / place).exists() for place in places), room
        folder, file = TESTS / room, TESTS / f"test_{room}.py"
        own = [one.name + "/" * one.is_dir() for one in (folder, file) if one.exists()]
        assert set(own) <= set(places), f"{room}: CONTRIBUTING.md does not list {own}"


def test_every_test_belongs_to_a_room_or_to_all_of_them():
    known = {place.rstrip("/") for places in listed_tests().values() for place in places}
    for path in TESTS.rglob("test_*.py"):
        place = path.relative_to(TESTS).as_posix()
        assert {place, place.split("/")[0]} & (known | ABOUT_ALL), f"{place}: no room of this name"


# Private names that tests read, all to put something else in their place; no public call reaches what they stand for.
REPLACED = {
    "conic._SETTINGS",  # a solver that stops early
    "folders._exchange",  # files that come in the last moment, a rename that fails
    "grid_module._first_hits",  # Ctrl-C in the middle of a block
    "module._global_symbols",  # what a stranger's expression would find, if the guard had a gap
    "xacro_guard._Files",  # a file that changes between look and use
    "xacro_guard._harmless_xacro",  # the guard's gaps
}


def private_names(tree: ast.AST) -> Iterator[str]:
    """Private names of other modules that a test imports or reads, as they stand there."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.module.startswith("pinograsp"):
            yield from (
                f"{node.module.rpartition('.')[2]}.{alias.name}" for alias in node.names if alias.name.startswith("_")
            )
        elif isinstance(node, ast.Attribute) and re.match(r"_[^_]", node.attr) and not node.attr.endswith("_"):
            owner = ast.unparse(node.value)
            if owner not in ("self", "harness", "os"):
                yield f"{owner}.{node.attr}"


def test_tests_use_public_names():
    found = {
        f"{path.relative_to(TESTS)}: {name}"
        for path in TESTS.rglob("*.py")
        for name in private_names(ast.parse(path.read_text(encoding="utf-8")))
        if name not in REPLACED
    }
    assert not found
