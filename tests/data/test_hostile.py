"""Files that would run something, fill the memory, or are not what they say: told apart, and nothing happens."""

from __future__ import annotations

import io
import json
import os
import pickle
import resource
import struct
import time
import zipfile
from pathlib import Path

import grasp_files
import numpy as np
import pytest
import yaml

from pinograsp.data import read_grasps
from pinograsp.errors import GraspsNotRead

NPY = b"\x93NUMPY\x01\x00v\x00" + b"{'descr': '|O', 'fortran_order': False, 'shape': (), }".ljust(117) + b"\n"
DTYPE_F8 = b"cnumpy\ndtype\nX\x02\x00\x00\x00f8\x89\x88\x87R(K\x03X\x01\x00\x00\x00<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb"
DTYPE_O = DTYPE_F8.replace(b"f8", b"O8")


def write(tmp_path, content, name="file.npy"):
    (tmp_path / name).write_bytes(content)
    return tmp_path / name


def refused(path, match, **arguments):
    """The one exception, and the rows before it."""
    rows = []
    with pytest.raises(GraspsNotRead, match=match) as caught:
        for block in read_grasps(path, **arguments):
            rows.append(block)
    assert len(str(caught.value)) < 1500 and "\n" not in str(caught.value)
    return rows, caught.value


class Evil:
    def __init__(self, function, *arguments):
        self.function, self.arguments = function, arguments

    def __reduce__(self):
        return self.function, self.arguments


class Stated:
    """State set on an object of a class that is there."""

    def __reduce__(self):
        return np.ndarray, ((1,),), {"x": 1}


@pytest.fixture
def canary(tmp_path):
    path = tmp_path / "canary"
    yield path
    assert not path.exists(), "something of the file was run"


@pytest.mark.parametrize("protocol", range(6))
def test_nothing_of_a_pickle_is_run(protocol, tmp_path, canary):
    command = f"touch {canary}"
    for function, *arguments in (
        (os.system, command),
        (eval, f"open({str(canary)!r}, 'w')"),
        (exec, f"open({str(canary)!r}, 'w')"),
        (open, str(canary), "w"),
        (getattr, os, "system") if protocol > 1 else (os.mkdir, str(canary)),
    ):
        try:
            content = pickle.dumps({"qpos": Evil(function, *arguments), "scale": 1.0}, protocol=protocol)
        except TypeError:  # modules are not pickled
            continue
        path = write(tmp_path, NPY + content)
        for kind in ("auto", "dexgraspnet", "bodex", "get_a_grip"):
            _, error = refused(path, "nothing in the file was executed|not allowed", format=kind)
        assert function.__name__ in str(error) or "mkdir" in str(error)


