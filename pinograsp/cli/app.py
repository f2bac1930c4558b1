"""What all commands share: the application and common options."""

from __future__ import annotations

import contextlib
import json
import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp.cli import completion
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.writing import NewFolder

app = typer.Typer(
    no_args_is_help=True,
    context_settings={"help_option_names": ["-h", "--help"]},
    pretty_exceptions_enable=False,
    rich_markup_mode="rich",
    help="Grasp forces in newtons, joint torques and trajectories for robotic hands.",
)

# Options that commands share.
Root = Annotated[str | None, typer.Option(help="Link whose sub-tree is the hand, on an arm or a robot.")]
Palm = Annotated[str | None, typer.Option(help="Link that the fingers start from; default: where chains part.")]
Fingers = Annotated[
    list[str] | None,
    typer.Option("--finger", metavar="NAME=LINK", help="A finger's name and its last link; repeatable: these alone."),
]
Packages = Annotated[
    list[str] | None,
    typer.Option("--package", metavar="NAME=DIR", help="Folder of a ROS package, for files; repeatable."),
]
Arguments = Annotated[
    list[str] | None, typer.Option("--arg", metavar="NAME=VALUE", help="Argument of a xacro file; repeatable.")
]
Trusted = Annotated[
    bool, typer.Option("--trusted", help="Let the hand's xacro run code and read any file: for your own files only.")
]
Masses = Annotated[
    str,
    typer.Option(
        help="Of links without any: estimate (from their shapes) or file (massless).",
        autocompletion=completion.one_of(completion.MASSES),
    ),
]
Exclude = Annotated[
    list[str] | None, typer.Option("--exclude", metavar="LINK", help="Link that is not to touch; repeatable.")
]
Srdf = Annotated[str | None, typer.Option("--srdf", metavar="FILE", help="SRDF with pairs of links that may overlap.")]
Posture = Annotated[
    list[str] | None,
    typer.Option(
        "--posture", metavar="JOINT=VALUE", help="Where a joint of an arm or wrist stays \\[rad or m]; repeatable."
    ),
]
At = Annotated[
    str | None, typer.Option(help="Object in the hand's frame, x,y,z\\[,roll,pitch,yaw] \\[m, deg]; default: searched.")
]
Mu = Annotated[float, typer.Option(help="Friction coefficient of the search and the plan.")]
FrictionModel = Annotated[
    str | None,
    typer.Option(
        help="Friction of the search and the plan: pyramid, cone or soft (torsion 5 mm). Default: cone, and soft where "
        "two fingers touch.",
        autocompletion=completion.one_of(completion.FRICTION),
    ),
]
Samples = Annotated[int, typer.Option(help="Without --at: grasps to try.")]
Seed = Annotated[int, typer.Option(help="Without --at: seed of the search.")]
Wrap = Annotated[bool, typer.Option("--wrap", help="Wrap the fingers round the object (power grasp).")]
Within = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z,X,Y,Z",
        help="Where to hold it, a handle for example: lower and upper corner of a box in the object's frame \\[m].",
    ),
]
Safety = Annotated[float, typer.Option(help="Friction is used up to mu / safety.")]
Hulls = Annotated[
    bool,
    typer.Option("--hulls/--no-hulls", help="Take the convex hulls of the hand's meshes, as physics engines do."),
]
Jobs = Annotated[int, typer.Option(help="Processes; -1: all cores.")]
Backend = Annotated[
    str,
    typer.Option(
        help="joblib: this machine, or dask: the cluster of --scheduler.",
        autocompletion=completion.one_of(completion.BACKENDS),
    ),
]
Scheduler = Annotated[
    str | None, typer.Option(metavar="ADDRESS", help="Of a Dask scheduler, such as tcp://10.0.0.1:8786.")
]
Json = Annotated[bool, typer.Option("--json", help="Print one JSON object and nothing else, errors included.")]
Run = Annotated[
    Path, typer.Argument(help="Folder of a run: what 'pinograsp plan' has written.", autocompletion=completion.runs)
]


def pairs(option: str, given: list[str] | None) -> dict[str, str]:
    """The NAME=VALUE of a repeatable option."""
    found: dict[str, str] = {}
    for one in given or []:
        name, _, value = one.partition("=")
        if not name or not value or name in found:
            raise InvalidInput(f"{option}: expected NAME=VALUE, each name once, got '{one}'")
        found[name] = value
    return found


def numbers(option: str, text: str, counts: tuple[int, ...], wanted: str = "") -> list[float]:
    """The numbers of an option; ``counts``: how many there may be, ``wanted``: what they are, with their units.

    Raises:
        InvalidInput: other texts, other counts.
    """
    values = []
    with contextlib.suppress(ValueError):
        values = [float(value) for value in text.split(",")]
    if len(values) not in counts:
        many = " or ".join(map(str, counts))
        expected = f"{many} number{'' if counts == (1,) else 's'} separated by commas"
        what = f", {wanted}" if wanted else ""
        raise InvalidInput(f"{option}: expected {expected}{what}, got '{text:.100}'")
    return values


