"""A simulation's document and arrays, and the record that they are of."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from pinograsp.checks import are_rotations, instance_of, mapping_of, one_line, path_of
from pinograsp.errors import InvalidInput
from pinograsp.plan import Simulation, Verdict
from pinograsp.storage.arrays import Arrays, expect, read_arrays, sizes_of, write_arrays
from pinograsp.storage.documents import CheckDocument, checked, read_document
from pinograsp.writing import place_of, write_errors

_DOCUMENT, _ARRAYS = "check.json", "check.npz"
# Shapes by what counts: m samples, n joints, p parts of the hand.
_SHAPES = {
    "times": "m",
    "q": "mn",
    "dq": "mn",
    "torques": "mn",
    "object_poses": "m44",
    "com_b": "3",
    "forces_o": "mp3",
    "normal_forces": "mp",
    "tangential_forces": "mp",
    "depths": "mp",
    "slips": "mp",
    "planned_forces": "p",
}
ENERGIES = ("joint_work", "load_work", "mechanical", "elastic", "damped", "slipped", "normal_work")


def write_simulation(simulation: Simulation, folder: str | Path, studies: Mapping[str, Any]) -> None:
    """``check.json`` and ``check.npz`` into a folder that exists.

    Args:
        simulation: what :func:`pinograsp.simulate` gave.
        folder: files in it are replaced.
        studies: what else was tried, as plain values by name; empty: nothing.

    Raises:
        InvalidInput: not a simulation, or studies that are not plain, finite values.
        ResultsNotWritten: the folder does not exist, or cannot be written.
    """
    folder = path_of("folder", folder)
    document = {**instance_of("simulation", simulation, Simulation).summary(), **mapping_of("studies", studies)}
    try:
        text = json.dumps(document, indent=2, allow_nan=False)
    except (TypeError, ValueError) as error:
        raise InvalidInput(f"studies: expected plain, finite values by name ({one_line(error)})") from error
    with write_errors(folder):
        place = place_of(folder)
        (place / _DOCUMENT).write_text(text + "\n", encoding="utf-8")
        write_arrays(place / _ARRAYS, simulation.arrays())


def read_simulation(folder: Path) -> Simulation:
    """The simulation in a folder; :class:`~pinograsp.errors.InvalidInput` with what is wrong first."""
    document, arrays = read_document(folder / _DOCUMENT, None), read_arrays(folder / _ARRAYS)
    found = checked(CheckDocument, document, _DOCUMENT)
    _check_arrays(found, arrays)
    verdict = Verdict(
        held=found.held,
        reason=found.reason,
        drift=1e-3 * found.drift_mm,
        tilt=found.tilt_deg,
        turn=found.turn_deg,
        force_error=found.force_error,
        force_errors=found.force_errors,
        penetration_error=1e-3 * found.penetration_error_mm,
        slipped=tuple(found.slipped),
        unplanned=tuple(found.unplanned_contacts),
        limit_hits=tuple(found.joint_limit_hits),
        saturated=tuple(found.saturated),
        energy_error=found.energy_error,
        settled_error=found.settled_error,
        causes=tuple(found.causes),
        remedies=tuple(found.remedies),
    )
    # As it was written until 0.2.0.
    servo = {name: "impedance" if value == "position+torque" else value for name, value in found.servo.items()}
    other = [] if found.engine == "mujoco" else [f"simulated by the engine '{found.engine}' of an earlier version"]
    return Simulation(
        verdict=verdict,
        mode=found.mode,
        time_step=found.time_step_s,
        release=found.release_s,
        complete=found.complete,
        parts=tuple(found.planned_forces_N),
        energies={name: arrays[f"energy_{name}"] for name in ENERGIES},
        disturbance=found.disturbance,
        notes=(*found.notes, *other),
        elapsed=found.elapsed_s,
        exponent=found.contact_exponent,
        servo=servo,
        **{name: arrays[name] for name in _SHAPES},
    )


def _check_arrays(found: CheckDocument, arrays: Arrays) -> None:
    parts = found.planned_forces_N
    shapes = {**_SHAPES, **{f"energy_{name}": "m" for name in ENERGIES}}
    sizes = sizes_of(_ARRAYS, arrays, shapes, {"p": len(parts)})
    times = arrays["times"]
    expect(_ARRAYS, "times", "times that grow", times.size > 0 and bool(np.all(np.diff(times) > 0)))
    expect(_DOCUMENT, "complete", "the number of a sample", found.complete < sizes["m"])
    same = list(parts.values()) == arrays["planned_forces"].tolist()
    expect(_DOCUMENT, "planned_forces_N", "those of the arrays", same)
    same = list(found.final_forces_N.items()) == list(zip(parts, arrays["normal_forces"][-1].tolist()))
    expect(_DOCUMENT, "final_forces_N", "the parts' forces at the arrays' end", same)
    poses = arrays["object_poses"]
    bottom = np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1))
    good = bool(are_rotations(poses[:, :3, :3]).all()) and np.array_equal(poses[:, 3], bottom)
    expect(_ARRAYS, "object_poses", "placements", good)