def test_numpys_own_file_with_a_command_in_it_gives_the_rows_before(tmp_path, canary):
    rows = grasp_files.dexgraspnet_rows(grasp_files.some_grasps(d=22))
    rows[3]["extra"] = Evil(os.system, f"touch {canary}")
    path = grasp_files.npy(tmp_path / "mug.npy", rows)
    blocks, error = refused(path, "posix.system|os.system")
    assert sum(one.n for one in blocks) == 3 and "3 rows before are good" in str(error)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x82\x01.", "EXT1"),
        (b"\x84\x01\x00\x00\x00.", "EXT4"),
        (b"(cos\nsystem\no.", "os.system"),
        (b"(S'touch x'\nios\nsystem\n.", "MARK|STRING|INST"),
        (b"(X\x01\x00\x00\x00xios\nsystem\n.", "INST"),
        (b"cnumpy\nndarray\n)\x81.", "NEWOBJ"),
        (b"cnumpy\nndarray\n)}\x92.", "NEWOBJ_EX"),
        (b"Pxyz\n.", "PERSID"),
        (b"K\x01Q.", "outside the file"),
        (b"\x97.", "NEXT_BUFFER"),
        (b"\x8f(K\x01\x90.", "EMPTY_SET"),
        (b"(K\x01\x91.", "FROZENSET"),
        (b"K\x01)R.", "int is called"),
        (b"cnumpy\nndarray\n(K\xfftR.", "class is called"),
        (b"cnumpy\nndarray\n}X\x01\x00\x00\x00aK\x01sb.", "gets a state"),
        (b"]}X\x01\x00\x00\x00aK\x01sb.", "list gets a state"),
        (b"cnumpy\nndarray\n.", "not plain data"),
        (b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R.", "without its numbers"),
        (b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\ndtype\nK\x00\x85C\x01b\x87R.", "expected numpy.ndarray"),
        (
            b"cnumpy.core.multiarray\nscalar\n" + DTYPE_O + b"C\x08\x01\x02\x03\x04\x05\x06\x07\x08\x86R.",
            "is an object",
        ),
        (
            b"cnumpy._core.numeric\n_frombuffer\n(C\x08\x01\x02\x03\x04\x05\x06\x07\x08"
            + DTYPE_O
            + b"K\x01\x85X\x01\x00\x00\x00CtR.",
            "objects from bytes",
        ),
        (b"cnumpy\ndtype\nX\x03\x00\x00\x00V16\x89\x88\x87R.", "type 'V16'"),
        (b"cnumpy\ndtype\nX\x05\x00\x00\x00U9999\x89\x88\x87R.", "data type|not plain|_Type"),
        (b"cbuiltins\neval\nX\x01\x00\x00\x001\x85R.", "builtins.eval"),
        (b"\x8c\x08builtins\x8c\x04eval\x93\x8c\x011\x85R.", "builtins.eval"),
        (b"}(KK" + b"\x85" * 50 + b"K\x01u.", "as a key"),
        (b"0.", "POP"),
        (b"a.", "broken"),
        (b"h\x05.", "broken"),
        (b"\x80\x7f.", "broken"),
        (b"X\xff\xff\xff\x7fabc.", "broken"),
        (b"\x96\xff\xff\xff\xff\xff\xff\xff\x0f.", "broken"),
        (b"", "broken|cut off"),
        (b"I" + b"9" * 5000 + b"\n.", "broken"),
    ],
)
def test_opcodes_that_plain_data_needs_none_of(content, message, tmp_path, canary):
    refused(write(tmp_path, NPY + content), message)


def array_opcodes(shape, raw=b"", kind=DTYPE_F8):
    sizes = b"(" + b"".join(b"\x8a\x08" + struct.pack("<q", one) for one in shape) + b"t"
    data = b"B" + struct.pack("<I", len(raw)) + raw
    head = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    return head + b"(K\x01" + sizes + kind + b"\x89" + data + b"tb"


@pytest.mark.parametrize(
    "shape", [(10**12,), (10**6, 10**6), (2**31, 2**31, 2**31), (-1,), (2**62, 4), (1,) * 40, (3,)]
)
def test_shapes_without_their_numbers_take_no_memory(shape, tmp_path):
    refused(write(tmp_path, NPY + b"}(X\x04\x00\x00\x00qpos" + array_opcodes(shape) + b"u."), "shape")


@pytest.mark.parametrize(
    "content",
    [
        b"Nr\xff\xff\xff\x7f.",  # a memo of 2**31 places
        b"Np2147483647\n.",
        b"]q\x00" + b"(h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00h\x00e" * 40 + b".",
        b"]q\x00"
        + b"".join(b"](" + b"h" + bytes([i]) + b"h" + bytes([i]) + b"eq" + bytes([i + 1]) for i in range(60))
        + b".",
        b"](" * 100_000 + b".",
        b")" + b"\x85" * 200_000 + b".",
        b"]" + b"(" * 100_000,
    ],
)
def test_pickles_that_grow_when_they_are_opened(content, tmp_path):
    """Lists of lists of the same lists, 200000 levels, and places in a memo that nobody needs."""
    limit = resource.getrlimit(resource.RLIMIT_AS)
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + 2**30, limit[1]))
    try:
        refused(write(tmp_path, NPY + content), "expected|broken|cut off|plain data")
        inner = b"}(X\x04\x00\x00\x00qpos" + content[:-1] + b"u."
        refused(write(tmp_path, NPY + inner), "expected|broken|cut off|plain data")
    finally:
        resource.setrlimit(resource.RLIMIT_AS, limit)


