"""README and docs: what they show runs, what they link to is there, and the README stays short."""

from __future__ import annotations

import importlib.util
import os
import re
import runpy
import subprocess
import sys
from difflib import SequenceMatcher
from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient
from typer.main import get_command

from pinograsp.cli import app
from pinograsp.errors import Status
from pinograsp.plan.answer import ANSWERS

ROOT = Path(__file__).resolve().parent.parent
DOCS = ROOT / "docs"
PAGES = sorted(path for path in DOCS.rglob("*.md") if "build" not in path.parts)
EXECUTED = "file_format: mystnb"  # such pages run as the site is built
TEXTS = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *PAGES]


def blocks(path: Path, language: str) -> list[str]:
    return re.findall(rf"^```{language}\n(.*?)^```", path.read_text(encoding="utf-8"), re.M | re.S)


def with_python() -> list[Path]:
    return [path for path in TEXTS if blocks(path, "python") and EXECUTED not in path.read_text(encoding="utf-8")]


def name_of(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


@pytest.mark.slow  # plans, searches and simulations
@pytest.mark.no_cover
@pytest.mark.parametrize("path", with_python(), ids=name_of)
def test_python_runs(path, tmp_path):
    """The blocks of a page, one after the other, in a folder of their own."""
    (tmp_path / "page.py").write_text("\n".join(blocks(path, "python")), encoding="utf-8")
    environment = {**os.environ, "MPLBACKEND": "agg"}
    done = subprocess.run(
        [sys.executable, "page.py"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=900
    )
    assert done.returncode == 0, done.stdout + done.stderr
    assert "np.float64(" not in done.stdout


def test_code_is_as_wide_as_the_pages():
    """At most 88 columns, as a page shows them without scrolling. Directives other than cells have prose."""
    for path in TEXTS:
        fences = re.findall(r"^ *(```+)([^\n]*)\n(.*?)^ *\1 *$", path.read_text(encoding="utf-8"), re.M | re.S)
        for _, head, block in fences:
            if head.startswith("{") and not head.startswith("{code-cell}"):
                continue
            assert not [line for line in block.splitlines() if len(line) > 88], path.name


def test_tutorials_are_executed_as_the_site_is_built():
    pages = [path for path in PAGES if EXECUTED in path.read_text(encoding="utf-8")]
    assert {path.parent.name for path in pages} == {"tutorials"} and len(pages) >= 8
    for path in pages:
        text = path.read_text(encoding="utf-8")
        assert text.count("```{code-cell}") >= 3 and "```python\n" not in text, path.name


def test_every_answer_is_explained():
    """The first words of an answer, every status with its exit code, every reason of a certificate."""
    page = (DOCS / "howto" / "answers.md").read_text(encoding="utf-8")
    rows = {line.split("|")[1].strip().strip("`"): line for line in page.splitlines() if line.startswith("| `")}
    certified = [status for status in Status if status.code >= 0]
    assert set(ANSWERS) | {"HELD", "LOST"} <= set(rows)
    for status in set(Status) - set(certified):
        assert int(rows[str(status)].split("|")[2]) == status.exit_code and status.answer in ANSWERS, status
    for word, meaning in ANSWERS.items():
        assert meaning[:20] in rows[word], word
    certify = (DOCS / "howto" / "certify.md").read_text(encoding="utf-8")
    assert all(f"| `{status}` | {status.code} |" in certify for status in certified)
    for name in ("plan", "check", "carry"):
        assert "answers.md" in (get_command(app).commands[name].help or ""), name
    assert "howto/answers.md" in (ROOT / "README.md").read_text(encoding="utf-8")


@pytest.mark.slow  # plans the paper's case
@pytest.mark.no_cover
def test_the_papers_page_shows_its_figures(tmp_path):
    """Every cell of a figure has a picture among what it shows."""
    page = jupytext.read(DOCS / "tutorials" / "paper.md", fmt="md:myst")
    code = [cell for cell in page.cells if cell.cell_type == "code"]
    drawing = [cell for cell in code if re.search(r"^figures\.", cell.source, re.M)]
    page.cells = [code[0], *drawing]
    assert len(drawing) >= 5
    NotebookClient(page, timeout=600, resources={"metadata": {"path": str(tmp_path)}}).execute()
    for cell in drawing:
        assert any("image/png" in output.get("data", {}) for output in cell.outputs), cell.source


def notebooks():
    """The script that makes them."""
    spec = importlib.util.spec_from_file_location("make_notebooks", DOCS / "notebooks" / "make.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def stored(name):
    return nbformat.read(DOCS / "notebooks" / f"{name}.ipynb", as_version=4)


def test_notebooks_are_those_of_the_tutorials():
    made = notebooks()
    assert {path.stem for path in (DOCS / "notebooks").glob("*.ipynb")} == set(made.NAMES)
    index = (DOCS / "tutorials" / "index.md").read_text(encoding="utf-8")
    for name in made.NAMES:
        ours, fresh = stored(name), nbformat.reads(made.notebook(name), as_version=4)
        assert [cell.source for cell in ours.cells] == [cell.source for cell in fresh.cells], name
        nbformat.validate(ours)
        assert "%pip install" in ours.cells[1].source
        assert f"../notebooks/{name}.ipynb" in index


def test_notebooks_show_what_their_cells_print_and_draw():
    for name in notebooks().NAMES:
        path = DOCS / "notebooks" / f"{name}.ipynb"
        assert path.stat().st_size < 400_000, f"{name}: readers load all of it before they see anything"
        assert "/tmp/" not in path.read_text(encoding="utf-8"), name
        for cell in stored(name).cells:
            if cell.cell_type != "code":
                continue
            assert all(output.output_type != "error" for output in cell.outputs), name
            if re.search(r"^print\(|^figures\.|Image\(|subplots\(", cell.source, re.M):
                assert cell.outputs, f"{name}: {cell.source}"


def shown(cell):
    """The kinds of what a cell shows, and its words without their figures."""
    kinds = [sorted(output.get("data", {output.get("name", output.output_type): 0})) for output in cell.outputs]
    words = " ".join(output.get("text", "") for output in cell.outputs)
    return kinds, re.findall(r"[A-Za-z_]{3,}", words)


@pytest.mark.slow  # plans and simulations
@pytest.mark.no_cover
@pytest.mark.parametrize("path", sorted((DOCS / "notebooks").glob("*.ipynb")), ids=lambda path: path.stem)
def test_notebooks_run(path):
    """No cell fails, and every cell shows what the file has: the same kinds, and mostly the same words. Figures are
    not compared, and other processors may find another of two grasps that are equally good.
    """
    old = stored(path.stem)
    book = nbformat.reads(notebooks().notebook(path.stem), as_version=4)
    notebooks().execute(book)
    for before, now in zip(old.cells, book.cells, strict=True):
        if now.cell_type == "code":
            (kinds, words), (kinds_now, words_now) = shown(before), shown(now)
            assert kinds == kinds_now, now.source
            assert SequenceMatcher(a=words, b=words_now, autojunk=False).ratio() > 0.7, (words, words_now)


def commands() -> list[tuple[str, str]]:
    """Every line that starts the command line tool."""
    found = []
    for path in TEXTS:
        for block in (*blocks(path, "bash"), *blocks(path, "console")):
            for line in block.replace("\\\n", " ").splitlines():
                found += [
                    (name_of(path), part.strip())
                    for part in line.partition("#")[0].split("&&")
                    if part.strip().startswith("pinograsp ")
                ]
    return found


def test_options_that_are_shown_exist(command):
    shown = commands()
    assert len(shown) >= 15
    helps: dict[str, str] = {}
    for page, line in shown:
        _, *words = line.split()
        if words[0].startswith("-"):
            continue
        text = helps.setdefault(words[0], command(words[0], "--help")[1])
        for option in (word.partition("=")[0] for word in words if word.startswith("--")):
            assert re.search(rf"{option}\b", text), f"{page}: {line}: no {option}"


@pytest.mark.parametrize("path", TEXTS, ids=name_of)
def test_links_lead_somewhere(path):
    text = re.sub(r"^```.*?^```", "", path.read_text(encoding="utf-8"), flags=re.M | re.S)
    for target in re.findall(r"\]\(([^)\s]+)\)", text):
        if re.match(r"[a-z]+:", target):
            continue
        file, _, anchor = target.partition("#")
        place = (path.parent / file).resolve() if file else path
        assert place.exists(), target
        if anchor and place.suffix == ".md":
            heads = re.findall(r"^#+ (.+)$", place.read_text(encoding="utf-8"), re.M)
            assert anchor in {re.sub(r"[^\w -]", "", head).lower().replace(" ", "-") for head in heads}, target


# What users typed into the search of the site, and the page that answers it.
SOUGHT = {
    "fingers": "howto/hands",
    "torque limits": "howto/hands",
    "IK": "howto/pick",
    "units": "concepts/frames",
    "slip": "howto/troubleshooting",
    "handle": "howto/wishes",
    "CSV": "howto/hand_over",
    "frames": "concepts/frames",
    "friction": "concepts/friction",
    "gripper": "tutorials/gripper",
}


def test_keywords_lead_the_search_to_pages_that_have_them():
    pytest.importorskip("sphinx")
    keywords = runpy.run_path(str(DOCS / "conf.py"))["search_keywords"]
    for word, page in SOUGHT.items():
        assert word in keywords[page], word
        assert sum(word in words for words in keywords.values()) <= 3, f"{word}: more than three pages come first"
    for page, words in keywords.items():
        text = (DOCS / f"{page}.md").read_text(encoding="utf-8").lower()
        for word in words:
            assert all(part.lower().removesuffix("s") in text for part in word.split()), f"{page}: {word}"


def test_the_glossary_is_in_order():
    text = (DOCS / "glossary.md").read_text(encoding="utf-8")
    terms = re.findall(r"^- \*\*(.+?)\*\*.*?: ", text, re.M)
    assert len(terms) >= 50 and terms == sorted(set(terms), key=str.lower)


def test_the_readme_is_read_in_minutes():
    lines = (ROOT / "README.md").read_text(encoding="utf-8").splitlines()
    assert len(lines) <= 200 and lines[0] == "# pinograsp"
