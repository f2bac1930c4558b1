"""What commands print: a screen of 80 columns and 24 lines with the answer last, JSON, and examples that work."""

from __future__ import annotations

import json
import os
import re
import shlex
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from marks import slow_except
from terminal import on_a_terminal
from typer.main import get_command

import pinograsp as pg
from pinograsp.cli import app
from pinograsp.cli.screen import list_facts, show, wrap_text
from pinograsp.planner import load_run
from pinograsp.spatial import pose_of

LIGHT = ("--set", "motion.samples=1", "--set", "motion.time_step=0.01")
BALL = "sphere:radius=0.035,mass=0.1"


def fits(lines: list[str]) -> bool:
    """Whether command, output and the next prompt fit a terminal of 80 columns and 24 lines."""
    return len(lines) <= 22 and max(map(len, lines)) <= 80


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """A folder in which the first command was typed, and what was seen."""
    folder = tmp_path_factory.mktemp("planned")
    code, lines = on_a_terminal(folder, "plan", "paper", *LIGHT)
    assert code == 0
    return folder, lines


def test_the_first_screen_of_a_plan_is_its_answer(planned):
    folder, lines = planned
    assert fits(lines) and lines[0] == "Grasp plan 'paper'"
    last = " ".join(" ".join(lines[lines.index("") :]).split())
    plan = load_run(folder / "runs" / "paper")
    forces = ", ".join(f"{name} {force:.2f} N" for name, force in zip(plan.contacts.names, plan.forces.normal_forces))
    told = (
        "Does it hold? Barely",
        f"How hard? {forces};",
        "Results runs/paper/report.html",
        "Next pinograsp check runs/paper",
    )
    places = [last.index(one) for one in told]
    assert places == sorted(places) and "pinograsp view runs/paper" in lines[-2] and "pinograsp plan mug" in lines[-1]
    assert "Comparison" not in " ".join(lines)
    published = " ".join(" ".join(lines[: lines.index("")]).split())
    assert "paper 9.873 / 6.35 / 4.7 N, ours " in published and "impact time t_I paper 0.9 s, ours 0.9 s" in published
    assert re.search(
        r"with a reserve a squeeze of these contacts withstands a push or moment of \d % of the weight", published
    )


@pytest.mark.slow
@pytest.mark.usefixtures("no_rendering")
def test_what_is_too_long_for_it_is_behind_options(command):
    code, out, _ = command("plan", "paper", "--compare", *LIGHT)
    assert code == 0 and "Comparison with the paper" in out and max(map(len, out.splitlines())) <= 80
    table = [line for line in out.splitlines() if line.startswith("normal force thumb")]
    assert table and len(table[0].split()) == 7  # a row is a line
    code, out, _ = command("plan", "paper", "-v", *LIGHT)
    shown = " ".join(out.split())
    for there in ("multipliers k1, k2", "Ferrari-Canny", "note limits of thumb_abduction", "warning its weakest"):
        assert there in shown
    assert "Comparison" not in out and max(map(len, out.splitlines())) <= 80
    assert out.rindex("Does it hold?") < out.rindex("Next") and "..." not in out
    for arguments in (["--hand", "panda", "--object", BALL], ["nothing"]):
        code, _, err = command("plan", "--compare", *arguments)
        assert code == 2 and "--compare: expected with the case 'paper'" in err