def test_the_same_list_in_many_arrays(tmp_path):
    """2 million references to one list of 1000 objects, in 2000 arrays: each of them copies it."""
    many = b"](" + b"N" * 200_000 + b"eq\x01"
    head = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    one = head + b"(K\x01J\x40\x0d\x03\x00\x85" + DTYPE_O + b"\x89h\x01tb0"
    refused(write(tmp_path, NPY + many + one * 2000 + b"."), "bytes of arrays")


def test_the_same_array_in_many_rows_and_under_many_names(tmp_path):
    rows = grasp_files.dexgraspnet_rows(grasp_files.some_grasps(n=40, d=22))
    large = np.zeros(10**6)
    for row in rows:
        row["contact"] = large
    refused(grasp_files.npy(tmp_path / "mug.npy", rows), "one kind of numbers")
    document = grasp_files.get_a_grip(grasp_files.some_grasps(n=4))
    wide = np.zeros((4, 10**6))
    document.update({f"wide{i}": wide for i in range(100)})
    refused(grasp_files.npy(tmp_path / "mug_0_05.npy", document), "bytes of labels and other arrays")


def test_headers_of_any_length_are_not_read(tmp_path):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as out:
        for name in ("points", "offsets", "scores"):
            out.writestr(f"{name}.npy", b"\x93NUMPY\x02\x00\xff\xff\xff\x7f" + bytes(10**7))
    refused(write(tmp_path, stream.getvalue(), "003_labels.npz"), "version 1")


def test_lists_of_the_same_lists_are_no_numbers(tmp_path):
    """10**30 numbers in 60 lists."""
    nested = [1.0] * 10
    for _ in range(30):
        nested = [nested] * 10
    g = grasp_files.some_grasps(n=1)
    for name in ("obj_pose", "obj_scale", "grasp_qpos"):
        document = {**grasp_files.dexgraspbench(g), name: nested}
        refused(write(tmp_path, NPY + pickle.dumps(document, protocol=4)), "expected at most .* values")


def test_cut_off_at_any_byte_one_exception_comes(tmp_path):
    rows = grasp_files.dexgraspnet_rows(grasp_files.some_grasps(d=22))
    content = grasp_files.npy(tmp_path / "mug.npy", rows).read_bytes()
    lengths = []
    for size in range(1, len(content) - 1, 37):
        blocks, _ = refused(write(tmp_path, content[:size], "cut.npy"), "broken|cut off|expected|pickle")
        lengths.append(sum(one.n for one in blocks))
        for block in blocks:
            assert block.labels["energy"].tolist() == list(range(block.n))
    assert lengths == sorted(lengths) and lengths[-1] >= 4


@pytest.mark.parametrize("kind", ["torch", "npz", "json", "yaml", "hdf5", "dict"])
def test_changed_bytes_bring_one_exception_or_rows(kind, tmp_path):
    g = grasp_files.some_grasps(n=2)
    path = tmp_path / "file"
    if kind == "torch":
        path.write_bytes(grasp_files.torch_bytes(grasp_files.graspqp(g, [f"joint_{i}.0" for i in range(16)])))
    elif kind == "npz":
        grasp_files.graspnet(tmp_path / "file.npz", points=1)
        path = tmp_path / "file.npz"
    elif kind == "dict":
        path = grasp_files.npy(tmp_path / "file.npy", grasp_files.dexonomy(grasp_files.some_grasps(n=1)))
    else:
        {"json": grasp_files.graspgen, "yaml": grasp_files.isaac, "hdf5": grasp_files.acronym}[kind](path, g)
    content, rng = path.read_bytes(), np.random.default_rng(0)
    for _ in range({"npz": 25, "hdf5": 8}.get(kind, 60)):  # HDF5's reader is a process for each
        broken = bytearray(content)
        for _ in range(rng.integers(1, 4)):
            broken[rng.integers(len(broken))] = rng.integers(256)
        if rng.uniform() < 0.3:
            del broken[rng.integers(len(broken)) :]
        path.write_bytes(broken)
        try:
            for _ in read_grasps(path):
                pass
        except GraspsNotRead:
            pass


