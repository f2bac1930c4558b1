"""What the files of a run and of a simulation may hold: read without running anything, within bounds, and checked
whole.

Folders come from strangers, too. What passes here needs no further look: names are there, numbers are numbers, and
arrays fit each other.
"""

from __future__ import annotations

import json
import zipfile
from pathlib import Path
from typing import Annotated, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, StrictInt, StrictStr, ValidationError

from pinograsp.checks import are_rotations, one_line
from pinograsp.contacts.friction import FRICTION_MODELS
from pinograsp.errors import InvalidInput, Status

_LARGEST = 2**29  # [bytes] of a file, unpacked
_DEEPEST = 40  # levels of a document
_HUGE = 1e30  # no quantity here is larger, in any unit; products of a few still fit into a float
_MOST_DIGITS = 400  # of an integer

Number = Annotated[float, Field(ge=-_HUGE, le=_HUGE, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=_HUGE, allow_inf_nan=False)]
Count = Annotated[StrictInt, Field(ge=0, le=10**18)]
Numbers = dict[StrictStr, Number]
Texts = list[StrictStr]


class Part(BaseModel):
    """Known fields are checked; others, of later versions, are let be."""

    model_config = ConfigDict(strict=True, extra="ignore", hide_input_in_errors=True)


# -- plan.json ---------------------------------------------------------------------------------------------------------


class FrictionPart(Part):
    """``friction`` of a plan."""

    mu: Annotated[list[NotNegative], Field(min_length=1)]
    model: Literal[FRICTION_MODELS]
    edges: Annotated[StrictInt, Field(ge=4, le=1000, multiple_of=2)] | None
    safety: Annotated[float, Field(ge=1, le=_HUGE)]
    torsion_m: NotNegative


class CertificatePart(Part):
    """``certificate`` of a plan."""

    weights: Annotated[Numbers, Field(min_length=1)]
    objective: Number
    lower_bound: Number
    relative_gap: Number
    violation_N: Number
    active: Texts
    branches: Count


class MarginsPart(Part):
    """``margins`` of a plan."""

    friction_used: dict[StrictStr, Number | None]
    least_mu: Numbers
    slip_distance_N: Numbers
    load_factor: Number | None
    disturbance_any_N: Number
    disturbance_force_N: Number
    disturbance_moment_Nm: Number | None
    force_closure: bool
    ferrari_canny_L1: Number
    min_singular_value: Number


class GridPart(Part):
    """``grid`` of a plan: the log of the paper's search."""

    points: Annotated[float, Field(ge=0, le=_HUGE)]
    cells: Count
    rejections: dict[StrictStr, Count]
    qp_solves: Count


class ComparisonRow(Part):
    """One row of ``comparison``: a published figure beside ours."""

    quantity: StrictStr
    unit: StrictStr
    published: Number | None
    ours: Number | None
    difference: Number | None
    note: StrictStr


class SettingsPart(Part):
    """``settings``: the case file, of which only these keys are looked at."""

    name: StrictStr | None = None
    assumed: dict[StrictStr, StrictStr] | None = None


class FailureLayout(Part):
    """``layout`` of a search that found no grasp."""

    hand: StrictStr
    contacts: Texts


class PlanLayout(FailureLayout):
    """``layout`` of a plan: names of its joints, fingers and contacts."""

    joints: Annotated[Texts, Field(min_length=1)]
    fingers: dict[StrictStr, list[StrictInt]]
    contacts: Annotated[Texts, Field(min_length=1)]


class FailureDocument(Part):
    """A search that found that there is no grasp."""

    status: Literal[tuple(status.value for status in Status)]
    search: StrictStr
    message: StrictStr
    layout: FailureLayout
    settings: SettingsPart
    versions: dict[StrictStr, StrictStr]


class PlanDocument(Part):
    """``plan.json`` of a plan."""

    status: Literal[tuple(status.value for status in Status)]
    remedy: StrictStr
    search: StrictStr
    solver: StrictStr
    balance: Literal["force", "wrench"]
    measure: StrictStr
    friction: FrictionPart
    impact_time_s: NotNegative
    final_time_s: NotNegative
    normal_forces_N: Numbers
    multipliers: dict[StrictStr, Annotated[list[Number], Field(min_length=2, max_length=2)]]
    contact_forces_N: dict[StrictStr, Annotated[list[Number], Field(min_length=3, max_length=3)]]
    torsion_Nm: Numbers
    accelerations_m_s2: Numbers
    work_J: Number
    impulse_Ns: Number
    residual_N: NotNegative
    residual_Nm: NotNegative
    max_penetration_m: Number
    joint_torque_max_Nm: dict[StrictStr, dict[StrictStr, list[Number]]]
    peak_torque_Nm: NotNegative
    tracking_error_m: Numbers
    postures_tried: dict[StrictStr, Count]
    grid: GridPart | None
    certificate: CertificatePart | None
    margins: MarginsPart
    cautions: Texts
    notes: Texts
    elapsed_s: NotNegative
    comparison: list[ComparisonRow] | None = None
    layout: PlanLayout
    settings: SettingsPart
    versions: dict[StrictStr, StrictStr]