@pytest.mark.slow
def test_the_first_screens_of_other_commands(planned, tmp_path):
    folder, _ = planned
    held = on_a_terminal(folder, "check", "runs/paper", "--hold", "0.2")
    assert held[0] == 0 and fits(held[1]) and "HELD" in held[1][held[1].index("") + 1]
    lost = on_a_terminal(folder, "check", "runs/paper", "--hold", "0.3", "--mu", "0.3")
    assert lost[0] == 3 and fits(lost[1])
    ended = "\n".join(lost[1])
    assert ended.rindex("Did it hold?  LOST") < ended.rindex("Why?") < ended.rindex("--what-holds")
    code, lines = on_a_terminal(folder, "report", "runs/paper")
    assert code == 0 and fits(lines) and "Does it hold?" in " ".join(lines)
    code, lines = on_a_terminal(tmp_path, "plan", "--hand", "panda", "--object", "box:size=0.03x0.03x0.08,mass=0.1")
    answer = " ".join(" ".join(lines).split())
    assert code == 0 and fits(lines)
    assert re.search(r"left [\d.]+ N at 4 contacts, .* joint torques up to [\d.]+ N Results", answer)
    (tmp_path / "way.csv").write_text("panda_joint1,panda_joint4\n0,-2\n0.8,-1.6\n")
    arm = ("carry", "runs/panda-box", "--robot", "panda", "--root", "panda_link0", "--path", "way.csv")
    code, lines = on_a_terminal(tmp_path, *arm, "--intervals", "40", "--check")
    assert code == 0 and fits(lines) and lines[-1].split()[:2] == ["pinograsp", "export"]
    code, lines = on_a_terminal(tmp_path, "new", "s.yaml", "--sweep")
    code, lines = on_a_terminal(tmp_path, "sweep", "s.yaml", "--jobs", "1")
    assert code == 0 and fits(lines) and "12 of 12 rows" in " ".join(lines[lines.index("") :])


@pytest.mark.slow
@pytest.mark.parametrize(
    "arguments", slow_except([["hands", "panda"], ["bench", "--contacts", "3"]], ["hands", "panda"])
)
def test_screens_end_with_an_answer(tmp_path, arguments):
    code, lines = on_a_terminal(tmp_path, *arguments)
    assert code == 0 and fits(lines) and "?  " in " ".join(lines[lines.index("") :])


@pytest.mark.slow
def test_the_catalogue_fits_and_a_wide_terminal_shows_more(tmp_path):
    code, lines = on_a_terminal(tmp_path, "hands")
    assert code == 0 and len(lines) <= 24 and max(map(len, lines)) <= 80 and "Next: pinograsp hands" in lines[-1]
    code, wide = on_a_terminal(tmp_path, "hands", columns=150)
    assert "Allegro hand, left" in "\n".join(wide) and "Allegro hand, left" not in "\n".join(lines)


