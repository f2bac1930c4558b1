"""What benchmarks of others ask of a grasp, so that numbers can be compared with theirs."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pinograsp.checks import brief, one_of
from pinograsp.forces import GraspConditions
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Protocol:
    """The test of a benchmark.

    Attributes:
        name: of the benchmark.
        mass: of each object [kg].
        mu: friction coefficient [-].
        torsion: largest moment about a normal per newton [m].
        pushes: forces at the centre of mass, in the axes of the file's world (l, 3) [N], one after the other.
        distance: how far the object may go [m].
        angle: how far it may turn [rad].
        stiffness: of a contact in the benchmark's engine [N/m].
        tolerance: distance from the surface up to which a link touches [m], as good as its files are.
        source: where this is from.
    """

    name: str
    mass: float
    mu: float
    torsion: float
    pushes: Array
    distance: float
    angle: float
    stiffness: float
    tolerance: float
    source: str

    __repr__ = brief("name", "mass", "mu")

    @property
    def loads(self) -> Array:
        """The pushes as wrenches about the centre of mass (l, 6) [N, N m]."""
        return np.pad(self.pushes, ((0, 0), (0, 3)))

    def conditions(self) -> GraspConditions:
        """Friction and limits as in the benchmark; without gravity, the pushes are all there is."""
        return GraspConditions(mu=self.mu, gravity_o=np.zeros(3), reserve=None)


def _six(force: float) -> Array:
    """Forces along both ways of each axis (6, 3) [N]."""
    axes = np.eye(3)
    return np.asarray(force * np.stack([-axes, axes], axis=1).reshape(6, 3), dtype=float)


PROTOCOLS = MappingProxyType(
    {
        one.name: one
        for one in (
            Protocol(
                name="dexgraspbench",
                mass=0.1,
                mu=0.6,
                torsion=0.02,
                pushes=_six(1.0),
                distance=0.05,
                angle=float(np.radians(15)),
                # MuJoCo's contacts give way by (1 - d) / d A tc^2 per newton, A being 1 / m of link and object: solref
                # 0.005 and solimp 0.5 0.99 of the hand, mixed with 0.02 and 0.9 0.95 of the object.
                stiffness=3e3,
                tolerance=5e-3,
                source="JYChen18/DexGraspBench, config/task/eval.yaml and src/task/eval_func/fc_mocap.py",
            ),
        )
    }
)


def find_protocol(given: Protocol | str | None) -> Protocol | None:
    """A protocol, by its name where that is given.

    Raises:
        InvalidInput: a name that there is not.
    """
    if given is None or isinstance(given, Protocol):
        return given
    return PROTOCOLS[one_of("protocol", given, tuple(PROTOCOLS))]