# -- check.json --------------------------------------------------------------------------------------------------------


class CheckDocument(Part):
    """``check.json`` of a simulation."""

    held: bool
    reason: StrictStr
    drift_mm: Number
    tilt_deg: Number
    turn_deg: Number
    force_error: Number
    force_errors: Numbers
    penetration_error_mm: Number
    slipped: Texts
    unplanned_contacts: Texts
    joint_limit_hits: Texts
    saturated: Texts
    energy_error: Number | None
    engine: StrictStr
    mode: StrictStr
    time_step_s: Number
    release_s: Number | None
    end_s: Number
    planned_forces_N: Numbers
    final_forces_N: Numbers
    grasp_energy_mJ: Number
    energies_mJ: Numbers
    disturbance: dict
    notes: Texts
    elapsed_s: NotNegative


# -- arrays ------------------------------------------------------------------------------------------------------------

# Shapes by what counts: m samples, n joints, k contacts, p parts of the hand, any number b, d.
_PLAN = {
    "times": "m",
    "q": "mn",
    "dq": "mn",
    "ddq": "mn",
    "torques": "mn",
    "holding_torques": "n",
    "torque_limit": "n",
    "forces_o": "mk3",
    "depth": "mk",
    "rate": "mk",
    "normal_forces": "mk",
    "residual_force_o": "m3",
    "points_o": "k3",
    "rotations_oc": "k33",
    "com_o": "3",
    "load": "6",
    "gravity": "3",
    "object_mass": "",
    "mu": "k",
    "torsion_length": "",
    "contact_law": "3",
    "branches": "b4",
}
_MARGINS = {"margin_directions": "3d3", "margin_forces": "3d"}
_CHECK = {
    "times": "m",
    "q": "mn",
    "dq": "mn",
    "torques": "mn",
    "object_poses": "m44",
    "forces_o": "mp3",
    "normal_forces": "mp",
    "tangential_forces": "mp",
    "depths": "mp",
    "slips": "mp",
    "planned_forces": "p",
}
_MAY_BE_INFINITE = ("torque_limit", "branches")


def read_plan(folder: Path, schema: str) -> tuple[dict, dict[str, np.ndarray]]:
    """``plan.json`` and ``plan.npz`` of a folder.

    Raises:
        InvalidInput: what is wrong with them first.
    """
    document, arrays = read_document(folder / "plan.json", schema), _read_arrays(folder / "plan.npz")
    if "message" in document:
        _checked(FailureDocument, document, "plan.json")
        if arrays:
            raise InvalidInput("plan.npz: expected no arrays for a search without a plan")
        return document, arrays
    _checked(PlanDocument, document, "plan.json")
    _check_plan(document, arrays)
    return document, arrays


def read_check(folder: Path) -> tuple[dict, dict[str, np.ndarray]]:
    """``check.json`` and ``check.npz`` of a folder; :class:`InvalidInput` as above."""
    document, arrays = read_document(folder / "check.json", None), _read_arrays(folder / "check.npz")
    _checked(CheckDocument, document, "check.json")
    parts = document["planned_forces_N"]
    _expect(
        "check.json", "final_forces_N", "the parts of planned_forces_N", list(document["final_forces_N"]) == list(parts)
    )
    sizes = _sized("check.npz", arrays, _CHECK, {"p": len(parts)})
    _sized("check.npz", arrays, {name: "m" for name in arrays if name.startswith("energy_")}, sizes)
    _expect("check.npz", "times", "times that grow", bool(np.all(np.diff(arrays["times"]) > 0)))
    poses = arrays["object_poses"]
    good = are_rotations(poses[:, :3, :3]).all() and np.array_equal(
        poses[:, 3], np.tile([0.0, 0.0, 0.0, 1.0], (len(poses), 1))
    )
    _expect("check.npz", "object_poses", "placements", good)
    return document, arrays