# -- archives


def archive(tmp_path, members, compression=zipfile.ZIP_STORED, name="mug.pt"):
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", compression) as out:
        for member, content in members.items():
            out.writestr(member, content)
    return write(tmp_path, stream.getvalue(), name)


def test_pytorch_files_run_nothing(tmp_path, canary):
    command = pickle.dumps(Evil(os.system, f"touch {canary}"), protocol=2)
    refused(archive(tmp_path, {"a/data.pkl": command, "a/version": "3"}), "system")
    storage = b"(X\x07\x00\x00\x00storageccollections\nOrderedDict\nX\x01\x00\x00\x000X\x03\x00\x00\x00cpuK\x01tQ."
    refused(archive(tmp_path, {"a/data.pkl": b"\x80\x02" + storage}), "storage of an unknown type")
    refused(archive(tmp_path, {"a/data.pkl": b"\x80\x02ctorch.nn\nLinear\n)R."}), "torch.nn.Linear")


def test_archives_that_unpack_to_more_than_they_are(tmp_path):
    zeros = bytes(50_000_000)
    path = archive(tmp_path, {"a/data.pkl": b"\x80\x02}.", "a/data/0": zeros}, zipfile.ZIP_DEFLATED)
    assert path.stat().st_size < 100_000
    refused(path, "compressed")
    refused(archive(tmp_path, {"a/data.pkl": b"\x80\x02}.", "b/data.pkl": b"\x80\x02}."}), "same name")
    refused(archive(tmp_path, {"a/other": b""}), "ZIP archive of a/other")


def test_tensors_stay_within_their_storage(tmp_path):
    good = grasp_files.torch_bytes({"parameters": {"root_pose": np.zeros((2, 7))}})
    with zipfile.ZipFile(io.BytesIO(good)) as source:
        members = {one: source.read(one) for one in source.namelist()}
    pickled = members["mug/data.pkl"]
    for old, new, message in (
        (b"K\x02K\x07\x86", b"K\x03K\x07\x86", "beyond its storage"),
        (b"K\x02K\x07\x86", b"J\xff\xff\xff\x7fK\x07\x86", "beyond its storage"),
        (b"K\x07K\x01\x86", b"K\x07K\x63\x86", "beyond its storage"),
    ):
        assert pickled.count(old) == 1
        refused(archive(tmp_path, {**members, "mug/data.pkl": pickled.replace(old, new)}), message)
    # Strides of zero: few numbers, many times.
    many = pickled.replace(b"K\x02K\x07\x86", b"J\x00\x00\x00\x10K\x07\x86").replace(
        b"K\x07K\x01\x86", b"K\x00K\x00\x86"
    )
    refused(archive(tmp_path, {**members, "mug/data.pkl": many}), "in its storage, got 14")
    refused(archive(tmp_path, {**members, "mug/data/0": b"123"}), "broken|cut off")
    refused(archive(tmp_path, {name: one for name, one in members.items() if name != "mug/data/0"}), "no tensor '0'")
    refused(archive(tmp_path, {**members, "mug/byteorder": b"big"}), "byte order")


def test_graspnet_labels_that_do_not_fit(tmp_path):
    arrays = grasp_files.graspnet(tmp_path / "003_labels.npz", points=1)

    def refused_with(message, **changed):
        kept = {name: one for name, one in {**arrays, **changed}.items() if one is not None}
        np.savez(tmp_path / "x_labels.npz", **kept)
        refused(tmp_path / "x_labels.npz", message)

    refused_with("expected arrays points, offsets and scores", scores=None)
    refused_with("'offsets': expected the shape", offsets=arrays["offsets"][..., :2])
    refused_with("expected numbers", scores=arrays["scores"].astype(object))
    worse = arrays["offsets"].copy()
    valid = np.argwhere((arrays["scores"] > 0) & ~arrays["collision"])
    worse[(*valid[4], 0)] = np.nan
    np.savez(tmp_path / "x_labels.npz", **{**arrays, "offsets": worse})
    rows, error = refused(tmp_path / "x_labels.npz", "rotations", block=2)
    assert sum(one.n for one in rows) == 4 and error.row == 4


