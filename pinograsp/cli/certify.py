"""``pinograsp certify``."""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.options import HandOptions, WorkerOptions, read_pairs, tell_missing
from pinograsp.cli.screen import RIGHT, console, list_facts, print_table, show
from pinograsp.cli.session import OUTPUT, REQUIRED, Session, option
from pinograsp.errors import InvalidInput, Status

if TYPE_CHECKING:
    from pinograsp.certification import Protocol
    from pinograsp.forces import GraspConditions
    from pinograsp.sweep import Certified, DataSet

_SHOWN = 5  # faults
_MEANT = "The options --convention, --frame, --joint or --original say what the files mean"

_files = partial(option, "What the files mean")
_condition = partial(option, "What a grasp must hold")
_output = partial(option, OUTPUT)


@dataclass(frozen=True, slots=True, kw_only=True)
class MeaningOptions:
    """What files of grasps do not say."""

    hand: str = _files(
        "The hand: a name of 'pinograsp hands', or a URDF, xacro or MJCF file.",
        default=REQUIRED,
        complete=completion.complete_hands,
    )
    objects: Path = _files(
        "Folder of the objects that the files name, or the file of the only object.", default=REQUIRED, metavar="DIR"
    )
    format: str = _files(
        "Format of the files: auto, or a name from the documentation.", default="auto", complete=completion.formats
    )
    convention: str | None = _files(
        "Convention that the files use for their hand: a name from the documentation.", complete=completion.conventions
    )
    frame: str | None = _files("Link of the hand whose pose the files contain.", metavar="LINK")
    joints: list[str] | None = _files(
        "Name of a joint in the files and in the hand; repeatable.", "--joint", metavar="FILE'S=HAND'S"
    )
    original: str | None = _files("The data set's own description of the hand, to compare yours with.", metavar="FILE")
    mass: float | None = _files("Mass of each object \\[kg].")
    density: float | None = _files("Density of each object \\[kg/m^3], if --mass is not given.")

    def read(self, files: list[Path], described: HandOptions, protocol: Protocol | None) -> DataSet:
        """The files as a data set; masses of the objects as of the ``protocol`` where none are given."""
        from pinograsp.checks import one_of
        from pinograsp.data import FORMATS
        from pinograsp.hands import load_hand
        from pinograsp.sweep import DataSet

        kind = "auto" if self.format == "auto" else one_of("--format", self.format, FORMATS)
        original, mass, density = self.original, self.mass, self.density
        if protocol is not None and mass is None and density is None:
            mass, density = protocol.mass, protocol.density
        return DataSet(
            files=_list_files(files),
            hand=load_hand(self.hand, **described.settings()),
            objects=self.objects,
            format=kind,
            mass=mass,
            density=density,
            joints=read_pairs("--joint", self.joints) or None,
            frame=self.frame,
            convention=self.convention,
            original=None if original is None else load_hand(original, trusted=described.trusted),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ConditionOptions:
    """What a grasp must hold."""

    protocol: str | None = _condition(
        "Use the mass, friction and loads of this published benchmark instead of the following options.",
        complete=completion.protocols,
    )
    mu: float = _condition("Friction coefficient.", default=defaults.MU)
    tolerance: float | None = _condition(
        f"Distance within which a link touches, outside or inside \\[m]; default: {defaults.TOUCHES:g}, or the "
        "protocol's."
    )
    gravity: tuple[float, float, float] = _condition(
        "Gravity in the object's frame, or in the world of its file \\[m/s^2].",
        default=defaults.GRAVITY,
        metavar="X Y Z",
    )
    reserve: bool = _condition("Require the reserve besides the weight.", default=True)
    drives: bool = _condition(
        "Require forces that the hand's drives can produce; the table has this in any case.",
        "--ask-drives/--no-drives",
        default=True,
    )
    commanded: bool = _condition(
        "Also try grasps as commanded if the files have no commands: with references that produce the "
        "certified torques.",
        default=False,
    )

    def read(self) -> GraspConditions:
        """The conditions of the forces."""
        import numpy as np

        from pinograsp.certification.protocols import find_protocol
        from pinograsp.forces import GraspConditions, Reserve

        if (protocol := find_protocol(self.protocol)) is not None:
            return protocol.conditions()
        reserve = Reserve() if self.reserve else None
        return GraspConditions(mu=self.mu, gravity_o=np.array(self.gravity), reserve=reserve)


@dataclass(frozen=True, slots=True, kw_only=True)
class TableOptions:
    """Where the answers are written."""

    out: Path = _output("Folder for the rows, as Parquet files.", default=REQUIRED, metavar="DIR")
    back: Path | None = _output("Write the files again, with forces, into this folder.", metavar="DIR")
    picture: Path | None = _output(
        "Draw which grasps hold, why others do not, and the forces: .png or .svg.", metavar="FILE"
    )


def certify(
    *,
    files: Annotated[list[Path], typer.Argument(metavar="FILES", help="Files of grasps, or folders with such files.")],
    meaning: MeaningOptions,
    conditions: ConditionOptions,
    described: HandOptions,
    workers: WorkerOptions,
    results: TableOptions,
    session: Session,
) -> None:
    """Certify grasps of a data set: which hold, with how many newtons, and why the others do not. After an
    interruption, the same command continues.

    Examples:
      pinograsp certify mug.h5 --hand panda --objects meshes --mass 0.3 --out mugs

      pinograsp certify grasps --hand hand.xml --objects meshes --mass 1 --out all

    Replace these files by your data set's. With --back DIR they are written
    again, with forces. In a job array, use --shard I/N.
    """
    from pinograsp.certification.protocols import find_protocol
    from pinograsp.sweep import certify_files, find_missing_grasps, written_back
    from pinograsp.viz.certified import certified_picture

    out, back = results.out, results.back
    if out.resolve() in [path.resolve() for path in (meaning.objects, back) if path is not None]:
        raise InvalidInput("--out: expected a folder of its own")
    protocol = find_protocol(conditions.protocol)
    data = meaning.read(files, described, protocol)
    asked: dict[str, Any] = {
        "tolerance": conditions.tolerance,
        "drives": conditions.drives,
        "protocol": protocol,
        "commanded": conditions.commanded,
    }
    if workers.missing:
        tell_missing(find_missing_grasps(data, out, conditions.read(), shard=workers.shard, **asked), out, session)
    if workers.shard is not None and (back is not None or results.picture is not None):
        raise InvalidInput("--shard: expected neither --back nor --picture, which need all rows: run them at the end")
    settings = asked | workers.settings()
    done = certify_files(data, out, conditions.read(), progress=session.progress, **settings)
    written, unwritten = ([], {}) if back is None or done.interrupted else written_back(data, out, back)
    if results.picture is not None and done.rows:
        certified_picture(done.table().to_pydict(), results.picture)
    if session.as_json:
        status = Status.INTERRUPTED if done.interrupted else Status.INVALID_INPUT if done.faults else Status.OK
        more = {"written": [str(path) for path in written], "unwritten": unwritten}
        session.print_json({"status": str(status), "remedy": status.remedy} | done.summary() | more)
    else:
        _print(done, written, unwritten, "" if workers.shard is None else f" of shard {workers.shard}")
    if code := 130 if done.interrupted else 2 if done.faults else 0 if done.rows or workers.shard is not None else 3:
        raise typer.Exit(code)


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


def _print(done: Certified, written: list[Path], unwritten: dict[str, str], shard: str) -> None:
    from pinograsp.certification import decisive_hint

    words = {str(status): status.words for status in Status if status.code >= 0}
    rows = [
        (reason, str(count), f"{100 * count / done.rows:.1f} %", words[reason])
        for reason, count in sorted(done.counts.items(), key=lambda one: -one[1])
        if reason in words
    ]
    print_table({"reason": {}, "grasps": RIGHT, "share": RIGHT, "": {}}, rows)
    facts = [("again", f"{len(done.changed)} files that had changed, or whose objects had: {', '.join(done.changed)}")]
    facts = facts if done.changed else []
    if hint := decisive_hint(done.counts):
        facts.append(("look at", hint))
    facts += [("not used", f"{file}: {message}") for file, message in list(done.faults.items())[:_SHOWN]]
    if len(done.faults) > _SHOWN:
        facts.append(("not used", f"{len(done.faults) - _SHOWN} more files, see the rows 'refused'"))
    facts += [("look at", f"{hint}. {_MEANT}") for hint in list(done.hints.values())[:_SHOWN]]
    if len(done.hints) > _SHOWN:
        facts.append(("look at", f"{len(done.hints) - _SHOWN} more objects whose grasps are misplaced like this"))
    facts += [("not written", f"{file}: {message}") for file, message in list(unwritten.items())[:_SHOWN]]
    screen = console()
    for line in list_facts(facts, 3):
        screen.print(line, style="yellow", soft_wrap=True)
    holding, verdicts = done.counts.get("held", 0), done.verdicts
    left = "; some are left: the same command continues" if done.interrupted else ""
    answers = [
        ("What holds?", f"{holding} of {done.rows} grasps{shard}, {done.elapsed:.1f} s{left}"),
        ("Results", f"{done.folder}, rows as Parquet files"),
        ("Next", f"in Python: pinograsp.sweep.read_certified({str(done.folder)!r})"),
    ]
    if verdicts["commanded"]:
        held = f"{verdicts['held_as_commanded']} of {verdicts['commanded']}"
        answers.insert(1, ("Possible", f"{verdicts['possible']} of {done.rows}, held or held as commanded"))
        answers.insert(2, ("As commanded", f"{held} hold under all loads: column held_as_commanded"))
    if written:
        answers.insert(2, ("With forces", f"{len(written)} files in {written[0].parent}"))
    show([], answers, level="yes" if verdicts["possible"] else "no")
