"""Thirty-six plans over friction and mass on all cores, then on a Dask cluster; both can be stopped and go on."""

import sys

from pinograsp.sweep import read_sweep, sweep
from pinograsp.viz.figures import sweep_map

SWEEP = {
    "case": "paper",
    "set": {"forces.search": "convex", "forces.balance": "wrench", "friction.model": "cone"},
    "over": {
        "friction.mu": {"from": 0.4, "to": 1.0, "steps": 6},
        "object.mass": {"from": 0.6, "to": 1.2, "steps": 6},
    },
}


def main() -> None:
    done = sweep(SWEEP, "friction_and_mass")
    print(f"{done.rows} plans in {done.elapsed:.1f} s: {done.counts}")
    table = read_sweep("friction_and_mass")
    columns = {name: table[name].to_pylist() for name in ("friction.mu", "object.mass", "work_J")}
    sweep_map(columns, "work_J", "friction.mu", "object.mass").savefig("friction_and_mass.png", dpi=130)

    if "--dask" in sys.argv:  # a cluster of this machine; give the address of yours instead
        from distributed import LocalCluster

        with LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster:
            again = sweep(SWEEP, "on_dask", executor="dask", scheduler=cluster.scheduler_address)
        print(f"on Dask: {again.rows} plans in {again.elapsed:.1f} s")


if __name__ == "__main__":  # workers import this file
    main()