# -- values


def changed_row(tmp_path, change):
    rows = grasp_files.dexgraspnet_rows(grasp_files.some_grasps(d=22))
    change(rows[2])
    return grasp_files.npy(tmp_path / "mug.npy", rows)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda row: row["qpos"].update(WRJTx=float("nan")), "finite positions"),
        (lambda row: row["qpos"].update(WRJTx=310.0), "metres, not millimetres"),
        (lambda row: row["qpos"].update(WRJRy=float("inf")), "rotations"),
        (lambda row: row["qpos"].update({"robot0:FFJ3": float("nan")}), "joint positions"),
        (lambda row: row["qpos"].pop("robot0:FFJ3"), "robot0:FFJ3"),
        (lambda row: row["qpos"].pop("WRJRz"), "'qpos/WRJRz'"),
        (lambda row: row.pop("scale"), "expected keys 'scale'"),
        (lambda row: row.update(scale=0.0), "scale: expected"),
        (lambda row: row.update(scale="large"), "'scale': expected numbers"),
        (lambda row: row.update(qpos=[1, 2]), "expected a mapping 'qpos'"),
        (lambda row: row["qpos"].update({7: 1.0}), "names of joints"),
    ],
)
def test_a_bad_row_comes_after_the_rows_before_it(change, message, tmp_path):
    for block in (1, 2, 1024):
        rows, error = refused(changed_row(tmp_path, change), message, block=block)
        assert sum(one.n for one in rows) == 2 and error.row == 2


def test_quaternions_have_length_one(tmp_path):
    g = grasp_files.some_grasps()
    document = grasp_files.bodex(g, [f"joint_{i}.0" for i in range(16)])
    document["robot_pose"][0, 3, 1, 3:7] *= 1.2
    rows, error = refused(grasp_files.npy(tmp_path / "a.npy", document), "unit quaternions w x y z")
    assert sum(one.n for one in rows) == 3 and error.row == 3
    bench = grasp_files.dexgraspbench(g)
    bench["obj_pose"][3:] = 0
    refused(grasp_files.npy(tmp_path / "a.npy", bench), "'obj_pose'")
    document = grasp_files.isaac_document(g)
    document["grasps"]["grasp_1"]["orientation"]["w"] = 5.0
    (tmp_path / "a.yaml").write_text(yaml.safe_dump(document))
    rows, error = refused(tmp_path / "a.yaml", "unit quaternion")
    assert sum(one.n for one in rows) == 1 and error.row == 1
    mirrored = grasp_files.some_grasps()
    mirrored.poses[2, :3, 0] *= -1
    rows, error = refused(grasp_files.graspgen(tmp_path / "a.json", mirrored), "right-handed")
    assert sum(one.n for one in rows) == 2 and error.row == 2


@pytest.mark.parametrize(
    ("made", "key"),
    [
        (lambda g: grasp_files.bodex(g, [f"joint_{i}.0" for i in range(16)]), "world_cfg"),
        (lambda g: grasp_files.bodex(g, [f"joint_{i}.0" for i in range(16)]), "joint_names"),
        (grasp_files.dexgraspbench, "squeeze_qpos"),
        (grasp_files.dexgraspbench, "obj_path"),
        (grasp_files.dexonomy, "obj_pose"),
        (grasp_files.get_a_grip, "rot"),
    ],
)
def test_a_missing_key_is_named(made, key, tmp_path):
    document = made(grasp_files.some_grasps())
    del document[key]
    refused(grasp_files.npy(tmp_path / "mug_0_0500.npy", document), key)


