"""Damaged and hostile folders of runs and simulations: what ``pinograsp plan`` and ``pinograsp check`` write, changed
by strangers.
"""

from __future__ import annotations

import io
import json
import pickle
import tempfile
import zipfile
from pathlib import Path

import numpy as np

import pinograsp as pg
from fuzzing.material import NAMES, NUMBERS, UNWRITABLE, damage, mutate_values, pick
from pinograsp.errors import GraspInfeasible, InvalidInput
from pinograsp.handover import joint_trajectory
from pinograsp.plan import PlanFailure
from pinograsp.planner import record_failure, save_run
from pinograsp.report import write_report
from pinograsp.simulation import simulate
from pinograsp.storage import newest_check, read_check, read_run, write_simulation
from pinograsp.viz.figures import save_figures
from pinograsp.viz.page import save_html
from pinograsp.viz.scene import make_scene

_SMALL = {"motion.time_step": 0.02, "motion.samples": 3, "forces.search": "convex"}
_KINDS = {
    "wrench": {"forces.balance": "wrench", "friction.safety": 1.1},
    "soft": {"forces.balance": "wrench", "friction.model": "soft", "friction.torsion_mm": 5.0, "friction.safety": 1.2},
    "force": {"forces.balance": "force"},
}
_files: dict[str, dict[str, bytes]] = {}


def prepare() -> None:
    """Real runs, with a simulation each, and a search that found nothing."""
    import viser  # noqa: F401

    with tempfile.TemporaryDirectory() as root:
        for name, changes in _KINDS.items():
            folder = Path(root) / name
            case = pg.load_case("paper", _SMALL | changes)
            plan = case.plan()
            save_run(plan, folder)
            simulation = simulate(plan, hold=0.01, time_step=1e-3, letting_go=0.02, sample=0.02)
            (folder / "check").mkdir()
            write_simulation(simulation, folder / "check", {})
        case = pg.load_case("paper", _SMALL | {"friction.mu": 0.05})
        try:
            case.plan()
        except GraspInfeasible as error:
            save_run(record_failure(error, "humanoid", case.settings()), Path(root) / "none")
        for folder in Path(root).iterdir():
            _files[folder.name] = {
                str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()
            }
        run = pg.load_run(Path(root) / "soft")  # what is made on first use is made before the clock runs
        figures = save_figures(run, Path(root))
        write_report(run, Path(root), figures)
        save_html(run, Path(root) / "page.html")


def make(rng: np.random.Generator, folder: Path) -> dict:
    kind = str(rng.choice([*_KINDS, "none"], p=[0.4, 0.3, 0.25, 0.05]))
    files = dict(_files[kind])
    deeds = []
    for _ in range(pick(rng, [1, 1, 1, 2, 3, 5])):
        deed = pick(rng, "json json json json arrays arrays arrays archive bytes rename rename file".split())
        names = [name for name, content in files.items() if name != "files.txt" and content is not None]
        if not names:
            break
        deeds.append(deed)
        if deed == "rename":
            _rename(rng, files)
            continue
        suffix = {"json": ".json", "arrays": ".npz", "archive": ".npz"}.get(deed, "")
        names = [name for name in names if name.endswith(suffix)]
        if names:
            name = pick(rng, names)
            change = {
                "json": _mutate_json,
                "arrays": _mutate_arrays,
                "archive": _write_archive,
                "bytes": damage,
                "file": _replace,
            }[deed]
            files[name] = change(rng, files[name])
            deeds[-1] += f" {name}"
    for name, content in files.items():
        path = folder / "run" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is not None:
            path.write_bytes(content)
    uses = ["report", "figures", "page", "scene", "simulate", "handover"]
    use = str(rng.choice(uses, p=[0.45, 0.04, 0.08, 0.25, 0.08, 0.1]))
    return {"folder": str(folder / "run"), "use": use, "deeds": deeds}


