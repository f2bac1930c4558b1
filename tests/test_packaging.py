"""What is said of the package in other files than pyproject.toml, and the readme that a package index shows."""

from __future__ import annotations

import re
import subprocess
import sys
import tomllib
from datetime import date
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parent.parent
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
CONDA = {"pin": "pinocchio", "mujoco-core": "mujoco-python", "matplotlib": "matplotlib-base"}  # its names of packages


def read_yaml(name: str):
    return yaml.safe_load((ROOT / name).read_text(encoding="utf-8"))


def asked_for(requirements: list[str], names: dict[str, str]) -> dict[str, str]:
    """Versions by package, under another name where ``names`` has one."""
    found = {}
    for one in requirements:
        name, versions = re.fullmatch(r"([\w.-]+) ?(.*)", one).groups()
        found[names.get(name, name)] = versions
    return found


def test_the_citation_is_that_of_the_latest_version():
    """Its date is the changelog's, which heads each version with the day of its release."""
    citation, version = read_yaml("CITATION.cff"), PROJECT["project"]["version"]
    assert citation["version"] == version and citation["license"] == PROJECT["project"]["license"]
    heads = re.findall(r"^## (\S+) \((.*)\)$", (ROOT / "CHANGELOG.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert heads[0] == (version, citation["date-released"].isoformat())
    assert citation["date-released"] <= date.today()
    cited = re.search(r"version = \{(.*)\},\n  year = \{(\d+)\}", (ROOT / "README.md").read_text(encoding="utf-8"))
    assert cited.groups() == (version, str(citation["date-released"].year))


def test_the_recipe_for_conda_is_that_of_the_project():
    recipe, project = read_yaml(".conda/recipe.yaml"), PROJECT["project"]
    run = asked_for([one for one in recipe["requirements"]["run"] if one != "python"], {})
    assert run == asked_for(project["dependencies"], CONDA)
    host = asked_for([one for one in recipe["requirements"]["host"] if one not in ("python", "pip")], {})
    assert host == asked_for(PROJECT["build-system"]["requires"], {})
    assert recipe["context"]["version"] == project["version"]
    oldest = project["requires-python"].removeprefix(">=")
    assert f'match(python, "<{oldest}")' in recipe["build"]["skip"]
    assert recipe["about"]["summary"] == project["description"]
    assert recipe["about"]["license"] == project["license"]


def test_workflows_and_pages_name_the_oldest_python():
    oldest = PROJECT["project"]["requires-python"].removeprefix(">=")
    tried = read_yaml(".github/workflows/tests.yml")["jobs"]["tests"]["strategy"]["matrix"]["python"]
    (build,) = (
        step["env"]["CIBW_BUILD"]
        for step in read_yaml(".github/workflows/wheels.yml")["jobs"]["wheels"]["steps"]
        if "cibuildwheel" in step.get("uses", "")
    )
    assert tried[0] == oldest and build.split() == [f"cp{one.replace('.', '')}-*" for one in tried]
    for page in ("README.md", "docs/start/install.md"):
        assert f"Python {oldest} or later" in (ROOT / page).read_text(encoding="utf-8")


def test_the_readme_of_the_package_leads_nowhere_relative():
    """As a package index shows it: of README.md all but pictures, and paths in place of links into the repository."""
    pytest.importorskip("hatch_fancy_pypi_readme")
    command = [sys.executable, "-m", "hatch_fancy_pypi_readme"]
    text = subprocess.run(command, cwd=ROOT, check=True, capture_output=True, text=True).stdout
    assert not re.findall(r"\]\((?!https?://)[^)]*\)|ADDRESS", text)
    own = (ROOT / "README.md").read_text(encoding="utf-8")
    assert [line for line in text.splitlines() if line.startswith("#")] == [
        line for line in own.splitlines() if line.startswith("#")
    ]
    paths = re.findall(r"(?<!!)\[[^\]]*\]\((?!https?://)([^)]*)\)", re.sub(r"!\[[^\]]*\]\([^)]*\)", "", own))
    assert paths and all(f"(`{path}`)" in text for path in paths)
