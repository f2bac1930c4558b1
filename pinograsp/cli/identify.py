"""``pinograsp identify``."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinograsp.cli import completion
from pinograsp.cli.options import read_numbers, read_pairs, refuse_existing
from pinograsp.cli.screen import RIGHT, Fact, print_table, show
from pinograsp.cli.session import Session, option
from pinograsp.errors import InvalidInput

if TYPE_CHECKING:
    from pinograsp.identification import Estimate, IdentifiedClosings
    from pinograsp.spatial import Array

_OF_CLOSINGS = {"columns", "units", "newtons", "cap", "force", "drive"}  # options, as a session has them typed
_OF_MOTION = {"masses", "gravity"}
_log = partial(option, "How to read the logs")
_sheet = partial(option, "What to make of them")


@dataclass(frozen=True, slots=True, kw_only=True)
class LogOptions:
    """How logs are to be read."""

    columns: list[str] | None = _log(
        "Column of a quantity: time, position, force, speed (commanded) or limit (of the force); or a number, "
        "if the quantity is constant. Repeatable. Default: columns of these names.",
        "--column",
        metavar="QUANTITY=COLUMN",
    )
    units: list[str] | None = _log(
        "Unit of a quantity; required for position (count, rad, deg, m, mm) and force (count, N, mN, gf). "
        "Time is in s. Repeatable.",
        "--unit",
        metavar="QUANTITY=UNIT",
    )
    hand: str | None = _log(
        "Hand that moved freely; the log has columns JOINT/position \\[rad or m] and DRIVE/effort \\[register units].",
        complete=completion.complete_hands,
    )
    gravity: str = _log(
        "With --hand: gravity in the frame of the hand's root during the log \\[m/s^2].",
        default="0,0,-9.81",
        metavar="X,Y,Z",
    )
    masses: list[str] | None = _log(
        "With --hand: known mass that was attached to a link \\[kg]; repeatable.", "--mass", metavar="LINK=KG"
    )
    newtons: str | None = _log(
        "Conversion of force counts to newtons: slope and offset, calibrated with a scale.", metavar="SLOPE,OFFSET"
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class SheetOptions:
    """What is made of logs."""

    cap: list[float] | None = _sheet(
        "Find the fastest touch that stays below this force \\[N, or counts]; repeatable.", metavar="N"
    )
    force: list[float] | None = _sheet(
        "Find the speed and limit that produce this force \\[N, or counts]; repeatable.", "--for-force", metavar="N"
    )
    out: Path | None = _sheet("Write a data sheet of drives (.toml).", metavar="FILE")
    drive: str = _sheet("With --out: name of the drive, or a pattern such as finger_*.", default="*", metavar="NAME")
    overwrite: bool = _sheet("Overwrite the file.", "--force", default=False)


def identify(
    *,
    logs: Annotated[list[Path], typer.Argument(help="Logs: CSV (.gz), Parquet, bags of ROS 1 and 2.")],
    reading: LogOptions,
    sheet: SheetOptions,
    session: Session,
) -> None:
    """Identify how hard a real finger presses, by speed and force limit, from logs of it closing on a stop. With
    --hand: identify what effort its drives produce per register unit, from a log of its free motion.

    Examples:
      pinograsp identify log.csv --unit position=count --unit force=count

      pinograsp identify motion.csv --hand allegro_right --out drives.toml

    With --newtons 0.0065,0.02 forces are in newtons; --cap 4 finds the fastest
    touch under 4 N; --out hand.drives.toml writes a data sheet, which plans read
    beside hand.urdf.
    """
    if sheet.out is not None:
        if sheet.out.suffix != ".toml":
            raise InvalidInput(f"--out: expected a name that ends in .toml, got '{sheet.out.name}'")
        refuse_existing("--out", sheet.out, sheet.overwrite)
    if reading.hand is not None:
        _identify_drives(logs, reading, sheet, session)
    else:
        _identify_closings(logs, reading, sheet, session)


def _identify_drives(logs: list[Path], reading: LogOptions, sheet: SheetOptions, session: Session) -> None:
    from pinograsp.hands import load_hand
    from pinograsp.hands.sheets import write_sheet
    from pinograsp.identification import apply_fits, identify_motion, read_motion
    from pinograsp.writing import write_file

    if typed := [name for key, name in session.typed.items() if key in _OF_CLOSINGS]:
        raise InvalidInput(f"{', '.join(typed)}: expected for closings on a stop, got them with --hand")
    if len(logs) != 1:
        raise InvalidInput(f"--hand: expected one log, got {len(logs)}")
    hand = load_hand(str(reading.hand))
    masses = {}
    for link, text in read_pairs("--mass", reading.masses).items():
        (masses[link],) = read_numbers("--mass", text, (1,), "LINK=KG")
    gravity = read_numbers("--gravity", reading.gravity, (3,), "x,y,z [m/s^2]")
    found = identify_motion(hand, read_motion(logs[0], hand), masses=masses, gravity_o=gravity)
    if sheet.out is not None:
        identified = apply_fits(hand.drives, found.drives, f"identified from {logs[0].name}")
        write_file(sheet.out, write_sheet(identified, hand.name).encode())
    if session.as_json:
        plain = {
            name: {key: _plain(value) for key, value in fit._asdict().items()} for name, fit in found.drives.items()
        }
        session.print_json({"drives": plain, "unknown": dict(found.unknown)})
        return
    print_table(
        {
            "drive": {},
            **dict.fromkeys(("effort per unit", "95 % from", "to", "friction", "by load", "delay [s]"), RIGHT),
        },
        [
            [
                name,
                *(f"{one:.4g}" for one in fit.effort_step),
                f"{fit.friction.value:.3g}",
                f"{100 * (fit.load_friction.value + fit.outer_friction.value):.3g} %",
                f"{fit.delay:.3g}",
            ]
            for name, fit in found.drives.items()
        ],
    )
    answers: list[Fact] = [("What is known?", f"{len(found.drives)} of {len(hand.drives)} drives")]
    show(
        [("not identified", f"{name}: {why}") for name, why in found.unknown.items()],
        answers if sheet.out is None else [*answers, ("Written", str(sheet.out))],
        more="" if session.verbose else "more: with -v",
    )


def _plain(value: Estimate | Array | float) -> Any:
    if isinstance(value, float):
        return value
    return value._asdict() if isinstance(value, tuple) else value.tolist()


def _identify_closings(logs: list[Path], reading: LogOptions, sheet: SheetOptions, session: Session) -> None:
    from pinograsp.hands.sheets import write_closing
    from pinograsp.identification import identify_closings, read_log
    from pinograsp.writing import write_file

    if typed := [name for key, name in session.typed.items() if key in _OF_MOTION]:
        raise InvalidInput(f"{', '.join(typed)}: expected with --hand, got them for closings on a stop")
    newtons = None if reading.newtons is None else read_numbers("--newtons", reading.newtons, (2,), "slope and offset")
    columns, units = read_pairs("--column", reading.columns), read_pairs("--unit", reading.units)
    found = identify_closings([read_log(log, columns=columns, units=units) for log in logs], newtons=newtons)
    touches = [(f"under {cap:g}", found.table.find_touch(cap)) for cap in sheet.cap or ()]
    touches += [(f"for {force:g}", found.table.find_command(force)) for force in sheet.force or ()]
    if sheet.out is not None:
        names = ", ".join(log.name for log in logs[:3]) + (f" and {len(logs) - 3} more" if len(logs) > 3 else "")
        ratios = None if found.contact is None else found.contact.find_ratios()
        write_file(sheet.out, write_closing(found.table, sheet.drive, f"identified from {names}", ratios).encode())
    if session.as_json:
        session.print_json(_document(found, touches, sheet.out))
        return
    _print_table(found)
    facts = _facts(found)
    unit = found.table.unit
    answers: list[Fact] = [("How hard?", f"{found.table}; {sum(found.table.trials)} closings")]
    answers += [
        (f"{name} {unit}", f"speed {one.speed:g}, limit {one.limit:.4g}: {_words(one.peak, unit)}")
        for name, one in touches
    ]
    answers += [] if sheet.out is None else [("Written", str(sheet.out))]
    show(facts, answers, more="" if session.verbose else "more: with -v")


def _words(peak: Any, unit: str) -> str:
    return f"{peak.value:.4g} {unit} in the median, {peak.low:.4g} to {peak.high:.4g} in 90 % of the closings"


def _interval(name: str, one: Estimate, unit: str) -> Fact:
    return name, f"{one.value:.4g} {unit} ({one.low:.4g} to {one.high:.4g})".replace("  ", " ")


def _facts(found: IdentifiedClosings) -> list[Fact]:
    facts: list[Fact] = [("not identified", text) for text in found.unknown]
    if found.sensor_lag is not None:
        facts.append(_interval("sensor lag", found.sensor_lag, "s"))
    if found.contact is not None:
        facts.append(_interval("contact begins", found.contact.start, ""))
        facts.append(_interval("contact exponent", found.contact.exponent, ""))
        facts.append(
            ("contact law", f"K {found.contact.stiffness.value:.4g}, forces to {100 * found.contact.error:.2g} %")
        )
    return [*facts, *(("left out", text) for text in found.remarks)]


def _print_table(found: IdentifiedClosings) -> None:
    table = found.table
    unit, columns = table.unit, ("speed", "limit", "closings")
    rows = zip(table.speeds, table.limits, table.trials, table.peaks, table.low, table.high)
    print_table(
        {name: RIGHT for name in (*columns, f"peak [{unit}]", "5 %", "95 %")},
        [
            [f"{speed:g}", f"{limit:g}", str(trials), *(f"{one:.4g}" for one in forces)]
            for speed, limit, trials, *forces in rows
        ],
    )


def _document(found: IdentifiedClosings, touches: list[tuple[str, Any]], out: Path | None) -> dict[str, Any]:
    from pinograsp.hands.drive_records import closing_record

    plain: dict[str, Any] = {
        "closing": closing_record(found.table),
        "free_speeds": {f"{speed:g}": value for speed, value in found.free_speeds.items()},
        "sensor_lag_s": found.sensor_lag and found.sensor_lag._asdict(),
        "contact": None,
        "commands": {name: {**one._asdict(), "peak": one.peak._asdict()} for name, one in touches},
        "unknown": list(found.unknown),
        "remarks": list(found.remarks),
    }
    if found.contact is not None:
        names = ("start", "stiffness", "exponent")
        plain["contact"] = {name: getattr(found.contact, name)._asdict() for name in names}
        plain["contact"]["error"] = found.contact.error
    return plain if out is None else {**plain, "out": str(out)}