def run(case: dict) -> str:
    folder, use = Path(case["folder"]), case["use"]
    try:
        loaded = read_run(folder, with_scene=False) if use in ("report", "figures") else pg.load_run(folder)
    except InvalidInput as error:
        _well_told(error)
        return "run refused"
    newest = newest_check(folder)
    check, refused = None, ""
    if newest is not None:
        try:
            check = read_check(newest)
        except InvalidInput as error:
            _well_told(error)
            refused = ", check refused"
    try:
        if use in ("report", "figures"):
            drawn = use == "figures" and not isinstance(loaded, PlanFailure)
            figures = save_figures(loaded, folder) if drawn else []
            write_report(loaded, folder, figures, check)
        elif use == "page":
            save_html(loaded, folder / "page.html", simulation=check)
        elif use == "scene":
            make_scene(loaded, check)
        elif use == "simulate":
            simulate(loaded, hold=0.002, time_step=1e-3, letting_go=0.002, sample=0.02)
        else:
            trajectory = joint_trajectory(loaded, rate=50)
            trajectory.to_csv(folder / "a.csv")
            trajectory.to_ros2(folder / "a.yaml")
            trajectory.to_mujoco(folder / "a.xml")
    except pg.errors.PinograspError as error:
        _well_told(error)
        return f"{use} refused ({type(error).__name__}){refused}"
    return f"{use} done{refused}"


def _well_told(error: Exception) -> None:
    """One message that fits a terminal."""
    text = str(error)
    if not text or len(text) > 3000:
        raise AssertionError(f"a message of {len(text)} characters: {text[:300]}")


# -- changes -----------------------------------------------------------------------------------------------------------


def _mutate_json(rng, content: bytes) -> bytes:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return content
    values = [*NUMBERS, *NAMES, *UNWRITABLE, *(None, True, False, [], {}, [1.0], [None], [1.0] * 3, {"a": 1})]
    text = json.dumps(mutate_values(rng, document, values))
    if rng.random() < 0.05 and "{" in text:  # a key twice
        at = text.index("{") + 1
        text = text[:at] + f'"status": {json.dumps(pick(rng, values))}, ' + text[at:]
    if rng.random() < 0.03:
        text = text.replace("null", "[" * pick(rng, [30, 100, 2000, 100_000]), 1)
    return text.encode("utf-8", "surrogatepass")


def _rename(rng, files: dict) -> None:
    """A name changed everywhere: valid for all readers."""
    old = pick(rng, ["thumb", "index", "thumb_cmc", "paper", "humanoid", "middle_dip"])
    new = pick(rng, [*NAMES, *UNWRITABLE])
    inside = json.dumps(new)[1:-1].encode("utf-8", "surrogatepass")
    # In the description quotes are quoted twice.
    within_xml = new.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
    quoted = json.dumps(within_xml)[1:-1].encode("utf-8", "surrogatepass")
    for name, content in files.items():
        if content is not None and name.endswith(".json"):
            files[name] = content.replace(old.encode(), quoted if name == "scene.json" else inside)


def _load_arrays(content: bytes):
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except Exception:
        return None
    # Some have a hundred million entries of no bytes.
    return {name: array for name, array in arrays.items() if isinstance(array, np.ndarray) and array.size < 10**6}


def _save_arrays(arrays: dict) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _mutate_arrays(rng, content: bytes) -> bytes:
    arrays = _load_arrays(content)
    if not arrays:
        return content
    for _ in range(pick(rng, [1, 1, 2])):
        name = pick(rng, list(arrays))
        arrays[name] = _mutate_array(rng, np.array(arrays[name]))
        deed = rng.random()
        if deed < 0.1 and len(arrays) > 1:
            del arrays[name]
        elif deed < 0.2:
            arrays[name] = pick(rng, list(arrays.values()))
        elif deed < 0.3:
            arrays[pick(rng, NAMES).encode("ascii", "replace").decode()[:50] or "new"] = np.zeros(3)
    return _save_arrays(arrays)