def test_names_and_shapes_that_do_not_fit(tmp_path):
    g = grasp_files.some_grasps()
    joints = [f"joint_{i}.0" for i in range(16)]
    refused(grasp_files.npy(tmp_path / "a.npy", grasp_files.bodex(g, joints[:9])), "for the 9 joints named")
    document = grasp_files.bodex(g, joints)
    document["manip_name"] = ["other"]
    refused(grasp_files.npy(tmp_path / "a.npy", document), "'world_cfg/mesh/other'")
    refused(grasp_files.npy(tmp_path / "plain.npy", grasp_files.get_a_grip(g)), "CODE_0_0622.npy")
    refused(grasp_files.npy(tmp_path / "a.npy", {"a": 1, "b": 2}), "a dict with the keys a, b")
    refused(grasp_files.npy(tmp_path / "a.npy", np.zeros(3)), "numbers")


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89PNG\r\n\x1a\n\0\0", "something unknown"),
        (b"\x80\x02\x8a\nl\xfc\x9cF\xf9 j\xa8P\x19.", "before 1.6"),
        (b"PK\x03\x04 no archive", "broken or cut off"),
        (b"\x89HDF\r\n\x1a\n no HDF5", "broken or cut off"),
        (b'{"object": {"file": "a", "scale": 1}, "grasps": {"transforms": [', "broken or cut off"),
        (b'{"object": 1, "object": 2}', "each key once"),
        (b'{"object": {"file": "a", "scale": NaN}}', "finite"),
        (b"[" * 100_000, "broken|expected"),
        (b'{"a":' * 100_000, "broken"),
        (b"just a text", "expected a mapping"),
        (b"format: isaac_grasp\nformat_version: 2.0\ngrasps: {}\n", "format_version: 1.0"),
        (b"format: isaac_grasp\ngrasps: &a [*a]\n", "aliases"),
        (b"format: !!python/object/apply:os.system ['true']\n", "tags"),
        (b"a: [" * 5000, "within each other|broken"),
        (b"\x93NUMPY\x09\x00", "version 1"),
        (b"\x93NUMPY\x01\x00\x10\x00" + b"__import__('os')", "broken"),
    ],
)
def test_other_files_are_told(content, message, tmp_path):
    refused(write(tmp_path, content, "file"), message)


def test_a_format_that_is_given_is_held_to(tmp_path):
    g = grasp_files.some_grasps(d=22)
    path = grasp_files.npy(tmp_path / "mug_0_0500.npy", grasp_files.dexgraspnet_rows(g))
    for kind, message in {"acronym": "HDF5", "isaac": "text", "graspqp": "ZIP", "bodex": "mapping"}.items():
        refused(path, message, format=kind)


def test_yaml_and_json_give_the_rows_before_a_fault(tmp_path):
    g = grasp_files.some_grasps()
    text = grasp_files.isaac(tmp_path / "a.yaml", g).read_text()
    at = text.index("grasp_3")
    for cut in (text[: at + 40], text[:at] + "grasp_3: {confidence: [\n", text[:at] + "grasp_3: {confidence: high}\n"):
        (tmp_path / "a.yaml").write_text(cut)
        rows, _ = refused(tmp_path / "a.yaml", "broken|expected")
        assert sum(one.n for one in rows) == 3
        np.testing.assert_allclose(rows[0].poses, g.poses[:3], atol=1e-12)
    document = json.loads(grasp_files.graspgen(tmp_path / "a.json", g).read_text())
    document["grasps"]["transforms"][4] = [[1, 2], [3]]
    (tmp_path / "a.json").write_text(json.dumps(document))
    rows, error = refused(tmp_path / "a.json", "4 x 4")
    assert sum(one.n for one in rows) == 4 and error.row == 4


def test_a_crash_of_the_hdf5_library_is_told(tmp_path, monkeypatch):
    path = grasp_files.acronym(tmp_path / "a.h5", grasp_files.some_grasps())
    (tmp_path / "h5py.py").write_text("import os, signal\nos.kill(os.getpid(), signal.SIGSEGV)\n")
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=os.pathsep)
    refused(path, "its reader stopped .exit code -11")


