"""What the documents of a run and of a simulation may hold: plain, finite, of bounded depth, checked."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, StrictInt, StrictStr, ValidationError

from pinograsp.checks import one_line
from pinograsp.errors import InvalidInput, Status
from pinograsp.plain import plain_json
from pinograsp.plan.parts import Balance, FrictionModel, Measure

LARGEST = 2**29  # [bytes] of a file, unpacked
HUGE = 1e30  # no quantity here is larger, in any unit; products of a few still fit into a float
_DEEPEST = 40  # levels of a document

Number = Annotated[float, Field(ge=-HUGE, le=HUGE, allow_inf_nan=False)]
NotNegative = Annotated[float, Field(ge=0, le=HUGE, allow_inf_nan=False)]
Count = Annotated[StrictInt, Field(ge=0, le=10**18)]
Points = Annotated[StrictInt, Field(ge=0, le=10**300)]  # of a grid: k contacts have some 10^(5 k)
Numbers = dict[StrictStr, Number]
Texts = list[StrictStr]
Several = list[Number]
Known = Annotated[Status, Field(strict=False)]  # by its word


class Part(BaseModel):
    """Known fields are checked; others, of later versions, are left alone."""

    model_config = ConfigDict(strict=True, extra="ignore", hide_input_in_errors=True)


P = TypeVar("P", bound=Part)


# -- plan.json ---------------------------------------------------------------------------------------------------------


class FrictionPart(Part):
    """Friction of a plan."""

    mu: Annotated[list[NotNegative], Field(min_length=1)]
    model: FrictionModel
    edges: Annotated[StrictInt, Field(ge=4, le=1000, multiple_of=2)] | None
    safety: Annotated[float, Field(ge=1, le=HUGE)]
    torsion_m: NotNegative


class ReservePart(Part):
    """What the forces were planned to bear besides the load."""

    disturbance: NotNegative
    force_N: NotNegative
    moment_Nm: NotNegative
    mass: Annotated[float, Field(ge=0, lt=1)]
    friction: Annotated[float, Field(ge=0, lt=1)]
    normal_force_N: NotNegative
    torque: Annotated[float, Field(ge=0, lt=1)]
    softer: Annotated[float, Field(ge=1)] = 1.0
    stiffer: Annotated[float, Field(ge=1)] = 1.0
    loads: Annotated[StrictInt, Field(ge=1, le=10**6)]
    impact_times: Annotated[StrictInt, Field(ge=1, le=10**6)]
    above_unrestricted: NotNegative = 0.0


class CertificatePart(Part):
    """The proof of a convex search."""

    weights: Annotated[Numbers, Field(min_length=1)]
    objective: Number
    lower_bound: Number
    relative_gap: Number
    violation_N: Number
    active: Texts


class BandPart(Part):
    """Forces on contacts that are softer or stiffer than planned."""

    servos: StrictStr
    factors: Several
    normal_forces_N: dict[StrictStr, Several]
    remarks: list[StrictStr]


class MarginsPart(Part):
    """What a grasp bears besides its load."""

    friction_used: dict[StrictStr, Number | None]
    least_mu: Numbers
    slip_distance_N: Numbers
    load_factor: Number | None
    disturbance_any_N: Number
    weakest_direction: Annotated[Several, Field(min_length=3, max_length=6)]
    disturbance_force_N: Number
    disturbance_moment_Nm: Number | None
    force_closure: bool
    ferrari_canny_L1: Number
    min_singular_value: Number
    isotropy: Number
    stiffness_N_m: Annotated[
        list[Annotated[Several, Field(min_length=6, max_length=6)]], Field(min_length=6, max_length=6)
    ]
    band: BandPart | None = None


class GridPart(Part):
    """What a grid search looked at."""

    points: Points
    cells: Count
    rejections: dict[StrictStr, Count]
    qp_solves: Count


class MotionPart(Part):
    """How the motion ended."""

    status: Known
    remedy: StrictStr
    notes: Texts


class ComparisonPart(Part):
    """A published figure beside ours."""

    quantity: StrictStr
    unit: StrictStr
    published: Number | None
    ours: Number | None
    note: StrictStr


class SettingsPart(Part):
    """What readers use of a case."""

    name: StrictStr | None = None
    assumed: dict[StrictStr, StrictStr] | None = None


class FailureLayout(Part):
    """Names of a hand and its contacts."""

    hand: StrictStr
    contacts: Texts


class PlanLayout(FailureLayout):
    """Names of a hand's parts and contacts."""

    joints: Annotated[Texts, Field(min_length=1)]
    fingers: dict[StrictStr, list[StrictInt]]
    contacts: Annotated[Texts, Field(min_length=1)]


