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
from pinograsp.errors import GraspInfeasible, InvalidInput
from pinograsp.handover import joint_trajectory
from pinograsp.plan import PlanFailure
from pinograsp.planner import record_failure, save_run
from pinograsp.report import write_report
from pinograsp.simulation import simulate
from pinograsp.storage import newest_check, read_check, read_run, write_simulation
from pinograsp.viz.figures import save_figures
from pinograsp.viz.page import save_html
from pinograsp.viz.scene import scene_of

_SMALL = {"motion.time_step": 0.02, "motion.samples": 3, "forces.search": "convex"}
_KINDS = {
    "wrench": {"forces.balance": "wrench", "friction.safety": 1.1},
    "soft": {"forces.balance": "wrench", "friction.model": "soft", "friction.torsion_mm": 5.0, "friction.safety": 1.2},
    "force": {"forces.balance": "force"},
}
_NAMES = [
    "",
    " ",
    "x" * 5000,
    "tip ![x](plan.json)",
    "tip ![x](/etc/hostname)",
    "$x^2$",
    "$\\frac{1}{0",
    "a|b",
    "<script>alert(1)</script>",
    "=1+1",
    "@x",
    "\t=1",
    "_hidden",
    "a\nb",
    "a\x00b",
    "a\x1b[31mb",
    "../../up",
    "/",
    "..",
    "\u202egnp",
    "名前",
    "\U0001f600",
    "\ud800",
    "a/b",
    "-->",
    "]]>",
    "&amp;",
    "`code`",
    "**b**",
    "# h",
    "1. x",
    "{x}",
    "%s %d",
    "\\",
    "'",
    '"',
    "a" * 300 + "/b",
    "nan",
    "None",
    "$" * 9,
]
_NUMBERS = [
    0,
    -0.0,
    1,
    -1,
    2,
    3,
    0.5,
    1e-320,
    5e-324,
    1e-30,
    1e-9,
    -1e-9,
    1e9,
    1e30,
    -1e30,
    1e31,
    1e100,
    1e308,
    -1e308,
    10**18,
    10**30,
    10**400,
    2**63,
    -(2**63),
    1.0000000001,
    100,
    1000,
    90.0,
    0.1,
]
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
    for _ in range(int(rng.choice([1, 1, 1, 2, 3, 5]))):
        deed = rng.choice(
            [
                "json",
                "json",
                "json",
                "json",
                "arrays",
                "arrays",
                "arrays",
                "archive",
                "bytes",
                "rename",
                "rename",
                "file",
            ]
        )
        names = [name for name, content in files.items() if name != "files.txt" and content is not None]
        if not names:
            break
        deeds.append(str(deed))
        if deed == "rename":
            _rename(rng, files)
            continue
        suffix = {"json": ".json", "arrays": ".npz", "archive": ".npz"}.get(str(deed), "")
        names = [name for name in names if name.endswith(suffix)]
        if names:
            name = str(rng.choice(names))
            change = {"json": _json, "arrays": _arrays, "archive": _archive, "bytes": _bytes, "file": _file}[str(deed)]
            files[name] = change(rng, files[name])
            deeds[-1] += f" {name}"
    for name, content in files.items():
        path = folder / "run" / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if content is not None:
            path.write_bytes(content)
    use = str(
        rng.choice(
            ["report", "figures", "page", "scene", "simulate", "handover"], p=[0.45, 0.04, 0.08, 0.25, 0.08, 0.1]
        )
    )
    return {
        "folder": str(folder / "run"),
        "use": use,
        "deeds": deeds,
    }


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
            scene_of(loaded, check)
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


