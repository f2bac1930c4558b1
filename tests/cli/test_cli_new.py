"""``pinograsp new``: files that run as they are and tell the truth about keys and defaults."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

import pinograsp.cli
from pinograsp.cases import load_case
from pinograsp.cases.case import Case
from pinograsp.cases.object_case import ObjectCase
from pinograsp.cases.reserve_section import ReserveSection
from pinograsp.cases.sweep_file import Draw, Span, SweepSpec, load_sweep
from pinograsp.cases.wishes_section import WishesSection

FOLDER = Path(pinograsp.cli.__file__).parent
CASE, SEARCH, SWEEP = ((FOLDER / f"new_{kind}.yaml").read_text() for kind in ("case", "search", "sweep"))
KEY = re.compile(r"^( *)# ( *[a-z_]+(\.[a-z_]+)*:( |$))", re.M)  # a key that is left out


@pytest.mark.slow
@pytest.mark.usefixtures("no_rendering")
def test_a_case_runs_as_it_is(command, tmp_path):
    code, out, _ = command("new", "case.yaml")
    assert code == 0 and "pinograsp plan case.yaml" in out
    text = (tmp_path / "case.yaml").read_text()
    assert "pinograsp plan case.yaml" in text and "FILE" not in text
    code, out, err = command("plan", "case.yaml", "--json")
    assert code == 0, err
    told = json.loads(out)
    assert told["status"] == "ok" and told["folder"].endswith("my_grasp")


@pytest.mark.slow
@pytest.mark.usefixtures("no_rendering")
def test_a_hand_and_an_object_run_as_they_are(command, tmp_path):
    assert command("new", "pick.yaml", "--search")[0] == 0
    code, out, err = command("plan", "pick.yaml", "--json")
    assert code == 0, err
    told = json.loads(out)
    assert told["status"] == "ok" and told["folder"].endswith("my_pick")
    assert command("new", "both.yaml", "--search", "--sweep")[0] == 2


@pytest.mark.slow
def test_a_sweep_runs_as_it_is(command, tmp_path):
    code, out, _ = command("new", "my sweep.yaml", "--sweep")
    assert code == 0 and "pinograsp sweep 'my sweep.yaml'" in out
    code, out, err = command("sweep", "my sweep.yaml", "--json", "--jobs", "1", "--out", "out")
    assert code == 0 and json.loads(out)["counts"] == {"ok": 12}, err


@pytest.mark.parametrize(("text", "keys"), [(CASE, 40), (SEARCH, 35)], ids=["case", "search"])
def test_what_is_left_out_has_the_default_that_is_shown(tmp_path, text, keys):
    (tmp_path / "as_it_is.yaml").write_text(text)
    all_keys = KEY.sub(r"\1\2", text)
    (tmp_path / "all.yaml").write_text(all_keys)
    assert all_keys.count("#") <= text.count("#") - keys
    assert load_case(tmp_path / "all.yaml").settings() == load_case(tmp_path / "as_it_is.yaml").settings()


def test_every_key_is_there():
    def compare(model, told, where=""):
        wanted = {field.alias or name for name, field in model.model_fields.items()} - {"folder"}
        assert set(told) == wanted - ({"trusted"} if where == "hand" else set()), where
        for name, field in model.model_fields.items():
            section = field.annotation
            if isinstance(told.get(name), dict) and hasattr(section, "model_fields"):
                compare(section, told[name], name)

    compare(Case, yaml.safe_load(KEY.sub(r"\1\2", CASE)))
    search = yaml.safe_load(KEY.sub(r"\1\2", SEARCH))
    assert search.keys() == {field.alias or name for name, field in ObjectCase.model_fields.items()} - {
        "folder",
        "trusted",
    }
    assert search["wishes"].keys() == WishesSection.model_fields.keys()
    assert search["reserve"].keys() == ReserveSection.model_fields.keys()
    words = set(re.findall(r"[a-z_]+(?=:)", SWEEP))
    assert words >= {field.alias or name for name, field in SweepSpec.model_fields.items()} - {"name", "folder"}
    assert words >= {"from", "to", "steps", "spacing"} and len(Span.model_fields) == 4
    assert words >= set(Draw.model_fields) | {"count", "seed"}


def test_every_alternative_of_a_sweep_can_be_taken(tmp_path):
    lines = SWEEP.splitlines()
    (tmp_path / "sweep.yaml").write_text(SWEEP)
    start = load_sweep(tmp_path / "sweep.yaml")
    tried = 0
    for line in lines:
        if (found := KEY.match(line)) and found[1]:
            key = found[2].strip()
            # An alternative stands below the line whose place it can take.
            taken = [old for old in lines if not old.startswith(f"{found[1]}{key}") or key == "friction.safety:"]
            at = taken.index(line)
            taken[at] = KEY.sub(r"\1\2", line)
            (tmp_path / "sweep.yaml").write_text("\n".join(taken))
            spec = load_sweep(tmp_path / "sweep.yaml")
            assert spec.base and spec.settings() != start.settings()
            tried += 1
    assert tried == 5
    held = re.sub(r"^(case|set|over|samples|  [a-z]).*\n", "", SWEEP, flags=re.M)
    held = (
        re.sub(r"^# (hand|object):", r"\1:", held, flags=re.M) + "over:\n  mu: [0.5, 0.7]\n  object.mass: [0.1, 0.2]\n"
    )
    (tmp_path / "sweep.yaml").write_text(held)
    assert load_sweep(tmp_path / "sweep.yaml").base.kind == "object"


def test_nothing_is_overwritten_without_force(command, tmp_path):
    (tmp_path / "case.yaml").write_text("mine")
    code, out, err = command("new", "case.yaml")
    assert code == 2 and "--force" in err and (tmp_path / "case.yaml").read_text() == "mine"
    code, out, _ = command("new", "case.yaml", "--force", "--json")
    assert code == 0 and json.loads(out) == {"file": "case.yaml", "kind": "case"}
    assert load_case(tmp_path / "case.yaml").name == "my_grasp"
    code, _, err = command("new", "case.json")
    assert code == 2 and "ends in .yaml" in err


def test_a_strange_name_stays_within_its_comment(command, tmp_path):
    assert command("new", "a\nschema: 7.yaml")[0] == 0
    assert load_case(tmp_path / "a\nschema: 7.yaml").name == "my_grasp"
