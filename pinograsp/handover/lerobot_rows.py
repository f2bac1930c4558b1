"""Plans and their simulations as episodes of a LeRobot data set, version 3.0: Parquet by pyarrow (extra ``logs``)."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any, Literal, TypeAlias, get_args

import numpy as np

from pinograsp.checks import instance_of, integer, one_of, text_of
from pinograsp.errors import ExtraMissing, InvalidInput
from pinograsp.plan import Motion, PlanRecord, Simulation
from pinograsp.spatial import Array
from pinograsp.writing import write_folder

Action: TypeAlias = Literal["position", "torque"]
_DATA, _EPISODES = "data/chunk-000/file-000.parquet", "meta/episodes/chunk-000/file-000.parquet"


def write_lerobot(
    episodes: Sequence[PlanRecord | tuple[PlanRecord, Simulation]],
    folder: str | Path,
    *,
    rate: int = 30,
    task: str = "grasp the object",
    action: Action = "position",
    force: bool = False,
) -> Path:
    """Write motions of one hand as a data set that LeRobotDataset 3.0 reads; returns its folder.

    Each frame has ``observation.state``, the joint positions [rad or m], ``action``, and LeRobot's ``timestamp`` [s],
    ``frame_index``, ``episode_index``, ``index`` and ``task_index``. There are no pictures.

    Args:
        episodes: plans, each an episode as planned, or (plan, simulation), as simulated.
        folder: a new or an empty one.
        rate: frames per second [1/s]; positions and torques are interpolated.
        task: of all episodes, in words.
        action: ``position``: the joint positions of the next frame; ``torque``: the torques of the joints' motors
            [N m or N], those that hold after the end of a plan included.
        force: replace a data set that was written here.

    Raises:
        InvalidInput: no episodes, those of hands with other joints, or motions of less than two frames.
        ExtraMissing: pyarrow is not installed.
        ResultsNotWritten: the folder exists, or cannot be written.
    """
    rate, task = integer("rate", rate, at_least=1, at_most=10_000), text_of("task", task)
    one_of("action", action, get_args(Action))
    try:
        import pyarrow as pa
        import pyarrow.parquet as parquet
    except ImportError as error:
        raise ExtraMissing("LeRobot's files are Parquet, which needs pyarrow: pip install 'pinograsp[logs]'") from error
    pairs = [one if isinstance(one, tuple) and len(one) == 2 else (one, None) for one in episodes]
    names = {instance_of("episode", plan, PlanRecord).layout.joints for plan, _ in pairs}
    if len(names) != 1:
        raise InvalidInput(f"episodes: expected plans of one hand's joints, got those of {len(names)} hands")
    joints = [*names.pop()]
    samples = [_sample(plan, simulation, rate, action) for plan, simulation in pairs]
    lengths = np.array([len(state) for state, _ in samples])
    frames, ends = np.concatenate([np.arange(n) for n in lengths]), np.cumsum(lengths)
    states, actions = (np.concatenate(part).astype(np.float32) for part in zip(*samples))
    rows: dict[str, Any] = {
        "observation.state": states,
        "action": actions,
        "timestamp": (frames / rate).astype(np.float32),
        "frame_index": frames,
        "episode_index": np.repeat(np.arange(len(pairs)), lengths),
        "index": np.arange(ends[-1]),
        "task_index": np.zeros(ends[-1], dtype=np.int64),
    }
    files = (f"{part}/{name}_index" for part in ("data", "meta/episodes") for name in ("chunk", "file"))
    listed = {
        "episode_index": np.arange(len(pairs)),
        "tasks": [[task]] * len(pairs),
        "length": lengths,
        "dataset_from_index": ends - lengths,
        "dataset_to_index": ends,
        **dict.fromkeys(files, np.zeros(len(pairs), dtype=np.int64)),
    }
    features = {
        name: {"dtype": str(one.dtype), "shape": [*one.shape[1:]] or [1], "names": joints if one.ndim > 1 else None}
        for name, one in rows.items()
    }
    info = {
        "codebase_version": "v3.0",
        "robot_type": pairs[0][0].layout.hand,
        "total_episodes": len(pairs),
        "total_frames": int(ends[-1]),
        "total_tasks": 1,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": rate,
        "splits": {"train": f"0:{len(pairs)}"},
        "data_path": "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet",
        "video_path": None,
        "features": features,
    }
    tables = {
        _DATA: pa.table({name: _column(pa, values) for name, values in rows.items()}),
        _EPISODES: pa.table(listed),
        "meta/tasks.parquet": _list_task(pa, task),
    }
    texts = {"info": info, "stats": {name: _describe(values) for name, values in rows.items()}}

    def fill(path: Path) -> None:
        for name, table in tables.items():
            (path / name).parent.mkdir(parents=True, exist_ok=True)
            parquet.write_table(table, path / name)
        for name, content in texts.items():
            (path / "meta" / f"{name}.json").write_text(json.dumps(content, indent=4), encoding="utf-8")

    return write_folder(folder, fill, force=force)


def _sample(plan: PlanRecord, simulation: Simulation | None, rate: int, action: Action) -> tuple[Array, Array]:
    """States and actions of an episode (s, n)."""
    instance_of("simulation", simulation, Simulation, type(None))
    moved: Motion | Simulation = plan.motion if simulation is None else simulation
    times, q = moved.times, moved.q
    torques = moved.torques if simulation else np.vstack([moved.torques[:-1], plan.motion.holding_torques])
    if q.shape[1] != len(plan.layout.joints):
        raise InvalidInput(f"simulation: expected {len(plan.layout.joints)} joints as its plan, got {q.shape[1]}")
    at = times[0] + np.arange(int((times[-1] - times[0]) * rate + 1e-6) + 1) / rate
    if len(at) < 2:
        raise InvalidInput(f"episode: expected two frames at {rate} per second, got {times[-1] - times[0]:g} s")
    states, efforts = (np.column_stack([np.interp(at, times, one) for one in part.T]) for part in (q, torques))
    return states, np.vstack([states[1:], q[-1:]]) if action == "position" else efforts


def _column(pa: Any, values: Any) -> Any:
    """LeRobot keeps vectors of one number as numbers."""
    if values.ndim == 1 or values.shape[1] == 1:
        return pa.array(values.ravel())
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), values.shape[1])


def _describe(values: Any) -> dict[str, list[float]]:
    """What LeRobot normalizes with."""
    wide = values.reshape(len(values), -1).astype(float)
    found = {"min": wide.min(axis=0), "max": wide.max(axis=0), "mean": wide.mean(axis=0), "std": wide.std(axis=0)}
    return {name: value.tolist() for name, value in found.items()} | {"count": [len(values)]}


def _list_task(pa: Any, task: str) -> Any:
    """Tasks are the index of a table of pandas, which its metadata says."""
    kinds = (("task_index", "int64", "int64"), ("task", "unicode", "object"))
    columns = [dict(name=n, field_name=n, pandas_type=p, numpy_type=k, metadata=None) for n, p, k in kinds]
    said = {"index_columns": ["task"], "column_indexes": [], "columns": columns}
    return pa.table({"task_index": [0], "task": [task]}).replace_schema_metadata({"pandas": json.dumps(said)})