def _json(rng, content: bytes) -> bytes:
    try:
        document = json.loads(content)
    except (ValueError, RecursionError):
        return content
    if not isinstance(document, dict | list):
        return content
    for _ in range(int(rng.integers(1, 3))):
        holders = [document]
        for one in holders:
            below = one.values() if isinstance(one, dict) else one
            holders += [part for part in below if isinstance(part, dict | list) and len(part)]
            if len(holders) > 5000:
                break
        # The small ones have the meaning: lists of numbers are many.
        holder = holders[int(rng.integers(len(holders)) * rng.choice([0, 0.1, 1]))]
        keys = list(holder) if isinstance(holder, dict) else list(range(len(holder)))
        if not keys:
            continue
        key = keys[int(rng.integers(len(keys)))]
        deed = rng.choice(["drop", "value", "value", "value", "number", "number", "number", "key", "more", "copy"])
        if deed == "drop":
            del holder[key]
        elif deed == "value":
            holder[key] = _value(rng)
        elif deed == "number":
            holder[key] = (
                holder[key] * float(rng.choice([-1, 0, 1e-6, 0.5, 2, 1e6]))
                if isinstance(holder[key], float)
                else _number(rng)
            )
        elif deed == "key" and isinstance(holder, dict):
            holder[_name(rng)] = holder.pop(key)
        elif deed == "copy":
            holder[key] = holder[keys[int(rng.integers(len(keys)))]]
        elif isinstance(holder, dict):
            holder[_name(rng)] = _value(rng)
        else:
            holder.insert(int(rng.integers(len(holder) + 1)), _value(rng))
    text = json.dumps(document)
    if rng.random() < 0.05:  # a key twice
        at = text.index("{") + 1
        text = text[:at] + f'"status": {json.dumps(_value(rng))}, ' + text[at:]
    if rng.random() < 0.03:
        text = text.replace("null", "[" * int(rng.choice([30, 100, 2000, 100000])), 1)
    return text.encode("utf-8", "surrogatepass")


def _number(rng):
    return (
        _NUMBERS[int(rng.integers(len(_NUMBERS)))]
        if rng.random() < 0.9
        else float(rng.choice([np.nan, np.inf, -np.inf]))
    )


def _name(rng) -> str:
    return _NAMES[int(rng.integers(len(_NAMES)))]


def _value(rng):
    nested: list = []
    for _ in range(int(rng.choice([1, 20, 39, 60]))):
        nested = [nested]
    choices = [
        None,
        True,
        False,
        [],
        {},
        [1.0],
        [None],
        {"a": 1},
        nested,
        _number(rng),
        _name(rng),
        [_number(rng)] * 3,
        {_name(rng): _number(rng)},
    ]
    return choices[int(rng.integers(len(choices)))]


def _rename(rng, files: dict) -> None:
    """A name changed everywhere: valid for all readers."""
    old, new = str(rng.choice(["thumb", "index", "thumb_cmc", "paper", "humanoid", "middle_dip"])), _name(rng)
    inside = json.dumps(new)[1:-1].encode("utf-8", "surrogatepass")
    for name, content in files.items():
        if content is None:
            continue
        if name.endswith(".json"):
            if name == "scene.json":  # in the description quotes are quoted twice
                text = new.replace("&", "&amp;").replace("<", "&lt;").replace('"', "&quot;")
                files[name] = content.replace(old.encode(), json.dumps(text)[1:-1].encode("utf-8", "surrogatepass"))
            else:
                files[name] = content.replace(old.encode(), inside)


