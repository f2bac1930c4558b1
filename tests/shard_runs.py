"""Shards of runs, in a module that other processes can import."""

import pytest

import pinograsp as pg
from pinograsp.sweep import DataSet, certified_store, certify_files, run, runner, sweep

CONDITIONS = pg.GraspConditions(mu=0.6)


def data_in(folder, files):
    return DataSet(
        files=files, hand=pg.load_hand("panda"), objects=folder / "meshes", mass=0.1, convention="panda_graspgen"
    )


def certify_into(out, data, shard=None, conditions=CONDITIONS):
    return certify_files(data, out, conditions, jobs=1, progress=False, shard=shard)


def certify_shard(folder, files, block, shards, begun, number):
    """In a process that may be killed: written after each block."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(certified_store, "_BLOCK", block)
        patch.setattr(runner, "_SAVED_EVERY", 0.0)
        data = data_in(folder, files)
        begun()
        certify_into(folder / "out", data, (number, shards))


def sweep_shard(out, spec, most, shards, begun, number):
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run, "_MOST_AT_ONCE", most)
        patch.setattr(runner, "_SAVED_EVERY", 0.0)
        begun()
        sweep(spec, out, jobs=1, progress=False, shard=(number, shards))
