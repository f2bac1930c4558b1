"""A grasp plan with its ways out: to controllers, pictures and files; and back from files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.actuation import FACTORS, ForceBand, GainLimit, ObjectStiffness
from pinograsp.checks import instance_of
from pinograsp.contacts import Closure
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem, ForceSolution, Reaction
from pinograsp.handover import JointTrajectory, Sampling, joint_trajectory
from pinograsp.hands import HandModel
from pinograsp.plan import PlanFailure, PlanRecord, Simulation
from pinograsp.planner.compliance import band_of, gains_of, servo_gains, stiffness_of
from pinograsp.planner.margins import margin_cautions, margins_of, reach_of
from pinograsp.spatial import Array
from pinograsp.storage import read_run, write_run
from pinograsp.writing import NewFolder

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pinograsp.viz.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspPlan(PlanRecord):
    """A grasp: contact forces, and the joint motion and torques that bring them about.

    All of :class:`~pinograsp.plan.PlanRecord`, the same whether the plan was just made or read back.

    Attributes:
        hand: the hand, as it was placed.
        solution: the force search's own record, with its problem, for more computing; None where the plan was read
            back.
        closure: how the contacts were found; None where they were given, or the plan was read back.
    """

    hand: HandModel
    solution: ForceSolution | None = None
    closure: Closure | None = None

    __repr__ = PlanRecord.__repr__

    @property
    def problem(self) -> ForceProblem:
        """The force problem that was solved; :class:`InvalidInput` where the plan was read back."""
        return self.searched().problem

    def searched(self) -> ForceSolution:
        """The force search's own record; :class:`InvalidInput` where the plan was read back."""
        if self.solution is None:
            raise InvalidInput("expected a plan that was just made, got one that was read back: plan it again")
        return self.solution

    def _reaction(self) -> Reaction:
        """To what is added to the load: as the squeeze was planned."""
        return "friction" if self.reserve is None else "elastic"

    def with_margins(self) -> GraspPlan:
        """The same plan with what the grasp bears besides its load, and cautions of that; a tenth of a second."""
        if self.margins is not None:
            return self
        margins = margins_of(self.searched(), self._reaction())
        weight = self.body_mass * float(np.linalg.norm(self.gravity_o))
        return replace(self, margins=margins, cautions=(*self.cautions, *margin_cautions(margins, weight)))

    def with_reach(self) -> GraspPlan:
        """The same plan with the forces that may come on top of the load, by direction; a second or two."""
        return self if self.reach is not None else replace(self, reach=reach_of(self.searched(), self._reaction()))

    def force_band(self, stiffness: ArrayLike | None = None, factors: ArrayLike = FACTORS) -> ForceBand:
        """The forces that come where the contacts are ``factors`` times as stiff as planned (s,), 1/5 to 20 times.

        Servos of ``stiffness``, one number or (n,) [N m/rad or N/m], hold the references that give the planned forces
        on contacts as planned; 0 is torque control, the default 50 N m/rad (55.6 kN/m at sliding joints). See
        :func:`pinograsp.actuation.force_band`.

        Raises:
            InvalidInput: unusable numbers, or a plan that was read back.
        """
        return band_of(self.hand, self.searched(), self.motion.q[-1], servo_gains(self.hand, stiffness), factors)

    def gains_within(self, tolerance: float = 0.2, factors: ArrayLike = FACTORS) -> GainLimit:
        """The stiffest servos with which no normal force is off by more than ``tolerance`` (a share) on such contacts.

        See :func:`pinograsp.actuation.gains_within`; servos at sliding joints stay 1 / (30 mm)^2 times as stiff as
        those of turning ones. Raises as :meth:`force_band`.
        """
        return gains_of(self.hand, self.searched(), self.motion.q[-1], tolerance, factors)

    def object_stiffness(self, stiffness: ArrayLike | None = None) -> ObjectStiffness:
        """Stiffness of the held object with servos as for :meth:`force_band`: unstable where ``margin`` is below 0.

        See :func:`pinograsp.actuation.object_stiffness`; raises as :meth:`force_band`.
        """
        return stiffness_of(self.hand, self.searched(), self.motion.q[-1], servo_gains(self.hand, stiffness))

    def summary(self) -> dict[str, Any]:
        """The plan's figures as plain JSON values, units in the names, margins included."""
        return PlanRecord.summary(self.with_margins())

    def to_csv(self, path: str | Path, *, followers: bool = False, **sampling: Unpack[Sampling]) -> JointTrajectory:
        """Write the motion for a controller as a table; see :meth:`pinograsp.handover.JointTrajectory.to_csv`.

        ``sampling``: rate, start, lead, blend, as for :func:`pinograsp.handover.joint_trajectory`. Returns the
        trajectory, which says how far it is from the plan.
        """
        return joint_trajectory(self, **sampling).to_csv(path, followers=followers)

    def to_ros2(
        self,
        path: str | Path | None = None,
        *,
        followers: bool = False,
        effort: bool = True,
        goal: bool = False,
        frame: str = "",
        **sampling: Unpack[Sampling],
    ) -> dict[str, Any]:
        """The motion as ROS 2's ``trajectory_msgs/JointTrajectory``, written where a path (.yaml, .json) is given.

        See :meth:`pinograsp.handover.JointTrajectory.to_ros2`; ``sampling`` as for :meth:`to_csv`.
        """
        trajectory = joint_trajectory(self, **sampling)
        return trajectory.to_ros2(path, followers=followers, effort=effort, goal=goal, frame=frame)

    def to_mujoco(
        self,
        path: str | Path,
        *,
        model: Any = None,
        qpos: Array | None = None,
        feed_forward: bool = True,
        prefix: str = "",
        **sampling: Unpack[Sampling],
    ) -> JointTrajectory:
        """Write the motion as MuJoCo keyframes (.xml) and controls over time (.npz beside it); returns the trajectory.

        See :meth:`pinograsp.handover.JointTrajectory.to_mujoco`; ``sampling`` as for :meth:`to_csv`.
        """
        trajectory = joint_trajectory(self, **sampling)
        return trajectory.to_mujoco(path, model=model, qpos=qpos, feed_forward=feed_forward, prefix=prefix)

    def show(self, *, simulation: Simulation | None = None, port: int = 8080, open_browser: bool = True) -> Viewer:
        """Open a live page with hand, object, forces and friction over time; see :func:`pinograsp.viz.viewer.view`.

        Returns the viewer; its :meth:`~pinograsp.viz.viewer.Viewer.close` takes the page down. Needs the extra ``viz``.
        """
        from pinograsp.viz.viewer import view

        return view(self.with_margins(), simulation=simulation, port=port, open_browser=open_browser)

    def save_figures(self, folder: str | Path) -> list[Path]:
        """Write every figure as PNG; returns their paths. See :mod:`pinograsp.viz.figures` for one of them alone."""
        from pinograsp.viz.figures import save_figures

        return save_figures(self.with_reach(), folder)


