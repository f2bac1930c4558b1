"""Simulations on disk: ``check.json`` has figures for people, ``record.json`` and ``check.npz`` the record."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pinograsp.checks import instance_of, mapping_of, path_of
from pinograsp.errors import InvalidInput
from pinograsp.plan import Simulation
from pinograsp.storage.consistency import check_simulation
from pinograsp.storage.files import RECORD, documents_of, read_arrays, read_document
from pinograsp.storage.schema import read_record
from pinograsp.writing import place_of, write_errors

SCHEMA = "pinograsp.check/2"
FIGURES = "check.json"
_ARRAYS = "check.npz"


def write_simulation(simulation: Simulation, folder: str | Path, studies: Mapping[str, Any]) -> None:
    """``check.json``, ``record.json`` and ``check.npz`` into a folder that exists.

    Args:
        simulation: what :func:`pinograsp.simulate` gave.
        folder: files in it are replaced.
        studies: what else was tried, as plain values by name; empty: nothing.

    Raises:
        InvalidInput: not a simulation, or studies that are not plain, finite values.
        ResultsNotWritten: the folder does not exist, or cannot be written.
    """
    folder = path_of("folder", folder)
    figures = {**instance_of("simulation", simulation, Simulation).summary(), **mapping_of("studies", studies)}
    documents = documents_of(simulation, SCHEMA, {FIGURES: figures})
    with write_errors(folder):
        documents.write(place_of(folder), _ARRAYS)


def read_simulation(folder: Path) -> Simulation:
    """The simulation in a folder; :class:`~pinograsp.errors.InvalidInput` with what is wrong first."""
    if (folder / FIGURES).is_file() and not (folder / RECORD).exists():
        raise InvalidInput(f"expected a check with its {RECORD}, got one of version 0.2 or earlier: simulate it again")
    document = read_document(folder / RECORD, SCHEMA)
    simulation = read_record(Simulation, document.get("record"), read_arrays(folder / _ARRAYS), {})
    check_simulation(simulation)
    return simulation
