"""A report as a record, and its two forms: Markdown, and one HTML file that loads nothing from elsewhere."""

from __future__ import annotations

import base64
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from pinograsp.checks import brief
from pinograsp.pages import render


class Finding(NamedTuple):
    """A question, its answer, and how to take it: "yes", "caution", "no" or "" (neutral)."""

    question: str
    text: str
    level: str = ""


class Picture(NamedTuple):
    """The name of a PNG file in the report's folder, and what it shows."""

    name: str
    caption: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """A part of a report, its parts in the order of the page.

    Attributes:
        title: above it; "": it goes on.
        text: a paragraph.
        columns: of a table.
        rows: its rows.
        items: of a list.
        remark: a paragraph below table and list.
        outputs: texts of several lines, shown as they are.
        figures: with captions.
        folded: shown by its title alone until it is opened, and not printed before.
    """

    title: str
    text: str = ""
    columns: Sequence[str] = ()
    rows: Sequence[Sequence[str]] = ()
    items: Sequence[str] = ()
    remark: str = ""
    outputs: Sequence[str] = ()
    figures: Sequence[Picture] = ()
    folded: bool = False

    __repr__ = brief("title")


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What a report says, the answers first. All texts are shown as they are: names come from files.

    Attributes:
        title: of the page.
        answers: the main results.
        figures: beside and below the answers.
        sections: what follows; those without content are left out.
    """

    title: str
    answers: Sequence[Finding] = ()
    figures: Sequence[Picture] = ()
    sections: Sequence[Section] = ()

    __repr__ = brief("title", "answers", "sections")

    def to_markdown(self) -> str:
        """The report as Markdown."""
        return render("report/report.md", quote=_quote, report=self).rstrip() + "\n"

    def to_html(self, folder: Path) -> str:
        """The report as one HTML file, with the figures that ``folder`` has."""
        names = [one.name for one in (*self.figures, *(one for part in self.sections for one in part.figures))]
        files = {name: folder / name for name in names if Path(name).name == name}
        pictures = {
            name: base64.b64encode(file.read_bytes()).decode() for name, file in files.items() if file.is_file()
        }
        return render("report/report.html", report=self, pictures=pictures)

    def write(self, folder: Path) -> None:
        """Write ``report.md`` and ``report.html`` into a folder that already holds the figures."""
        (folder / "report.md").write_text(self.to_markdown(), encoding="utf-8")
        (folder / "report.html").write_text(self.to_html(folder), encoding="utf-8")


def list_section(title: str, items: Sequence[str]) -> list[Section]:
    """A section with a list, none where the list is empty."""
    return [Section(title=title, items=items)] if items else []


def _quote(text: str) -> str:
    """Text that Markdown shows unchanged."""
    text = re.sub(r"[\\`*\[\]<>|~&$]", r"\\\g<0>", text)
    text = re.sub(r"(?<![^\W_])_|_(?![^\W_])", r"\\_", text)  # within words it has no meaning
    text = re.sub(r"^(?=#|[-+=](?![\d.]))", r"\\", text)  # headings, rules and lists
    return re.sub(r"^(\d+)(?=[.)](\s|$))", r"\1\\", text)
