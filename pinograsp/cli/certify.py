"""``pinograsp certify``."""

from __future__ import annotations

import functools
import os
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.options import HandOptions, WorkerOptions, read_pairs
from pinograsp.cli.screen import console, listed, show
from pinograsp.cli.session import OUTPUT, Session
from pinograsp.errors import InvalidInput, Status

if TYPE_CHECKING:
    from pinograsp.forces import GraspConditions
    from pinograsp.sweep import Certified, DataSet

_SHOWN = 5  # faults
_MEANT = "What the files mean is said by --convention, --frame, --joint or --original"

_files = functools.partial(typer.Option, rich_help_panel="What the files mean")
_condition = functools.partial(typer.Option, rich_help_panel="What a grasp must hold")


@dataclass(frozen=True, slots=True, kw_only=True)
class FileOptions:
    """What files of grasps do not say."""

    hand: Annotated[
        str,
        _files(
            help="The hand: a name of 'pinograsp hands', or a URDF, xacro or MJCF file.",
            autocompletion=completion.hands,
        ),
    ]
    objects: Annotated[
        Path,
        _files(metavar="DIR", help="Folder of the objects that the files name; or the file of the one object."),
    ]
    format: Annotated[
        str,
        _files(help="Of the files: auto, or a name that the documentation lists.", autocompletion=completion.formats),
    ] = "auto"
    convention: Annotated[
        str | None,
        _files(
            help="What the files mean by their hand: a name that the documentation lists.",
            autocompletion=completion.conventions,
        ),
    ] = None
    frame: Annotated[
        str | None, _files(metavar="LINK", help="Link of the hand whose frame the files tell the place of.")
    ] = None
    joints: Annotated[
        list[str] | None,
        _files("--joint", metavar="FILE'S=HAND'S", help="The hand's name of a joint; repeatable."),
    ] = None
    original: Annotated[
        str | None, _files(metavar="FILE", help="The data set's own description of the hand, to compare with.")
    ] = None
    mass: Annotated[float | None, _files(help="Of each object \\[kg].")] = None
    density: Annotated[float | None, _files(help="Of each object \\[kg/m^3], where --mass is not given.")] = None

    def read(self, files: list[Path], described: HandOptions) -> DataSet:
        """The files as a data set."""
        from pinograsp.checks import one_of
        from pinograsp.data import FORMATS
        from pinograsp.hands import load_hand
        from pinograsp.sweep import DataSet

        kind = "auto" if self.format == "auto" else one_of("--format", self.format, FORMATS)
        original = self.original
        return DataSet(
            files=_list_files(files),
            hand=load_hand(self.hand, **described.settings()),
            objects=self.objects,
            format=kind,
            mass=self.mass,
            density=self.density,
            joints=read_pairs("--joint", self.joints) or None,
            frame=self.frame,
            convention=self.convention,
            original=None if original is None else load_hand(original, trusted=described.trusted),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionOptions:
    """What a grasp must hold."""

    mu: Annotated[float, _condition(help="Friction coefficient.")] = defaults.MU
    tolerance: Annotated[float, _condition(help="Distance at which a link touches, outside or inside \\[m].")] = (
        defaults.TOUCHES
    )
    gravity: Annotated[
        tuple[float, float, float],
        _condition(metavar="X Y Z", help="In the object's frame, or its file's world \\[m/s^2]."),
    ] = defaults.GRAVITY
    reserve: Annotated[bool, _condition(help="Ask for the reserve besides the weight.")] = True
    drives: Annotated[
        bool, _condition(help="Ask for forces that the hand's drives can make; the table has it anyway.")
    ] = True

    def read(self) -> GraspConditions:
        """The conditions of the forces."""
        import numpy as np

        from pinograsp.forces import GraspConditions, Reserve

        reserve = Reserve() if self.reserve else None
        return GraspConditions(mu=self.mu, gravity_o=np.array(self.gravity), reserve=reserve)


def certify(
    *,
    files: Annotated[list[Path], typer.Argument(metavar="FILES", help="Files of grasps, or folders of them.")],
    meaning: FileOptions,
    conditions: ConditionOptions,
    described: HandOptions,
    workers: WorkerOptions,
    out: Annotated[
        Path, typer.Option(metavar="DIR", help="Folder for the rows, as Parquet files.", rich_help_panel=OUTPUT)
    ],
    back: Annotated[
        Path | None,
        typer.Option(
            metavar="DIR", help="Write the files again, with newtons, into this folder.", rich_help_panel=OUTPUT
        ),
    ] = None,
    picture: Annotated[
        Path | None,
        typer.Option(
            metavar="FILE",
            help="Picture of what holds, why not, and the newtons: .png or .svg.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    session: Session,
) -> None:
    """Certify grasps of a data set: which hold, with how many newtons, and why the others do not. After an
    interruption, the same command continues.

    Examples:
      pinograsp certify mug.h5 --hand panda --objects meshes --mass 0.3 --out mugs

      pinograsp certify grasps --hand hand.xml --objects meshes --mass 1 --out all

    With your data set's files in place; --back DIR writes them again, with newtons.
    """
    from pinograsp.sweep import certify_files, written_back
    from pinograsp.viz.certified import certified_picture

    if out.resolve() in [path.resolve() for path in (meaning.objects, back) if path is not None]:
        raise InvalidInput("--out: expected a folder of its own")
    data = meaning.read(files, described)
    done = certify_files(
        data,
        out,
        conditions.read(),
        tolerance=conditions.tolerance,
        drives=conditions.drives,
        progress=session.progress,
        **workers.settings(),
    )
    written, unwritten = ([], {}) if back is None or done.interrupted else written_back(data, out, back)
    if picture is not None and done.rows:
        certified_picture(done.table().to_pydict(), picture)
    if session.as_json:
        status, remedy = Status.OK, ""
        if done.interrupted:
            status, remedy = Status.INTERRUPTED, "Some grasps are left: the same command continues."
        elif done.faults:
            status = Status.INVALID_INPUT
            remedy = "Mend or remove the files that faults name: the same command certifies them, too."
        more = {"written": [str(path) for path in written], "unwritten": unwritten}
        session.print_json({"status": str(status), "remedy": remedy} | done.summary() | more)
    else:
        _print(done, written, unwritten)
    if done.interrupted:
        raise typer.Exit(130)
    if done.faults:
        raise typer.Exit(2)
    if not done.rows:
        raise typer.Exit(3)


def _list_files(paths: list[Path]) -> list[Path]:
    """The files, those of folders in the order of their names, also what is no file and will be a fault."""
    found: list[Path] = []
    for path in paths:
        if not os.path.isdir(path):
            found.append(path)
            continue
        inside = sorted(one for one in path.rglob("*") if not os.path.isdir(one) and not one.name.startswith("."))
        if not inside:
            raise InvalidInput(f"FILES: expected files of grasps, got '{path}', an empty folder")
        found += inside
    return found


def _print(done: Certified, written: list[Path], unwritten: dict[str, str]) -> None:
    from rich.table import Table

    screen = console()
    table = Table(box=None, header_style="bold")
    table.add_column("reason")
    for name in ("grasps", "share"):
        table.add_column(name, justify="right")
    table.add_column("")
    words = {str(status): status.words for status in Status if status.code >= 0}
    for reason, count in sorted(done.counts.items(), key=lambda one: -one[1]):
        if reason in words:
            table.add_row(reason, str(count), f"{100 * count / done.rows:.1f} %", words[reason])
    screen.print(table)
    facts = [("again", f"{len(done.changed)} files, which had changed or their objects: {', '.join(done.changed)}")]
    facts = facts if done.changed else []
    facts += [("not used", f"{file}: {message}") for file, message in list(done.faults.items())[:_SHOWN]]
    if len(done.faults) > _SHOWN:
        facts.append(("not used", f"{len(done.faults) - _SHOWN} more files, see the rows 'refused'"))
    facts += [("look at", f"{hint}. {_MEANT}") for hint in list(done.hints.values())[:_SHOWN]]
    if len(done.hints) > _SHOWN:
        facts.append(("look at", f"{len(done.hints) - _SHOWN} more objects whose grasps are misplaced like this"))
    facts += [("not written", f"{file}: {message}") for file, message in list(unwritten.items())[:_SHOWN]]
    for line in listed(facts, 3):
        screen.print(line, style="yellow", soft_wrap=True)
    holding = done.counts.get("held", 0)
    left = "; some are left: the same command continues" if done.interrupted else ""
    answers = [
        ("What holds?", f"{holding} of {done.rows} grasps, {done.elapsed:.1f} s{left}"),
        ("Results", f"{done.folder}, rows as Parquet files"),
        ("Next", f"in Python: pinograsp.sweep.read_certified({str(done.folder)!r})"),
    ]
    if written:
        answers.insert(2, ("With newtons", f"{len(written)} files in {written[0].parent}"))
    show([], answers, level="yes" if holding else "no")
