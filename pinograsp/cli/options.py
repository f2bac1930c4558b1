"""Options that commands share, in groups, and what their texts say."""

from __future__ import annotations

import contextlib
import os
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from pinograsp import defaults
from pinograsp.cli import completion
from pinograsp.cli.screen import show
from pinograsp.cli.session import OUTPUT, Session, option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.sweep import Missing
    from pinograsp.writing import NewFolder

_hand = partial(option, "How to read the hand")
_grasp = partial(option, "Where to grasp")
_wish = partial(option, "How to hold it (with --hand and --object)")
_friction = partial(option, "Friction")
_work = partial(option, "Parallel work")


@dataclass(frozen=True, slots=True, kw_only=True)
class HandOptions:
    """How a hand's file is to be read."""

    root: str | None = _hand("Link whose sub-tree is the hand, if the file also has an arm or a robot.")
    palm: str | None = _hand("Link from which the fingers start; default: where the kinematic chains part.")
    fingers: list[str] | None = _hand(
        "A finger's name and its last link; repeatable. Other fingers are then ignored.",
        "--finger",
        metavar="NAME=LINK",
    )
    packages: list[str] | None = _hand(
        "Folder of a ROS package that the file refers to; repeatable.", "--package", metavar="NAME=DIR"
    )
    arguments: list[str] | None = _hand("Argument for a xacro file; repeatable.", "--arg", metavar="NAME=VALUE")
    trusted: bool = _hand(
        "Let the hand's xacro run code and read any file; only for files that you trust.", "--trusted", default=False
    )
    masses: str = _hand(
        "Masses of links that have none: estimate (from their shapes) or file (massless).",
        default="estimate",
        choices=completion.MASSES,
    )
    exclude: list[str] | None = _hand("Link that must not touch anything; repeatable.", "--exclude", metavar="LINK")
    srdf: str | None = _hand("SRDF file with pairs of links that may overlap.", metavar="FILE")
    sheet: str | None = _hand(
        "Data sheet of the hand's drives: a .toml file, or the name of a sheet in the package, such as leap; "
        "default: HAND.drives.toml beside the hand's file.",
        "--drives",
        metavar="FILE",
    )

    def settings(self) -> dict[str, Any]:
        """By the names of :func:`~pinograsp.hands.load_hand`.

        Raises:
            InvalidInput: texts that are not NAME=VALUE, names given twice.
        """
        packages = read_pairs("--package", self.packages)
        return {
            "root": self.root,
            "palm": self.palm,
            "fingers": read_pairs("--finger", self.fingers) or None,
            "packages": {name: os.path.expanduser(folder) for name, folder in packages.items()},
            "xacro_args": read_pairs("--arg", self.arguments),
            "trusted": self.trusted,
            "masses": self.masses,
            "exclude": self.exclude or [],
            "srdf": self.srdf,
            "drives": self.sheet,
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmOptions(HandOptions):
    """The same of a hand that may be on an arm."""

    posture: list[str] | None = _hand(
        "Position at which a joint of an arm or wrist stays \\[rad or m]; repeatable.",
        "--posture",
        metavar="JOINT=VALUE",
    )

    def settings(self) -> dict[str, Any]:
        """By the names of :func:`~pinograsp.hands.load_hand`; :class:`InvalidInput` also for postures that are no
        numbers.
        """
        posture = {}
        for joint, text in read_pairs("--posture", self.posture).items():
            try:
                posture[joint] = float(text)
            except ValueError:
                raise InvalidInput(f"--posture: expected JOINT=NUMBER [rad or m], got '{joint}={text}'") from None
        return {**HandOptions.settings(self), "posture": posture}


@dataclass(frozen=True, slots=True, kw_only=True)
class GraspOptions:
    """Where a hand is to hold an object, and with which friction."""

    at: str | None = _grasp(
        "Pose of the object in the hand's frame, x,y,z\\[,roll,pitch,yaw] \\[m, deg]; default: search for one."
    )
    samples: int = _grasp("Without --at: number of grasps to try.", default=defaults.GRASPS)
    seed: int = _grasp("Without --at: random seed of the search.", default=0)
    wrap: bool = _grasp("Wrap the fingers round the object (power grasp).", "--wrap", default=False)
    hulls: bool = _grasp("Use the convex hulls of the hand's meshes, as physics engines do.", default=True)
    mu: float = _friction("Friction coefficient of the search and the plan.", default=defaults.MU)
    friction: str | None = _friction(
        "Friction model of the search and the plan: pyramid, cone or soft (torsion 5 mm); default: cone, or "
        "soft if two fingers touch.",
        choices=completion.FRICTION,
    )
    safety: float = _friction("Safety factor: plan with friction up to mu / safety.", default=1.0)

    def settings(self) -> dict[str, Any]:
        """By the names of a case of hand and object; :class:`InvalidInput` for texts that are no such numbers."""
        values = asdict(self)
        if self.at is not None:
            values["at"] = read_numbers("--at", self.at, (3, 6), "x,y,z or x,y,z,roll,pitch,yaw [m, deg]")
        return values


@dataclass(frozen=True, slots=True, kw_only=True)
class WishOptions:
    """How an object is to be held."""

    touching_fingers: str | None = _wish(
        "Only these fingers may touch the object.", "--fingers", metavar="NAME,NAME,..."
    )
    least_fingers: int | None = _wish(
        "Least number of fingers that touch the object; 2 allows pinches. Default: 3 are preferred."
    )
    within: str | None = _wish(
        "Touch the object only within this part: a name from the object's file, or the lower and upper corner "
        "of a box in the object's frame \\[m].",
        metavar="PART",
    )
    touching: list[str] | None = _wish("Part that a finger must touch; repeatable.", metavar="PART")
    forbidden: list[str] | None = _wish("Part that nothing may touch; repeatable.", metavar="PART")
    approach: str | None = _wish(
        "Side from which the hand approaches: above, below, side, or a direction x,y,z\\[,cone in deg]\\[,object].",
        metavar="SIDE",
    )
    edges: bool = _wish("Contacts may lie on edges of the object.", "--edges/--no-edges", default=True)
    palm_touches: bool | None = _wish(
        "Require or forbid contact with the palm.", "--palm-touches/--no-palm", default=None
    )
    opening: float = _wish(
        "Room around the object before the hand closes: how far the object may be displaced without touching "
        "the open hand \\[m].",
        default=0.0,
    )

    def settings(self) -> dict[str, Any]:
        """By the names of a case of hand and object: those that were given."""
        plain = WishOptions()
        return self.pick([name for name, value in asdict(self).items() if value not in ([], getattr(plain, name))])

    def pick(self, names: Iterable[str]) -> dict[str, Any]:
        """Those of these fields, by the names of a case of hand and object."""
        values, keys = asdict(self), {"touching_fingers": "fingers", "palm_touches": "palm"}
        return {keys.get(name, name): values[name] for name in names if name in values}


RESERVE_HELP = (
    "What to withstand besides the weight: none, default, or values such as disturbance=0.5,mass=0.2. Names: "
    "disturbance, mass, friction, normal_force, torque, drive (shares), moment_arm \\[m], softer, stiffer (factors on "
    "the contacts' stiffness)."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class WorkerOptions:
    """Who works on many things at once."""

    jobs: int = _work("Number of processes; -1: all cores.", default=-1)
    executor: str = _work(
        "Where to run: joblib (this machine) or dask (the cluster of --scheduler).",
        default="joblib",
        choices=completion.EXECUTORS,
    )
    scheduler: str | None = _work("Address of a Dask scheduler, such as tcp://10.0.0.1:8786.", metavar="ADDRESS")
    shard: str | None = _work(
        "Compute only share I of N, beside N - 1 other calls that write into the same folder.", metavar="I/N"
    )
    missing: bool = _work(
        "Compute nothing; print how many rows are missing, and from which shards. Exit code 3 if any are missing.",
        "--missing",
        default=False,
    )

    def settings(self) -> dict[str, Any]:
        """By the names of the functions that sweep."""
        from pinograsp.checks import one_of
        from pinograsp.sweep.runner import EXECUTORS

        executor = one_of("executor", self.executor, EXECUTORS)
        return {"jobs": self.jobs, "executor": executor, "scheduler": self.scheduler, "shard": self.shard}


def tell_missing(missing: Missing, folder: Path, session: Session) -> NoReturn:
    """Print what a folder does not have yet, and exit: with 0 where that is nothing."""
    from pinograsp.sweep.shards import write_numbers

    if session.as_json:
        session.print_json(missing.summary() | {"folder": str(folder)})
    else:
        answers = [("What is missing?", f"{missing.rows} of {missing.total} rows in {folder}")]
        for count, numbers in missing.shards.items():
            answers.append((f"Of {count} shards", write_numbers(numbers) or "none"))
        show([], answers, level="no" if missing.rows else "yes")
    raise typer.Exit(3 if missing.rows else 0)


RunFolder = Annotated[
    Path, typer.Argument(help="Folder of a run, written by 'pinograsp plan'.", autocompletion=completion.runs)
]


def out_option(default: str) -> Any:
    """Of ``--out``, with what it is by default."""
    return typer.Option("--out", help=f"Folder for the results; default: {default}", rich_help_panel=OUTPUT)


def force_option(overwritten: str) -> Any:
    """Of ``--force``."""
    return typer.Option("--force", help=f"Overwrite {overwritten}.", rich_help_panel=OUTPUT)


def new_folder(out: Path | None, force: bool, name: str, beside: Path = Path("runs")) -> NewFolder:
    """``--out``, or a new folder, NAME, NAME-2, ...; reserved for this process."""
    from pinograsp.writing import NewFolder

    return NewFolder(out, force=force) if out is not None else NewFolder.fresh(name, beside)


def refuse_existing(option: str, file: Path, force: bool) -> None:
    """:class:`ResultsNotWritten` where a file is in the way of what ``option`` is to write."""
    from pinograsp.errors import ResultsNotWritten

    if os.path.lexists(file) and not force:
        raise ResultsNotWritten(f"{option}: '{file}' already exists: choose another name, or overwrite it with --force")


def read_pairs(option: str, texts: list[str] | None) -> dict[str, str]:
    """The NAME=VALUE of a repeatable option."""
    pairs: dict[str, str] = {}
    for text in texts or []:
        name, _, value = text.partition("=")
        if not name or not value or name in pairs:
            raise InvalidInput(f"{option}: expected NAME=VALUE, each name once, got '{text}'")
        pairs[name] = value
    return pairs


def read_settings(option: str, text: str, known: Sequence[str]) -> dict[str, str]:
    """The NAME=VALUE,... of an option, each name once.

    Raises:
        InvalidInput: other texts, names that are not ``known``.
    """
    settings: dict[str, str] = {}
    for part in text.split(","):
        name, _, value = part.partition("=")
        if name not in known or name in settings or not value:
            raise InvalidInput(f"{option}: expected NAME=VALUE,... each once of {', '.join(known)}, got '{text:.100}'")
        settings[name] = value
    return settings


def read_numbers(option: str, text: str, counts: tuple[int, ...] = (), wanted: str = "") -> list[float]:
    """The numbers of an option; ``counts``: how many there may be (any where empty), ``wanted``: what they are, with
    their units.

    Raises:
        InvalidInput: other texts, other counts.
    """
    values: list[float] = []
    with contextlib.suppress(ValueError):
        values = [float(value) for value in text.split(",")]
    if not values or (counts and len(values) not in counts):
        many = f"{' or '.join(map(str, counts))} " if counts else ""
        expected = f"{many}number{'' if counts == (1,) else 's'} separated by commas"
        what = f", {wanted}" if wanted else ""
        raise InvalidInput(f"{option}: expected {expected}{what}, got '{text:.100}'")
    return values
