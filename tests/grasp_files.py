"""Files of grasps in the layouts of public data sets, written with plain NumPy, h5py, json, yaml and pickle."""

from __future__ import annotations

import io
import json
import pickle
import sys
import types
import zipfile
from collections import OrderedDict
from dataclasses import dataclass

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

SHADOW = [
    *(f"robot0:{finger}J{i}" for finger in ("FF", "MF", "RF") for i in (3, 2, 1, 0)),
    *(f"robot0:{finger}J{i}" for finger in ("LF", "TH") for i in (4, 3, 2, 1, 0)),
]


@dataclass
class Grasps:
    """Grasps as they are meant: bMh (N, 4, 4), q (N, d) and what else files may have."""

    poses: np.ndarray
    q: np.ndarray
    before: np.ndarray
    after: np.ndarray
    scale: np.ndarray
    object_pose: np.ndarray
    forces: np.ndarray


def some_grasps(n=5, d=16, seed=3) -> Grasps:
    rng = np.random.default_rng(seed)

    def poses(count):
        out = np.tile(np.eye(4), (count, 1, 1))
        out[:, :3, :3] = Rotation.random(count, random_state=rng).as_matrix()
        out[:, :3, 3] = rng.uniform(-0.2, 0.2, (count, 3))
        return out

    q, before, after = rng.uniform(-0.3, 1.2, (3, n, d))
    return Grasps(poses(n), q, before, after, rng.uniform(0.05, 0.2, n), poses(1)[0], rng.uniform(-2, 2, (n, 4, 3)))


def wxyz(poses):
    q = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat()[:, [3, 0, 1, 2]]
    return np.concatenate([poses[..., :3, 3], q.reshape(*poses.shape[:-2], 4)], axis=-1)


def npy(path, value):
    np.save(path, value, allow_pickle=True)
    return path


def dexgraspnet_rows(g: Grasps):
    rows = []
    for i in range(len(g.poses)):
        turn = Rotation.from_matrix(g.poses[i, :3, :3])
        about_z, about_y, about_x = turn.as_euler("ZYX")  # about moving axes, in the other order: the same turn
        qpos = dict(zip(SHADOW, g.q[i].tolist()))
        qpos.update(WRJRx=about_x, WRJRy=about_y, WRJRz=about_z)
        qpos.update(zip(("WRJTx", "WRJTy", "WRJTz"), g.poses[i, :3, 3].tolist()))
        rows.append({"scale": g.scale[i], "qpos": qpos, "energy": float(i), "E_fc": 0.5 * i})
    return rows


def bodex(g: Grasps, joints):
    world = g.object_pose @ g.poses
    steps = np.stack([np.concatenate([wxyz(world), q], axis=1) for q in (g.before, g.q, g.after)], axis=1)
    pose = wxyz(g.object_pose)
    n = len(g.poses)
    mesh = {"scale": np.full(3, 0.08), "pose": pose, "file_path": "mug/mesh.obj", "urdf_path": "mug/mug.urdf"}
    return {
        "robot_pose": steps[None].astype(np.float64),
        "world_cfg": [{"mesh": {"scene_mug": mesh}, "cuboid": {"table": {"dims": [5.0, 5.0, 0.2]}}}],
        "manip_name": ["scene_mug"],
        "scene_path": ["scenes/mug.npy"],
        "contact_point": g.forces[None] / 100,
        "contact_force": g.forces[None, :, None],
        "grasp_error": np.arange(n, dtype=np.float32)[None],
        "joint_names": list(joints),
    }


def dexgraspbench(g: Grasps):
    world = wxyz(g.object_pose @ g.poses[0])
    return {
        "obj_pose": wxyz(g.object_pose),
        "obj_scale": np.float64(0.1),
        "obj_path": "assets/mug",
        "pregrasp_qpos": np.concatenate([world, g.before[0]]),
        "grasp_qpos": np.concatenate([world, g.q[0]]),
        "squeeze_qpos": np.concatenate([world, g.after[0]]),
    }


def dexonomy(g: Grasps, hand="allegro"):
    bench = dexgraspbench(g)
    return {
        "hand_name": hand,
        "tmpl_name": "fingertip_mid",
        "hand_cbody": ["ff_tip", "th_tip"],
        "pregrasp_qpos": np.stack([bench["pregrasp_qpos"], bench["grasp_qpos"]]),
        "grasp_qpos": bench["grasp_qpos"][None],
        "squeeze_qpos": bench["squeeze_qpos"][None],
        "obj_cpn_w": np.arange(12.0).reshape(2, 6),
        "ho_c": {"pos": np.ones((2, 3)), "bn1": ["ff_tip", "th_tip"], "wrench": np.zeros((2, 6))},
        "n_evo": np.array([2], dtype=np.float32),
        "scene_path": "scenes/mug.npy",
        "obj_pose": bench["obj_pose"],
        "obj_scale": np.full(3, 0.1),
    }


def get_a_grip(g: Grasps):
    n = len(g.poses)
    return {
        "trans": g.poses[:, :3, 3].astype(np.float32),
        "rot": g.poses[:, :3, :3].astype(np.float32),
        "joint_angles": g.q,
        "grasp_orientations": np.tile(np.eye(3), (n, 4, 1, 1)),
        "y_pick": np.linspace(0, 1, n),
        "y_PGS": np.zeros(n),
    }