@pytest.mark.slow
@pytest.mark.usefixtures("no_rendering")
def test_many_contacts_and_cautions_fit_too(command, tmp_path, capsys, monkeypatch):
    """Forces are those of fingers, remarks some."""
    from pinograsp.cli.plan import print_plan
    from pinograsp.cli.session import Session

    hand = pg.load_hand("panda")
    box = pg.Box(size=(0.04, 0.03, 0.05), mass=0.1, pose=pose_of([0, 0, 0.11], np.eye(3)))
    plan = pg.plan_grasp_on(hand, box, pg.GraspConditions(mu=0.6)).with_margins()
    capsys.readouterr()
    print_plan(
        replace(plan, cautions=("a long warning " * 40,) * 9, notes=("a note",) * 5), tmp_path / ("x" * 100), Session()
    )
    out = capsys.readouterr().out
    assert len(out.splitlines()) <= 22 and "in the report" in out
    total = float(np.sum(plan.forces.normal_forces[: len(plan.forces.normal_forces) // 2]))
    assert f"left {total:.2f} N at 4 contacts" in " ".join(out.split())
    assert sum(len(line) > 80 for line in out.splitlines()) == 3  # those of paths that have no place to break


def test_lines_are_wrapped_between_words_and_paths_stay_whole():
    assert wrap_text("  one two three", 11) == ["  one two", "    three"]
    path = "a/" * 60
    assert wrap_text(f"written to {path} and more", 40) == ["written to", f"  {path}", "  and more"]
    assert wrap_text("a\x1b[2Jb", 40) == ["a\\x1b[2Jb"] and wrap_text("", 40) == [""]
    assert (
        list_facts([("name", "one " * 60)], 2)[1].endswith(" one ...")
        and len(list_facts([("name", "one " * 60)], 2)) == 2
    )


def test_an_answer_always_has_room(capsys):
    show([(f"fact {i}", "word " * 30) for i in range(50)], [("How?", "so " * 200)], title="many", more="more: there")
    lines = capsys.readouterr().out.splitlines()
    assert len(lines) == 22 and "... more: there" in lines and lines[-1].endswith("...")
    show([(f"fact {i}", "word " * 30) for i in range(50)], [("How?", "so")])
    assert len(capsys.readouterr().out.splitlines()) > 100
    show([], [("How?", "so")], [("a " * 30, "what"), ("b " * 50, "that")])
    lines = [line.strip() for line in capsys.readouterr().out.splitlines()[2:]]
    assert lines == [f"Next  {'a ' * 30}".strip(), ("b " * 50).strip()]  # a command in a line, to be copied


COMMANDS = sorted(get_command(app).commands)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_takes_json_and_tells_its_errors_so(command, name):
    code, out, _ = command(name, "--json", "--no-such-option")
    told = json.loads(out)
    assert code == 2 and told["error"] == "UsageError" and told["status"] == "invalid_input"
    assert "--help" in told["remedy"]
    code, out, err = command(name, "--no-such-option")
    assert code == 2 and out == "" and err.startswith("pinograsp: No such option: --no-such-option")


def _told_besides(told):
    """Where a command was typed wrongly, people read the remedy, too."""
    return f" ({told['remedy']})" if told["error"] == "UsageError" else ""


@pytest.mark.parametrize(
    "arguments",
    [
        ["plan"],
        ["plan", "nothing"],
        ["close", "--hand", "nobody", "--object", BALL],
        ["check", "nowhere"],
        ["carry", "nowhere", "--path", "nowhere.csv"],
        ["certify", "nowhere", "--hand", "panda", "--objects", ".", "--out", "out"],
        ["hands", "nobody"],
        ["sweep", "nowhere.yaml"],
        ["bench", "--contacts", "1"],
        ["export", "nowhere", "--csv", "x.csv"],
        ["export", "nowhere"],
        ["report", "nowhere"],
        ["view", "nowhere"],
        ["new", "case.txt"],
        ["plan", "paper", "--seed", "x"],
        ["plan", "a", "b"],
        ["check"],
        ["nosuch"],
    ],
    ids=" ".join,
)
def test_errors_under_json_are_one_object(command, arguments):
    code, out, err = command(*arguments, "--json")
    told = json.loads(out)
    assert code == 2 and told.keys() == {"status", "error", "message", "remedy"} and told["remedy"]
    assert told["status"] == "invalid_input" and err == ""  # nothing twice
    assert command(*arguments)[1:] == ("", f"pinograsp: {told['message']}{_told_besides(told)}\n")


def test_interruptions_and_errors_of_our_own_are_json_too(command, monkeypatch, capsys):
    from pinograsp.cases.case import Case

    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr(Case, "plan", interrupt)
    code, out, err = command("plan", "paper", "--json")
    assert code == 130 and json.loads(out)["status"] == "interrupted" and err == ""

    def fail(*_, **__):
        raise ZeroDivisionError("a bug")

    monkeypatch.setattr(Case, "plan", fail)
    with pytest.raises(ZeroDivisionError):
        command("plan", "paper", "--json")
    told = json.loads(capsys.readouterr().out)
    assert told["status"] == "failed" and told["message"] == "a bug"


@pytest.mark.slow
def test_errors_wrap_on_a_terminal_alone(tmp_path):
    """Where they are searched, a message is a line."""
    script = (
        "import os, subprocess, sys; screen, other = os.openpty()\n"
        "subprocess.run([sys.executable, '-m', 'pinograsp.cli', 'plan', 'word ' * 40], stderr=other)\n"
        "os.close(other); print(os.read(screen, 65536).decode())"
    )
    run = {"cwd": tmp_path, "capture_output": True, "text": True, "timeout": 120}
    seen = subprocess.run([sys.executable, "-c", script], **run).stdout
    assert max(map(len, seen.splitlines())) <= 80 < len(seen)
    piped = subprocess.run([sys.executable, "-m", "pinograsp.cli", "plan", "word " * 40], **run).stderr
    assert len(piped.splitlines()) == 1 and len(piped) > 200


def test_version(command):
    from importlib.metadata import version

    assert command("--version") == (0, f"pinograsp {version('pinograsp')}\n", "")


def test_a_missing_core_is_told_in_one_line(command, monkeypatch, tmp_path):
    """As pip is silent where there was no compiler."""
    from pinograsp import core

    monkeypatch.setattr(core, "is_installed", lambda: False)
    code, _, err = command("--version")
    (line,) = err.splitlines()
    assert code == 0 and "compiled core is missing" in line and "C++17 compiler" in line
    assert command("plan", "gone.yaml", "--out", str(tmp_path / "run"))[2].splitlines()[0] == line
    assert line not in command("plan", "gone.yaml", "--out", str(tmp_path / "run"), "--quiet")[2]
    assert command("plan", "gone.yaml", "--out", str(tmp_path / "run"), "--json")[2] == ""


# -- examples of the help ----------------------------------------------------------------------------------------------


def examples() -> list[tuple[str, str]]:
    """Command and example, in the order in which they need each other."""
    order = ["plan", "new", "close", "check", "report", "view", "export", "carry", "sweep", "hands", "bench", "certify"]
    order += ["identify", "pick", "ros2"]
    assert sorted(order) == COMMANDS
    found = []
    for name in order:
        text = get_command(app).commands[name].help.partition("Examples:")[2]
        lines = [line.strip() for line in text.splitlines() if re.match(r"\s*(pinograsp|printf) ", line)]
        assert lines, name
        found += [(name, line) for line in lines]
    return found


@pytest.mark.parametrize(("name", "line"), examples(), ids=lambda text: text if " " in text else "")
def test_examples_are_understood_and_stay_in_a_line(command, name, line):
    """One that is wrapped would be two commands when it is pasted."""
    text = command(name, "-h")[1]
    assert line in [shown.strip() for shown in text.splitlines()] and "MISSING" not in text
    for one in line.split(" && "):
        words = shlex.split(one)
        if words[0] == "pinograsp":
            get_command(app).commands[words[1]].make_context(words[1], words[2:], resilient_parsing=False)


@pytest.mark.parametrize("name", COMMANDS)
def test_paragraphs_of_the_help_break_where_the_screen_does(name):
    """Lines of all but the first one are kept as they are: longer ones would break twice."""
    text = get_command(app).commands[name].help
    lines = [line for paragraph in text.split("\n\n")[1:] for line in paragraph.splitlines()]
    assert not [line for line in lines if len(line) > 78 and not line.strip().startswith("pinograsp ")]


FIRST = (("plan",), ("check", "report", "view", "export"))


@pytest.mark.slow
@pytest.mark.parametrize(
    "commands", [*FIRST, tuple(sorted({*COMMANDS} - {"certify", "identify", "ros2"}.union(*FIRST)))], ids=" ".join
)
def test_examples_of_the_help_work_when_typed(tmp_path, often, commands):
    """All but those that need a data set or a log, or go on until they are ended; after a plan of the paper's case."""
    begin = f'pinograsp() {{ {shlex.quote(sys.executable)} -m pinograsp.cli "$@"; }}\n'
    own = [line for name, line in examples() if name in commands and (name != "view" or "--html" in line)]
    for line in own if commands == ("plan",) else ["pinograsp plan paper", *own]:
        line = line.replace("--monte-carlo 5", f"--monte-carlo {often(5)}")
        line = line.replace("--pose-errors 12", f"--pose-errors {often(12)}")
        done = subprocess.run(["bash", "-c", begin + line], cwd=tmp_path, capture_output=True, text=True, timeout=900)
        assert done.returncode == 0, (line, done.stdout, done.stderr)


@pytest.mark.parametrize(
    "arguments",
    slow_except([["--help"], ["hands"], ["hands", "--json"], ["plan", "nothing", "--json"]], ["--help"]),
    ids=" ".join,
)
def test_a_pipe_that_nobody_reads_ends_a_command_without_a_word(arguments):
    """As the shell tells of other tools: 128 and the number of SIGPIPE."""
    end, other = os.pipe()
    os.close(end)
    script = [sys.executable, "-m", "pinograsp.cli", *arguments]
    done = subprocess.run(script, stdout=other, stderr=subprocess.PIPE, timeout=60)
    os.close(other)
    assert (done.returncode, done.stderr) == (141, b"")