def save_run(
    plan: GraspPlan | PlanFailure,
    folder: str | Path | NewFolder,
    *,
    force: bool = False,
    extras: Callable[[Path], None] | None = None,
) -> Path:
    """Write a plan with its margins, or the failure of one, into ``folder``, whole or not at all; returns it.

    ``extras(path)`` may add files (report, figures). ``force`` replaces an earlier run, with its checks.

    Raises:
        InvalidInput: not a plan, or one whose settings cannot be written down.
        ResultsNotWritten: the folder exists and ``force`` is off, it holds files that no run wrote, another process is
            writing it, or the place cannot be written.
    """
    instance_of("plan", plan, GraspPlan, PlanFailure)
    complete = plan.with_margins().with_reach() if isinstance(plan, GraspPlan) else plan
    return write_run(complete, folder, force=force, extras=extras)


def load_run(folder: str | Path) -> GraspPlan:
    """Read a plan back, with its hand and its object.

    Raises:
        InvalidInput: the folder holds no plan, one that is damaged, of another schema or without its hand, or the
            failure of a search (:func:`pinograsp.storage.read_run` reads those).
        HandNotLoaded: mesh files of the hand that are missing.
    """
    record = read_run(folder)
    if isinstance(record, PlanFailure):
        raise InvalidInput(
            f"'{folder}' holds no plan, its search found none ({record.status}): pinograsp report tells why"
        )
    values = {one.name: getattr(record, one.name) for one in fields(record)}
    return GraspPlan(**{**values, "hand": record.require_hand()})