def acronym(path, g: Grasps):
    import h5py

    with h5py.File(path, "w") as h5:
        h5["object/file"] = "meshes/Mug/1.obj"
        h5["object/scale"] = 0.02
        h5["object/mass"] = 0.3
        h5["object/com"] = [0.0, 0.01, 0.02]
        h5["gripper/type"] = "panda"
        h5["gripper/configuration"] = [0.04]
        h5["grasps/transforms"] = g.poses
        h5["grasps/qualities/flex/object_in_gripper"] = np.arange(len(g.poses)) % 2
    return path


def graspgen(path, g: Grasps):
    good = [bool(i % 2) for i in range(len(g.poses))]
    document = {
        "object": {"file": "mug.obj", "scale": 0.5},
        "grasps": {"transforms": g.poses.tolist(), "object_in_gripper": good},
    }
    path.write_text(json.dumps(document), encoding="utf-8")
    return path


def isaac_document(g: Grasps):
    values = wxyz(g.poses)
    return {
        "format": "isaac_grasp",
        "format_version": 1.0,
        "object_frame": "/World/mug",
        "gripper_frame": "/World/panda_hand",
        "grasps": {
            f"grasp_{i}": {
                "confidence": 0.9,
                "position": values[i, :3].tolist(),
                "orientation": {"w": float(values[i, 3]), "xyz": values[i, 4:].tolist()},
                "cspace_position": {"panda_finger_joint1": 0.01 * i},
                "pregrasp_cspace_position": {"panda_finger_joint1": 0.04},
            }
            for i in range(len(g.poses))
        },
    }


def isaac(path, g: Grasps):
    path.write_text(yaml.safe_dump(isaac_document(g), sort_keys=False), encoding="utf-8")
    return path


def graspnet(path, points=2, seed=1):
    rng = np.random.default_rng(seed)
    grid = (points, 300, 12, 4)
    angle, depth, width = (
        rng.uniform(0, np.pi, grid),
        rng.choice([0.01, 0.02, 0.03, 0.04], grid),
        rng.uniform(0, 0.1, grid),
    )
    arrays = {
        "points": rng.uniform(-0.1, 0.1, (points, 3)).astype(np.float32),
        "offsets": np.stack([angle, depth, width], axis=-1).astype(np.float32),
        "scores": np.where(rng.uniform(size=grid) < 0.01, rng.choice([0.1, 0.4, 1.0], grid), -1.0).astype(np.float32),
        "collision": rng.uniform(size=grid) < 0.3,
    }
    np.savez_compressed(path, **arrays)
    return arrays


# -- PyTorch's files, as torch.save writes them, with stand-ins for its modules while they are pickled


class _Storage:
    def __init__(self, kind, key, count):
        self.id = ("storage", kind, key, "cpu", count)


class _Pickler(pickle.Pickler):
    def persistent_id(self, value):
        return value.id if isinstance(value, _Storage) else None


class _Tensor:
    def __init__(self, rebuild, storage, shape, strides):
        self.parts = rebuild, (storage, 0, shape, strides, False, OrderedDict())

    def __reduce__(self):
        return self.parts


def torch_bytes(value, storages=("FloatStorage", "DoubleStorage", "LongStorage")) -> bytes:
    """A file with dicts, texts, numbers and arrays (as tensors)."""
    torch, utils = types.ModuleType("torch"), types.ModuleType("torch._utils")
    setattr(torch, "_utils", utils)  # noqa: B010 - its name is what is pickled
    for name in storages:
        setattr(torch, name, type(name, (), {"__module__": "torch"}))

    def rebuild():
        raise AssertionError

    name = "_rebuild_tensor_v2"
    rebuild.__module__, rebuild.__qualname__, rebuild.__name__ = "torch._utils", name, name
    setattr(utils, name, rebuild)
    arrays = []

    def made(one):
        if isinstance(one, dict):
            return {key: made(inner) for key, inner in one.items()}
        if isinstance(one, np.ndarray):
            kind = {"float32": "FloatStorage", "float64": "DoubleStorage", "int64": "LongStorage"}[str(one.dtype)]
            arrays.append(np.ascontiguousarray(one))
            strides = tuple(step // one.itemsize for step in arrays[-1].strides)
            return _Tensor(rebuild, _Storage(getattr(torch, kind), str(len(arrays) - 1), one.size), one.shape, strides)
        return one

    kept = {name: sys.modules.get(name) for name in ("torch", "torch._utils")}
    sys.modules.update({"torch": torch, "torch._utils": utils})
    try:
        stream = io.BytesIO()
        _Pickler(stream, protocol=2).dump(made(value))
    finally:
        for name, module in kept.items():
            if module is None:
                del sys.modules[name]
            else:
                sys.modules[name] = module
    out = io.BytesIO()
    with zipfile.ZipFile(out, "w", zipfile.ZIP_STORED) as archive:
        archive.writestr("mug/data.pkl", stream.getvalue())
        archive.writestr("mug/byteorder", "little")
        for key, array in enumerate(arrays):
            archive.writestr(f"mug/data/{key}", array.tobytes())
        archive.writestr("mug/version", "3\n")
    return out.getvalue()


def graspqp(g: Grasps, joints):
    return {
        "values": np.arange(len(g.poses), dtype=np.float32),
        "parameters": {**dict(zip(joints, np.ascontiguousarray(g.q.T))), "root_pose": wxyz(g.poses)},
        "grasp_velocities": dict(zip(joints, np.ascontiguousarray(g.after.T))),
        "grasp_type": "all",
        "contact_links": None,
    }
