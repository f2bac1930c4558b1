"""What benchmarks of others ask of a grasp, so that numbers can be compared with theirs."""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from pinograsp.checks import brief, one_of
from pinograsp.forces import GraspConditions, TorqueLimit
from pinograsp.hands import Drive, HandModel
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Protocol:
    """The test of a benchmark or of a data set's makers.

    Attributes:
        name: of the benchmark.
        mass: of each object [kg]; None: from its density.
        density: of each object [kg/m^3]; None: from its mass.
        mu: friction coefficient [-].
        torsion: largest moment about a normal per newton [m].
        pulls: accelerations of the object, in the axes of the file's world (l, 3) [m/s^2], one after the other.
        distance: how far the object may go [m].
        angle: how far it may turn [rad].
        stiffness: of a contact in the benchmark's engine [N/m].
        tolerance: distance from the surface up to which a link touches [m], according to the accuracy of its files.
        source: where these figures are published.
        servo: gain of a servo without limit at each joint [N m/rad or N/m], if the benchmark uses one instead of the
            hand's drives; None: it uses the drives.
        lenient: whether links of the hand may overlap and joints exceed their limits, as in the benchmark.
    """

    name: str
    mass: float | None = None
    density: float | None = None
    mu: float
    torsion: float
    pulls: Array
    distance: float
    angle: float
    stiffness: float
    tolerance: float
    source: str
    servo: float | None = None
    lenient: bool = False

    __repr__ = brief("name", "mass", "density", "mu")

    def loads_on(self, mass: float) -> Array:
        """Return the pulls at an object of this mass [kg] as wrenches about its centre of mass (l, 6) [N, N m]."""
        return np.pad(mass * self.pulls, ((0, 0), (0, 3)))

    def hand(self, hand: HandModel) -> HandModel:
        """Return a hand with the benchmark's servos."""
        if self.servo is None:
            return hand
        return hand.with_drives(
            Drive(name=joint, joints=(joint,), arms=(1.0,), control="position", stiffness=self.servo)
            for joint in hand.joint_names
        )

    def conditions(self) -> GraspConditions:
        """Return friction and limits as in the benchmark; without gravity, the pulls are the only loads."""
        limit: TorqueLimit = "effort" if self.servo is None else None
        return GraspConditions(mu=self.mu, gravity_o=np.zeros(3), reserve=None, torque_limit=limit)


def _six(acceleration: float) -> Array:
    """Accelerations along both ways of each axis (6, 3) [m/s^2]."""
    axes = np.eye(3)
    return np.asarray(acceleration * np.stack([-axes, axes], axis=1).reshape(6, 3), dtype=float)


_SLIPS = 0.01  # [m] torsion of pads of some square centimetres
# Contacts of PhysX and FleX are all but rigid: what gives way there are the servos, and jaws have none.
_HARD, _RIGID = 2e4, 2e5  # [N/m]


def _of_jaws(name: str, source: str, mass: float | None = None, density: float | None = None) -> Protocol:
    """Friction 1, and the weight along each axis; what falls out of the jaws is lost."""
    return Protocol(
        name=name,
        mass=mass,
        density=density,
        mu=1.0,
        torsion=_SLIPS,
        pulls=_six(9.81),
        distance=0.1,
        angle=float(np.pi),
        stiffness=_RIGID,
        tolerance=2e-3,
        source=source,
    )


PROTOCOLS = MappingProxyType(
    {
        one.name: one
        for one in (
            Protocol(
                name="dexgraspbench",
                mass=0.1,
                mu=0.6,
                torsion=0.02,
                pulls=_six(10.0),
                distance=0.05,
                angle=float(np.radians(15)),
                # MuJoCo's contacts give way by (1 - d) / d A tc^2 per newton, A being 1 / m of link and object: solref
                # 0.005 and solimp 0.5 0.99 of the hand, mixed with 0.02 and 0.9 0.95 of the object.
                stiffness=3e3,
                tolerance=5e-3,
                source="JYChen18/DexGraspBench, config/task/eval.yaml and src/task/eval_func/fc_mocap.py",
            ),
            Protocol(
                name="dexgraspnet",
                density=500.0,
                mu=3.0,
                torsion=_SLIPS,
                pulls=_six(9.8),
                # Held is what still touches the hand after 1.7 s; what has gone so far does not.
                distance=0.1,
                angle=float(np.pi),
                stiffness=_HARD,
                tolerance=5e-3,
                servo=1000.0,
                lenient=True,
                source="PKU-EPIC/DexGraspNet, grasp_generation/utils/isaac_validator.py; thres_dis of main.py",
            ),
            # Its shaking along the approach and about the jaws' axis has no published acceleration: a weight each.
            _of_jaws(name="acronym", density=150.0, source="NVlabs/acronym: density and friction of its files"),
            # Its own five pulls of one weight, along the approach and askew, lie among these.
            _of_jaws(
                name="graspgen",
                mass=1.0,
                source="NVlabs/GraspDataGen, scripts/graspgen/grasp_sim.py and object.py",
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