def posture_of(given: list[str] | None) -> dict[str, float]:
    """Positions by joint; :class:`InvalidInput` for texts that are not NAME=NUMBER, and for names given twice."""
    found = {}
    for joint, text in pairs("--posture", given).items():
        try:
            found[joint] = float(text)
        except ValueError:
            raise InvalidInput(f"--posture: expected JOINT=NUMBER [rad or m], got '{joint}={text}'") from None
    return found


def loading(
    palm: str | None,
    fingers: list[str] | None,
    packages: list[str] | None,
    arguments: list[str] | None,
    trusted: bool,
    masses: str,
    exclude: list[str] | None,
    srdf: str | None,
) -> dict[str, Any]:
    """How a hand's file is to be read, by the names of :func:`~pinograsp.hands.load_hand`; :class:`InvalidInput` for
    texts that are not NAME=VALUE, and for names given twice.
    """
    return {
        "palm": palm,
        "fingers": pairs("--finger", fingers) or None,
        "packages": {name: os.path.expanduser(folder) for name, folder in pairs("--package", packages).items()},
        "xacro_args": pairs("--arg", arguments),
        "trusted": trusted,
        "masses": masses,
        "exclude": exclude or [],
        "srdf": srdf,
    }


# Where a case file has what options say of a hand and an object, by the names of the commands' parameters.
_IN_CASES = {
    **dict.fromkeys(
        ("root", "palm", "fingers", "packages", "trusted", "masses", "exclude", "srdf", "hulls", "posture"), "hand."
    ),
    "arguments": "hand.xacro_args",
    "at": "hand.position_mm",
    "mu": "friction.mu",
    "friction": "friction.model",
    "safety": "friction.safety",
    **dict.fromkeys(("within", "samples", "seed", "wrap", "table", "check"), "contacts"),
    "torque_limit": "limits.torque_limit",
}


def refuse_with_case(context: typer.Context, case: str) -> None:
    """Refuse options of ``--hand`` and ``--object`` that were given with a case, which has all of that itself.

    Raises:
        InvalidInput: with the places of a case file where it is to be written.
    """
    options, places = [], []
    for parameter in context.command.params:
        name = parameter.name or ""
        source = context.get_parameter_source(name)
        if name in _IN_CASES and source is not None and source.name == "COMMANDLINE":
            place = _IN_CASES[name]
            options.append(max(parameter.opts, key=len))
            places.append(place + name if place.endswith(".") else place)
    if options:
        raise InvalidInput(
            f"{', '.join(options)}: expected with --hand and --object, got CASE '{case:.200}', whose hand, object and "
            f"contacts are in its file: write {', '.join(dict.fromkeys(places))} there, or give them with "
            "--set KEY=VALUE"
        )


# Options that may stand before the command or after it, and whether the object of --json was printed.
given = {"quiet": False, "verbose": False, "told": False}


def _set_quiet(context: typer.Context, quiet: bool) -> None:
    if quiet and not given["quiet"]:
        given["quiet"] = True
        context.with_resource(contextlib.redirect_stdout(context.with_resource(open(os.devnull, "w"))))  # noqa: SIM115


def _set_verbose(verbose: bool) -> None:
    given["verbose"] |= verbose


Quiet = Annotated[
    bool,
    typer.Option(
        "--quiet",
        "-q",
        callback=_set_quiet,
        expose_value=False,
        help="Print only errors; the exit code gives the result.",
    ),
]
Verbose = Annotated[
    bool,
    typer.Option(
        "--verbose",
        "-v",
        callback=_set_verbose,
        expose_value=False,
        help="Print all there is, and the traceback of an error.",
    ),
]


def _version(show: bool) -> None:
    if show:
        from importlib.metadata import version

        typer.echo(f"pinograsp {version('pinograsp')}")
        raise typer.Exit()


@app.callback()
def _main(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
    quiet: Quiet = False,
    verbose: Verbose = False,
) -> None:
    pass


def tell_json(document: dict[str, Any]) -> None:
    """Print the one object of ``--json``."""
    given["told"] = True
    typer.echo(json.dumps(document, allow_nan=False))


def bar(as_json: bool) -> bool | None:
    """Whether to show a progress bar; None: on terminals."""
    return False if as_json or given["quiet"] else None


def refuse_existing(option: str, file: Path, force: bool) -> None:
    """:class:`ResultsNotWritten` where a file is in the way of what ``option`` is to write."""
    from pinograsp.errors import ResultsNotWritten

    if os.path.lexists(file) and not force:
        raise ResultsNotWritten(f"{option}: '{file}' already exists: choose another name, or overwrite it with --force")


def new_folder(out: Path | None, force: bool, name: str, beside: Path = Path("runs")) -> NewFolder:
    """``--out``, or a new folder, NAME, NAME-2, ...; reserved for this process."""
    from pinograsp.writing import NewFolder

    return NewFolder(out, force=force) if out is not None else NewFolder.fresh(name, beside)