def _mutate_array(rng, array: np.ndarray) -> np.ndarray:
    deed = rng.random()
    turned = [array.ravel(), array[None], array.reshape(array.shape[::-1]), array.T, np.zeros((0, *array.shape[1:]))]
    if deed < 0.12:
        return pick(rng, turned)
    if deed < 0.24 and array.ndim:
        shorter = array[: int(rng.integers(0, len(array) + 1))]
        return shorter if rng.random() < 0.7 else np.concatenate([array, array[-1:]])
    if deed < 0.36:
        kind = pick(rng, ["f4", "f2", "i8", "c16", "U5", "S5", "?", ">f8", "O", "V8", "m8[s]"])
        try:
            return array.astype(kind)
        except (ValueError, TypeError):
            return np.zeros(array.shape, kind)
    if array.dtype.kind not in "fiu" or not array.size:
        return array
    if deed < 0.5:
        with np.errstate(all="ignore"):
            return array * float(pick(rng, [-1, 0, 1e-6, 1e-300, 1e6, 1e20, 1e29, 1 + 1e-9]))
    numbers = [min(number, 1e300) if isinstance(number, int) else number for number in NUMBERS]
    if deed < 0.6:
        return np.full(array.shape, float(pick(rng, numbers)))
    flat = array.reshape(-1)
    for at in rng.integers(0, flat.size, pick(rng, [1, 1, 5])):
        try:
            flat[at] = pick(rng, numbers)
        except (OverflowError, ValueError):
            flat[at] = 0
    return array


class _Payload:
    def __reduce__(self):
        return exec, ("open('/tmp/pinograsp-was-here', 'w').close()",)


def _write_archive(rng, content: bytes) -> bytes:
    """Archives that no honest program writes."""
    arrays = _load_arrays(content) or {"times": np.zeros(3)}
    name = pick(rng, list(arrays))
    deed = pick(rng, ["pickle", "huge", "bomb", "lzma", "twice", "text", "path", "pickled", "npy"])
    if deed == "pickle":
        arrays[name] = np.array([_Payload()], dtype=object)
        return _save_arrays(arrays)
    if deed == "pickled":
        return pickle.dumps(_Payload())
    stream = io.BytesIO()
    if deed == "npy":
        np.save(stream, np.zeros(3))
        return stream.getvalue()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_LZMA if deed == "lzma" else zipfile.ZIP_DEFLATED) as archive:
        for key, array in arrays.items():
            member = io.BytesIO()
            np.lib.format.write_array(member, array, allow_pickle=False)
            data = member.getvalue()
            if key == name and deed == "huge":
                huge = "(1000000000000,);(100000000,);(-1,);(0, 10000000000000);(1,) * 9;(1e9,)"
                shape = pick(rng, huge.split(";"))
                kind = pick(rng, ["<f8", "<U1000000000", "|V0", "|S0", "<U0", "|O"])
                header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
                data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(100)
            if key == name and deed == "text":
                data = pick(rng, NAMES).encode("utf-8", "replace")
            if key == name and deed == "bomb":
                data += bytes(10**7)
            archive.writestr(("../" * 3 if deed == "path" and key == name else "") + key + ".npy", data)
            if key == name and deed == "twice":
                archive.writestr(key + ".npy ", data)
    data = stream.getvalue()
    if deed == "bomb":  # a size that is not so, in the directory at the end
        at = data.rfind(b"PK\x01\x02")
        data = data[: at + 24] + (2**31).to_bytes(4, "little") + data[at + 28 :]
    return data


def _replace(rng, content: bytes) -> bytes | None:
    """None: no such file."""
    deep = [b"[" * 100_000, b'{"a":' * 100_000]
    return pick(rng, [None, b"", b"[]", b"{}", b"null", b"\xff\xfe\x00", rng.bytes(100), content * 2, *deep])