def test_hdf5_links_are_not_followed(tmp_path, canary):
    import h5py

    g = grasp_files.some_grasps()
    grasp_files.acronym(tmp_path / "secret.h5", g)
    path = grasp_files.acronym(tmp_path / "a.h5", g)
    with h5py.File(path, "a") as h5:
        del h5["grasps/transforms"]
        h5["grasps/transforms"] = h5py.ExternalLink(str(tmp_path / "secret.h5"), "grasps/transforms")
    refused(path, "link to elsewhere")
    with h5py.File(path, "a") as h5:
        del h5["grasps/transforms"]
        h5.create_dataset("grasps/transforms", shape=(10**9, 4, 4), dtype="f8", chunks=(64, 4, 4), fillvalue=1.0)
    refused(path, "so few bytes")
    with h5py.File(path, "a") as h5:
        del h5["grasps/transforms"]
        h5.create_dataset("grasps/transforms", (5, 4, 4), "f8", external=[(str(tmp_path / "secret.h5"), 0, 640)])
    refused(path, "another file")


def empty_array(shape):
    """Opcodes of an array of that shape without any bytes."""
    sizes = b"".join(b"\x8a\x08" + size.to_bytes(8, "little") for size in shape)
    kind = b"cnumpy\ndtype\nX\x02\x00\x00\x00f8\x89\x88\x87R"
    made = b"cnumpy.core.multiarray\n_reconstruct\ncnumpy\nndarray\nK\x00\x85C\x01b\x87R"
    return made + b"(K\x01(" + sizes + b"t" + kind + b"\x89C\x00tb"


@pytest.mark.parametrize("shape", [(2**38, 0), (0, 2**36), (1, 2**37, 0), (2**20, 2**19, 0)])
def test_an_array_without_numbers_has_no_rows_either(shape, tmp_path):
    body = b"}X\x05\x00\x00\x00trans" + empty_array(shape) + b"s."
    refused(write(tmp_path, NPY + body), "bytes of arrays")


@pytest.mark.parametrize("key", [0, 1, 5, -7])
def test_keys_of_one_hash_do_not_take_for_ever(key, tmp_path):
    """Integers that differ by 2**61 - 1 have the same hash; a dict of so many takes minutes."""
    keys = (pickle.encode_long((2**61 - 1) * (i + 2) + key) for i in range(30_000))
    body = b"}(" + b"".join(b"\x8a" + bytes([len(one)]) + one + b"N" for one in keys) + b"u."
    begun = time.process_time()
    refused(write(tmp_path, NPY + body), "as a key")
    assert time.process_time() - begun < 2


@pytest.mark.slow
def test_rows_that_are_one_row_again_and_again_are_not_read(tmp_path):
    row = grasp_files.dexgraspnet_rows(grasp_files.some_grasps(n=1, d=22))[0]
    many = b"](" + pickle.dumps(row, protocol=2)[2:-1] + b"r\xff\x00\x00\x00"
    refused(write(tmp_path, NPY + many + b"j\xff\x00\x00\x00" * 200_000 + b"e."), "at most .* values")


@pytest.mark.parametrize("name", ["\x1b[2J", "a\nb", "\u202eabc", "x" * 5000])
def test_names_of_a_file_neither_steer_nor_fill_the_screen(name, tmp_path):
    g = grasp_files.some_grasps()
    document = grasp_files.bodex(g, [f"joint_{i}.0" for i in range(16)])
    for key, value in (("manip_name", [name]), ("joint_names", [name, *document["joint_names"][1:]]), (name, 1)):
        changed = {key: value} if key == name else {**document, key: value}
        _, error = refused(grasp_files.npy(tmp_path / "a.npy", changed), "expected")
        assert str(error).isprintable() and len(str(error)) < 1200


def test_numbers_that_are_not_in_an_hdf5_file_are_refused(tmp_path):
    import h5py

    path = grasp_files.acronym(tmp_path / "a.h5", grasp_files.some_grasps())
    with h5py.File(path, "a") as h5:
        del h5["grasps/transforms"]
        h5.create_dataset("grasps/transforms", shape=(20_000, 4, 4), dtype="f8", chunks=(64, 4, 4), fillvalue=1.0)
        h5["padding"] = np.random.default_rng(0).random(200_000)
    refused(path, "so few bytes")


def test_a_pipe_is_no_file_of_grasps(tmp_path):
    os.mkfifo(tmp_path / "a.json")
    refused(tmp_path / "a.json", "expected a file, got a pipe")