def _check_plan(document: dict, arrays: dict) -> None:
    layout, file = document["layout"], "plan.json"
    contacts, joints = layout["contacts"], layout["joints"]
    n, k = len(joints), len(contacts)
    for name, names in (("joints", joints), ("contacts", contacts)):
        _expect(file, f"layout.{name}", "names, each once", len(set(names)) == len(names))
    for finger, dofs in layout["fingers"].items():
        _expect(
            file,
            f"layout.fingers.{finger}",
            f"numbers from 0 to {n - 1}, each once",
            all(0 <= dof < n for dof in dofs) and len(set(dofs)) == len(dofs),
        )
    for name in (
        "normal_forces_N",
        "multipliers",
        "contact_forces_N",
        "torsion_Nm",
        "accelerations_m_s2",
        "tracking_error_m",
    ):
        partial = name in ("multipliers", "torsion_Nm") and not document[name]
        _expect(file, name, f"the contacts {', '.join(contacts)}", partial or list(document[name]) == contacts)
    for name in ("friction_used", "least_mu", "slip_distance_N"):
        _expect(
            file, f"margins.{name}", f"the contacts {', '.join(contacts)}", list(document["margins"][name]) == contacts
        )
    friction, grid = document["friction"], document["grid"]
    _expect(file, "friction.mu", f"{k} numbers", len(friction["mu"]) == k)
    _expect(
        file,
        "friction.edges",
        "a number for a pyramid alone",
        (friction["edges"] is None) == (friction["model"] != "pyramid"),
    )
    _expect(
        file, "friction.torsion_m", "above 0 for soft fingers", friction["model"] != "soft" or friction["torsion_m"] > 0
    )
    _expect(
        file,
        "torsion_Nm",
        "the contacts' where torsion_m is above 0",
        bool(document["torsion_Nm"]) or friction["torsion_m"] == 0,
    )
    _expect(
        file,
        "certificate",
        "one for a search without a grid",
        document["certificate"] is not None or grid is not None,
    )

    file = "plan.npz"
    sizes = _sized(file, arrays, _PLAN, {"n": n, "k": k})
    if _MARGINS.keys() & arrays.keys():  # earlier runs did not keep them
        _sized(file, arrays, _MARGINS, {})
    times, impact = arrays["times"], arrays.get("impact")
    _expect(
        file,
        "times",
        "at least three, from 0 s on, each later than the one before",
        sizes["m"] >= 3 and times[0] >= 0 and bool(np.all(np.diff(times) > 0)),
    )
    _expect(
        file,
        "impact",
        "the number of a sample between the first and the last",
        impact is not None and impact.shape == () and impact.dtype.kind in "iu" and 0 < int(impact) < sizes["m"] - 1,
    )
    told = (document["impact_time_s"], document["final_time_s"])
    _expect(
        "plan.json",
        "impact_time_s, final_time_s",
        "the times of the arrays' impact and end",
        np.allclose(told, (times[int(impact)], times[-1]), rtol=1e-6, atol=0),
    )
    for name in ("mu", "torque_limit", "object_mass", "torsion_length"):
        _expect(file, name, "numbers from 0 on", bool(np.all(arrays[name] >= 0)))
    stiffness, damping, exponent = arrays["contact_law"]
    _expect(
        file,
        "contact_law",
        "a stiffness above 0, a damping from 0 on, an exponent above 0 and up to 100",
        stiffness > 0 and damping >= 0 and 0 < exponent <= 100,
    )
    _expect(file, "rotations_oc", "rotations", are_rotations(arrays["rotations_oc"]).all())
    _expect(file, "branches", "no NaN", not np.isnan(arrays["branches"]).any())
    if "certificate" in document and document["certificate"] is None:
        _expect(file, "branches", "none without a certificate", len(arrays["branches"]) == 0)
    for name in ("contact_names", "contact_links"):
        _expect(
            file, name, f"{k} names", name in arrays and arrays[name].dtype.kind == "U" and arrays[name].shape == (k,)
        )
        _expect(file, name, "readable text", _readable(_strings(arrays[name])))
    _expect(file, "contact_names", f"the contacts {', '.join(contacts)}", _strings(arrays["contact_names"]) == contacts)


def _expect(file: str, name: str, wanted: str, true: bool) -> None:
    if not true:
        raise InvalidInput(f"{file}: {name}: expected {wanted[:200]}")