def _stored(content: bytes):
    try:
        with np.load(io.BytesIO(content), allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
    except Exception:
        return None
    # Some have a hundred million entries of no bytes.
    return {name: array for name, array in arrays.items() if isinstance(array, np.ndarray) and array.size < 10**6}


def _archived(arrays: dict) -> bytes:
    stream = io.BytesIO()
    np.savez_compressed(stream, **arrays)
    return stream.getvalue()


def _arrays(rng, content: bytes) -> bytes:
    arrays = _stored(content)
    if not arrays:
        return content
    for _ in range(int(rng.integers(1, 3))):
        name = str(rng.choice(list(arrays)))
        array = np.array(arrays[name])
        deed = rng.choice(["drop", "shape", "cut", "entry", "entry", "entry", "scale", "type", "all", "swap", "new"])
        numeric = array.dtype.kind in "fiu"
        if deed == "drop":
            del arrays[name]
            if not arrays:
                break
            continue
        if deed == "shape":
            array = [
                array.ravel(),
                array[None],
                array.reshape(array.shape[::-1]),
                array.T,
                np.zeros((0, *array.shape[1:])),
            ][int(rng.integers(5))]
        elif deed == "cut" and array.ndim:
            array = (
                array[: int(rng.integers(0, len(array) + 1))]
                if rng.random() < 0.7
                else np.concatenate([array, array[-1:]])
            )
        elif deed == "entry" and numeric and array.size:
            array = array.astype(float) if rng.random() < 0.8 and array.dtype.kind == "f" else array
            flat = array.reshape(-1)
            for at in rng.integers(0, flat.size, int(rng.choice([1, 1, 5]))):
                value = _number(rng)
                try:
                    flat[at] = value
                except (OverflowError, ValueError):
                    flat[at] = 0
        elif deed == "scale" and numeric:
            with np.errstate(all="ignore"):
                array = array * float(rng.choice([-1, 0, 1e-6, 1e-300, 1e6, 1e20, 1e29, 1 + 1e-9]))
        elif deed == "type":
            kind = rng.choice(["f4", "f2", "i8", "c16", "U5", "S5", "?", ">f8", "O", "V8", "m8[s]"])
            try:
                array = array.astype(kind)
            except (ValueError, TypeError):
                array = np.zeros(array.shape, kind)
        elif deed == "all" and numeric:
            array = np.full(array.shape, _float(_number(rng)))
        elif deed == "swap":
            array = arrays[str(rng.choice(list(arrays)))]
        else:
            arrays[_name(rng).replace("\0", "0").encode("ascii", "replace").decode()[:50] or "new"] = np.zeros(3)
        arrays[name] = array
    return _archived(arrays)


def _float(value) -> float:
    try:
        return float(value)
    except OverflowError:
        return np.inf


class _Payload:
    def __reduce__(self):
        return exec, ("open('/tmp/pinograsp-was-here', 'w').close()",)


def _archive(rng, content: bytes) -> bytes:
    """Archives that no honest program writes."""
    arrays = _stored(content) or {"times": np.zeros(3)}
    name = str(rng.choice(list(arrays)))
    deed = rng.choice(["pickle", "huge", "bomb", "lzma", "twice", "text", "path", "pickled", "npy"])
    if deed == "pickle":
        arrays[name] = np.array([_Payload()], dtype=object)
        return _archived(arrays)
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
                shape = str(
                    rng.choice(
                        ["(1000000000000,)", "(100000000,)", "(-1,)", "(0, 10000000000000)", "(1,) * 9", "(1e9,)"]
                    )
                )
                kind = str(rng.choice(["<f8", "<U1000000000", "|V0", "|S0", "<U0", "|O"]))
                header = f"{{'descr': '{kind}', 'fortran_order': False, 'shape': {shape}, }}".encode()
                data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header + bytes(100)
            if key == name and deed == "text":
                data = _name(rng).encode("utf-8", "replace")
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


def _bytes(rng, content: bytes) -> bytes:
    data = bytearray(content)
    for _ in range(int(rng.choice([1, 3, 30]))):
        if not data:
            break
        at, size = int(rng.integers(len(data))), int(rng.choice([1, 2, 10, 500]))
        deed = rng.choice(["flip", "cut", "drop", "insert", "copy"])
        if deed == "flip":
            data[at] ^= 1 << int(rng.integers(8))
        elif deed == "cut" and rng.random() < 0.2:
            del data[at:]
        elif deed == "drop":
            del data[at : at + size]
        elif deed == "insert":
            data[at:at] = rng.bytes(size)
        else:
            data[at : at + size] = data[:size]
    return bytes(data)


def _file(rng, content: bytes):
    """None: no such file."""
    return [
        None,
        b"",
        b"[]",
        b"{}",
        b"null",
        b"\xff\xfe\x00",
        rng.bytes(100),
        b"[" * 100000,
        b'{"a":' * 100000,
        content * 2,
    ][int(rng.integers(10))]