class ProofPart(Part):
    """Why there are no forces."""

    margin_N: Number
    direction: Annotated[Several, Field(min_length=3, max_length=6)]
    at_torque_limit: Texts
    residual: Annotated[Several, Field(min_length=6, max_length=6)]


class FailureDocument(Part):
    """A search that found that there is no grasp."""

    status: Known
    search: StrictStr
    message: StrictStr
    proof: ProofPart | None = None
    layout: FailureLayout
    settings: SettingsPart
    versions: dict[StrictStr, StrictStr]


class PlanDocument(Part):
    """A plan's figures."""

    status: Known
    search: StrictStr
    solver: StrictStr
    balance: Balance
    measure: Measure
    friction: FrictionPart
    reserve: ReservePart | None
    impact_time_s: NotNegative
    final_time_s: NotNegative
    normal_forces_N: Numbers
    multipliers: dict[StrictStr, Annotated[Several, Field(min_length=2, max_length=2)]]
    contact_forces_N: dict[StrictStr, Annotated[Several, Field(min_length=3, max_length=3)]]
    torsion_Nm: Numbers
    accelerations_m_s2: Numbers
    work_J: Number
    impulse_Ns: Number
    residual_N: NotNegative
    residual_Nm: NotNegative
    peak_torque_Nm: NotNegative
    tracking_error_m: Numbers
    postures_tried: dict[StrictStr, Count]
    forces_status: Known
    motion: MotionPart
    grid: GridPart | None
    certificate: CertificatePart | None
    margins: MarginsPart
    closing: dict[StrictStr, Any] | None
    comparison: list[ComparisonPart]
    cautions: Texts
    notes: Texts
    elapsed_by_stage_s: dict[StrictStr, NotNegative]
    layout: PlanLayout
    settings: SettingsPart
    versions: dict[StrictStr, StrictStr]


# -- check.json --------------------------------------------------------------------------------------------------------


class CheckDocument(Part):
    """A simulation's verdict and settings."""

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
    settled_error: Number | None = None
    causes: Texts = []
    remedies: Texts = []
    engine: StrictStr = "mujoco"  # until 0.2.0 there was a second one
    mode: StrictStr
    servo: dict[StrictStr, Any] = {}
    time_step_s: Number
    release_s: Number | None
    complete: Count
    planned_forces_N: Numbers
    final_forces_N: Numbers
    contact_exponent: Number
    disturbance: dict[StrictStr, Any]
    notes: Texts
    elapsed_s: NotNegative


# -- reading -----------------------------------------------------------------------------------------------------------


def read_document(path: Path, schema: str | None) -> dict[str, Any]:
    """The mapping in a JSON file, without its ``schema``.

    Raises:
        InvalidInput: another schema, a key that comes twice, or a document that is not plain, finite, and of bounded
            depth.
    """
    try:
        document = plain_json(_bounded(path), _DEEPEST)
    except (ValueError, OSError) as error:
        raise InvalidInput(f"{path.name}: {one_line(error)}") from error
    found = document.pop("schema", None) if isinstance(document, dict) else None
    if schema is not None and found != schema:
        raise InvalidInput(f"expected schema {schema}, got {found!r:.60} ({path.name}): plan it again")
    if not isinstance(document, dict):
        raise InvalidInput(f"{path.name}: expected a mapping, got {type(document).__name__}")
    return document


def checked(kind: type[P], document: dict[str, Any], file: str) -> P:
    """The document as checked values, or :class:`InvalidInput` with the first field that is not as expected."""
    try:
        return kind.model_validate(document)
    except ValidationError as error:
        first, *others = error.errors(include_url=False)
        where = ".".join(map(str, first["loc"]))[:200]
        more = f" (and {len(others)} more like this)" if others else ""
        text = f"{file}: {where}: {first['msg']}{more}: written by another version? Plan it again"
        raise InvalidInput(text) from None


def is_text(texts: list[str]) -> bool:
    """Whether all of it can be written down."""
    try:
        "".join(texts).encode()
    except UnicodeError:
        return False
    return True


def bounded(path: Path) -> Path:
    """``path``, if a file is there that is not too large."""
    if not path.is_file():
        raise ValueError("there is no such file")
    if (size := path.stat().st_size) > LARGEST:
        raise ValueError(f"expected at most {LARGEST} bytes, got {size}")
    return path


def _bounded(path: Path) -> bytes:
    return bounded(path).read_bytes()