def _sized(file: str, arrays: dict, shapes: dict[str, str], sizes: dict[str, int]) -> dict[str, int]:
    """The sizes that letters stand for, after a look at every array."""
    sizes = dict(sizes)
    for name, letters in shapes.items():
        if name not in arrays:
            raise InvalidInput(
                f"{file}: expected an array '{name}', got none: written by another version? Plan it again"
            )
        array = arrays[name]
        if array.ndim == len(letters):
            for letter, size in zip(letters, array.shape):
                sizes.setdefault(letter, size)
        wanted = tuple(int(letter) if letter.isdigit() else sizes.get(letter, -1) for letter in letters)
        if array.shape != wanted or array.dtype != np.float64:
            shape = "(" + ", ".join("any" if size < 0 else str(size) for size in wanted) + ")"
            raise InvalidInput(f"{file}: {name}: expected float64 of shape {shape}, got {array.dtype} of {array.shape}")
        bad = np.isnan(array) if name in _MAY_BE_INFINITE else ~np.isfinite(array)
        if bad.any() or (np.abs(array[np.isfinite(array)]) > _HUGE).any():
            raise InvalidInput(f"{file}: {name}: expected finite numbers up to {_HUGE:g}")
    return sizes


def _strings(array: np.ndarray) -> list[str]:
    try:
        return array.tolist()
    except (ValueError, UnicodeError):  # not characters
        return ["\ud800"]


def _readable(texts) -> bool:
    try:
        "".join(texts).encode()
    except UnicodeError:
        return False
    return True


# -- reading -----------------------------------------------------------------------------------------------------------


def read_document(path: Path, schema: str | None) -> dict:
    """The mapping in a JSON file, without its ``schema``.

    Raises:
        InvalidInput: another schema, a key that comes twice, or a document that is not plain, finite, and of bounded
            depth.
    """
    try:
        document = json.loads(
            _bounded(path).decode("utf-8"), object_pairs_hook=_once, parse_constant=_no_constant, parse_int=_bounded_int
        )
    except (ValueError, RecursionError, OSError) as error:
        raise InvalidInput(f"{path.name}: {one_line(error)}") from error
    found = document.pop("schema", None) if isinstance(document, dict) else None
    if schema is not None and found != schema:
        raise InvalidInput(f"expected schema {schema}, got {found!r:.60} ({path.name})")
    if not isinstance(document, dict):
        raise InvalidInput(f"{path.name}: expected a mapping, got {type(document).__name__}")
    level = [document]
    for _ in range(_DEEPEST):
        level = [
            one
            for part in level
            for one in (part.values() if isinstance(part, dict) else part)
            if isinstance(one, dict | list)
        ]
    if level:
        raise InvalidInput(f"{path.name}: expected at most {_DEEPEST} levels")
    if not _readable([json.dumps(document, ensure_ascii=False)]):
        raise InvalidInput(f"{path.name}: expected readable text, got characters that are none")
    return document


def _bounded(path: Path) -> bytes:
    if not path.is_file():
        raise ValueError("there is no such file")
    if (size := path.stat().st_size) > _LARGEST:
        raise ValueError(f"expected at most {_LARGEST} bytes, got {size}")
    return path.read_bytes()


def _once(pairs: list) -> dict:
    document = dict(pairs)
    if len(document) < len(pairs):
        keys = [key for key, _ in pairs]
        raise ValueError(f"expected each key once, got {max(keys, key=keys.count)[:60]!r} again")
    return document


def _no_constant(name: str):
    raise ValueError(f"expected finite numbers, got {name}")


def _bounded_int(text: str) -> int:
    if len(text) > _MOST_DIGITS:
        raise ValueError(f"expected numbers, got one of {len(text)} digits")
    return int(text)


def _read_arrays(path: Path) -> dict[str, np.ndarray]:
    """The arrays of an archive; nothing in it is run (no pickles)."""
    try:
        if not path.is_file():
            raise ValueError("there is no such file")
        with zipfile.ZipFile(path) as archive:
            members = archive.infolist()
        if sum(one.file_size for one in members) > _LARGEST:
            raise ValueError(f"expected at most {_LARGEST} bytes of arrays")
        if any(one.compress_type not in (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED) for one in members):
            raise ValueError("expected an archive that NumPy has written")
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        if not all(isinstance(array, np.ndarray) for array in arrays.values()):
            raise ValueError("expected arrays alone")
    except Exception as error:  # zipfile, zlib and NumPy raise whatever comes of a broken file
        raise InvalidInput(f"{path.name}: {one_line(error)}") from error
    return arrays


def _checked(kind: type[Part], document: dict, file: str) -> None:
    try:
        kind.model_validate(document)
    except ValidationError as error:
        first, *others = error.errors(include_url=False)
        where = ".".join(map(str, first["loc"]))[:200]
        more = f" (and {len(others)} more like this)" if others else ""
        raise InvalidInput(
            f"{file}: {where}: {first['msg']}{more}: written by another version? Plan it again"
        ) from None
