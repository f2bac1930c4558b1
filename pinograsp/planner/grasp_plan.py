"""A grasp plan with its ways out: to controllers, pictures and files."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, get_args

import numpy as np
from numpy.typing import ArrayLike

from pinograsp import defaults
from pinograsp.actuation import FACTORS, ForceBand, GainLimit, ObjectStiffness
from pinograsp.checks import flag, instance_of, number, one_of, path_of
from pinograsp.contacts import Closure
from pinograsp.errors import InvalidInput
from pinograsp.forces import ForceProblem, ForceSolution, GraspConditions, Reaction
from pinograsp.handover import (
    Command,
    Commanding,
    JointTrajectory,
    Units,
    closing_commands,
    gripper_message,
    jaw_commands,
    write_closings,
    write_core,
    write_jaws,
    write_registers,
)
from pinograsp.handover.commands import COMMANDS, make_commands, write_drive_keyframes
from pinograsp.handover.trajectory import check_model_options
from pinograsp.hands import HandModel, servo_gains
from pinograsp.hands.efforts import SHORTFALL
from pinograsp.motion import LoopSettings, OnlineForces, torque_limits
from pinograsp.plan import PlanRecord, PoseError, Simulation
from pinograsp.plan.tolerance import SMALL, PoseTolerance
from pinograsp.planner.compliance import describe_band, find_band, find_gains, stiffness_of
from pinograsp.planner.margins import find_margins, find_reach, margin_cautions
from pinograsp.planner.tolerance import DROPS, find_drop, tell_drop, tell_tolerance
from pinograsp.reflex import GripController, GripSettings
from pinograsp.spatial import Array

if TYPE_CHECKING:
    from typing_extensions import Unpack

    from pinograsp.viz.viewer import Viewer


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspPlan(PlanRecord):
    """A grasp: contact forces, and the joint motion and torques that produce them.

    It has everything of :class:`~pinograsp.plan.PlanRecord` and the inputs; a plan read back is the same as a new one.

    Attributes:
        hand: the hand, as it was placed.
        solution: the force search's own record, with its problem, for further computation.
        closure: how the contacts were found; None if they were given.
        conditions: under which the object is held; None if a problem was given.

    Example:
        >>> import pinograsp as pg
        >>> plan = pg.load_case("paper").plan()
        >>> print(plan.status, plan.contacts.names, plan.forces.normal_forces.round(1), "N")
        ok ('thumb', 'index', 'middle') [11.7  6.3  5.2] N

    See Also:
        :func:`~pinograsp.planner.plan_best`, :func:`~pinograsp.planner.save_run`,
        :func:`~pinograsp.simulation.simulate`.
    """

    hand: HandModel
    solution: ForceSolution
    closure: Closure | None = None
    conditions: GraspConditions | None = None

    __repr__ = PlanRecord.__repr__

    @property
    def problem(self) -> ForceProblem:
        """The force problem that was solved."""
        return self.solution.problem

    def _reaction(self) -> Reaction:
        """To what is added to the load: as the squeeze was planned."""
        return "friction" if self.reserve is None else "elastic"

    def with_margins(self) -> GraspPlan:
        """Return the same plan with its margins, what the grasp withstands besides its load, and their warnings; takes
        0.1 s.
        """
        if self.margins is not None:
            return self
        band = describe_band(self.hand, self.solution, self.motion.q[-1])
        margins = find_margins(self.solution, self._reaction(), band)
        return replace(self, margins=margins, cautions=(*self.cautions, *margin_cautions(margins, self.weight)))

    def with_reach(self) -> GraspPlan:
        """Return the same plan with the forces that it withstands besides the load, by direction; takes a second or
        two.
        """
        return self if self.reach is not None else replace(self, reach=find_reach(self.solution, self._reaction()))

    def with_tolerance(self, error: PoseError | None = None) -> GraspPlan:
        """Return the same plan with its tolerance to a misplaced object, and a warning if that is less than 3 mm, or if
        the object drops before the squeeze holds it: see :func:`~pinograsp.planner.find_tolerance`. The plan does not
        change if it is not ``OK``, if the contacts were given, without the compiled core, or if the core does not know
        the geometry.
        """
        instance_of("error", error, PoseError, type(None))
        known = self.tolerance is not None and error is None
        return self if known else add_tolerance(self, tell_tolerance(self, self.closure, error))

    def force_band(self, stiffness: ArrayLike | None = None, factors: ArrayLike = FACTORS) -> ForceBand:
        """Compute the forces if the contacts are ``factors`` times as stiff as planned (s,), 1/5 to 20 times.

        Servos of ``stiffness``, one number or (n,) [N m/rad or N/m], hold the references that produce the planned
        forces if the contacts are as planned; 0 is torque control. The default is the servos with which the hand
        closes: jaws press with their effort, fingers softly enough to tolerate a misplaced object, others with their
        drives' stiffness (50 N m/rad, 55.6 kN/m at sliding joints, if it is not known). See
        :func:`pinograsp.actuation.force_band`.

        Raises:
            InvalidInput: the numbers cannot be used.
        """
        return find_band(self.hand, self.solution, self.motion.q[-1], stiffness, factors)

    def gains_within(self, tolerance: float = 0.2, factors: ArrayLike = FACTORS) -> GainLimit:
        """Find the stiffest servos with which no normal force differs by more than ``tolerance`` (a share) on such
        contacts.

        See :func:`pinograsp.actuation.gains_within`; servos at sliding joints stay 1 / (30 mm)^2 times as stiff as
        those of turning ones. Raises as :meth:`force_band`.
        """
        return find_gains(self.hand, self.solution, self.motion.q[-1], tolerance, factors)

    def object_stiffness(self, stiffness: ArrayLike | None = None) -> ObjectStiffness:
        """Compute the stiffness of the held object with servos as for :meth:`force_band`: unstable if ``margin`` is
        below 0.

        See :func:`pinograsp.actuation.object_stiffness`; raises as :meth:`force_band`.
        """
        return stiffness_of(self.hand, self.solution, self.motion.q[-1], servo_gains(self.hand, stiffness))

    def summary(self) -> dict[str, Any]:
        """Return the plan's figures as plain JSON values, units in the names, margins included."""
        return PlanRecord.summary(self.with_margins())

    def to_csv(
        self,
        path: str | Path,
        *,
        command: Command | None = None,
        followers: bool = False,
        units: Units = "SI",
        **commanding: Unpack[Commanding],
    ) -> JointTrajectory:
        """Write the motion for a controller as a table; see :meth:`pinograsp.handover.JointTrajectory.to_csv`.

        Args:
            path: an existing file is replaced.
            command: None: joints with their torques. ``torque``, ``position``, ``impedance``: commands of the drives,
                see :func:`pinograsp.handover.drive_commands`. ``jaw``: a line per joint of a gripper with its target,
                effort, width and forces, see :func:`pinograsp.handover.write_jaws`.
            followers: add coupled joints; this has no effect on drives.
            units: ``register``: with a command, whole numbers of the drives' registers, see
                :func:`pinograsp.handover.write_registers`; with ``jaw`` closing speeds and force limits, see
                :func:`pinograsp.handover.closing_commands`.
            commanding: rate, start, lead, blend; for drives also stiffness, damping, shortfall.

        Returns:
            The trajectory, which includes its deviation from the plan; with a command its columns are the drives,
            for ``jaw`` their coordinates and efforts.

        Raises:
            InvalidInput: as :func:`pinograsp.handover.drive_commands`. ResultsNotWritten.
        """
        if one_of("units", units, get_args(Units)) == "register" and command is None:
            raise InvalidInput("units='register': expected with a command, as joints have no registers, got none")
        trajectory = make_commands(self, command, **commanding)
        if units == "register" and command == "jaw":
            write_closings(closing_commands(self), path)
            return trajectory
        if units == "register":
            notes = write_registers(self, trajectory, path, efforts=command != "position")
            return replace(trajectory, notes=(*trajectory.notes, *notes))
        if command == "jaw":
            write_jaws(jaw_commands(self, shortfall=commanding.get("shortfall", SHORTFALL)), path)
            return trajectory
        return trajectory.to_csv(path, followers=followers)

    def to_ros2(
        self,
        path: str | Path | None = None,
        *,
        command: Command | None = None,
        followers: bool = False,
        effort: bool = True,
        goal: bool = False,
        frame: str = "",
        **commanding: Unpack[Commanding],
    ) -> dict[str, Any]:
        """Return the motion as ROS 2's ``trajectory_msgs/JointTrajectory``, and write it if you give a path (.yaml,
        .json).

        With ``command="jaw"`` the goal of a ``control_msgs/action/ParallelGripperCommand``, see
        :func:`pinograsp.handover.gripper_message`; with another one, its ``joint_names`` are the drives. See
        :meth:`pinograsp.handover.JointTrajectory.to_ros2`; ``commanding`` as for :meth:`to_csv`. The message has no
        field for gains: set the same gains in the controller.
        """
        if command is not None and one_of("command", command, COMMANDS) == "jaw":
            jaws = jaw_commands(self, shortfall=commanding.get("shortfall", SHORTFALL))
            return gripper_message(jaws, path, followers=followers, frame=frame)
        trajectory = make_commands(self, command, **commanding)
        return trajectory.to_ros2(path, followers=followers, effort=effort, goal=goal, frame=frame)

    def to_mujoco(
        self,
        path: str | Path,
        *,
        command: Command | None = None,
        scene: bool = False,
        hold: float = defaults.HOLD,
        model: Any = None,
        qpos: Array | None = None,
        feed_forward: bool = True,
        prefix: str = "",
        **commanding: Unpack[Commanding],
    ) -> JointTrajectory:
        """Write the motion as MuJoCo keyframes (.xml) and controls over time (.npz beside it); returns the trajectory.

        Args:
            path: ``.xml``; existing files are replaced.
            command: without ``scene``, one control per drive instead of one per joint: efforts for ``torque``, servo
                positions that produce them for ``position`` and ``impedance``. In a scene, None means ``impedance``.
            scene: write a complete scene with hand, object, actuators and keyframes, instead of keyframes to be
                included; see :func:`pinograsp.handover.scene.write_scene`.
            hold: for a scene, how long the controls continue after the motion [s].
            model, qpos, feed_forward, prefix: a model of your own, whose actuators determine the controls; see
                :meth:`pinograsp.handover.JointTrajectory.to_mujoco`.
            commanding: as for :meth:`to_csv`.

        Raises:
            InvalidInput: as :func:`pinograsp.handover.drive_commands`, or a model with ``command`` or ``scene``.
                ResultsNotWritten.
        """
        if model is not None and (command is not None or flag("scene", scene)):
            raise InvalidInput(
                "model: expected without command= and scene=, got both: controls follow from the model's own actuators"
            )
        check_model_options(model, qpos, feed_forward, prefix)
        hold = number("hold", hold, at_least=0, unit="s")
        if flag("scene", scene):
            from pinograsp.handover.scene import write_scene

            return write_scene(self, path, "impedance" if command is None else command, hold=hold, **commanding)
        if command is not None:
            return write_drive_keyframes(self, path, command, **commanding)
        trajectory = make_commands(self, None, **commanding)
        return trajectory.to_mujoco(path, model=model, qpos=qpos, feed_forward=feed_forward, prefix=prefix)

    def to_core(
        self, path: str | Path, *, grip: GripController | None = None, **settings: Unpack[LoopSettings]
    ) -> Path:
        """Write the grasp for a controller in C++: the constants of its loop at the end of the motion.

        A header (.hpp) with functions that set up ``pinograsp::core::Online``, and ``pinograsp::core::Grip`` on it, or
        the constants alone (.json); see ``examples/cpp``. The joints' limits are those of the plan; the places of the
        contacts on the links (``contacts_on_links``) are included.

        Args:
            path: an existing file is replaced.
            grip: from :meth:`grip_controller`: the same reactive squeeze in C++; None: the loop alone.
            settings: without a grip, which has its own: normal_forces, max_rate, ramp, period, max_steps as for
                :class:`~pinograsp.motion.OnlineForces`.

        Raises:
            InvalidInput: another suffix, unusable settings, a grip of another plan, or pyramids without exactly four
                edges. ResultsNotWritten.
        """
        path = path_of("path", path)
        constants = self._constants_of_loop(settings) if grip is None else self._constants_of(grip, settings)
        if (places := self.contacts_on_links) is not None:
            constants.get("loop", constants).update(
                contact_links=list(places.links),
                link_points=places.points_l.tolist(),
                link_normals=places.normals_l.tolist(),
            )
        return write_core(constants, path)

    def _constants_of_loop(self, settings: LoopSettings) -> dict[str, Any]:
        for name in settings:
            one_of("setting of to_core", name, LoopSettings.__annotations__)
        problem, q = self.solution.problem, self.motion.q[-1]
        if problem.torques is None:
            problem = replace(problem, torques=torque_limits(self.hand, problem.contacts, q, limit=self.torque_limit))
        return OnlineForces(problem, hand=self.hand, q=q, **settings).constants()

    def _constants_of(self, grip: GripController, settings: LoopSettings) -> dict[str, Any]:
        if settings:
            names = ", ".join(settings)
            raise InvalidInput(f"to_core: expected no settings beside a grip, which has its own, got {names}")
        constants = instance_of("grip", grip, GripController).constants()
        if not np.array_equal(constants["planned"], self._planned_forces()):
            raise InvalidInput("to_core: expected a grip of this plan, plan.grip_controller(), got one of another")
        return constants

    def _planned_forces(self) -> Array:
        """At the end of the motion, in contact axes (k, 3) [N]."""
        forces: Array = np.einsum("kji,kj->ki", self.contacts.rotations_oc, self.motion.forces_o[-1])
        return forces

    def grip_controller(self, **settings: Unpack[GripSettings]) -> GripController:
        """Return the controller that holds the grasped object: its squeeze reacts to the hand's sensors, tick by tick.

        Args:
            settings: as for :class:`~pinograsp.reflex.GripController`; without ``max_normal_force`` the caps are those
                of the plan's conditions.

        Raises:
            InvalidInput: unusable settings, or pyramids without exactly four edges.
            ExtraMissing: the compiled core is not installed.
        """
        for name in settings:
            one_of("setting of grip_controller", name, GripSettings.__annotations__)
        return GripController(
            self.solution.problem,
            hand=self.hand,
            q=self.motion.q[-1],
            forces=self._planned_forces(),
            torques=self.motion.holding_torques,
            torque_limit=self.torque_limit,
            **settings,
        )

    def show(self, *, simulation: Simulation | None = None, port: int = 8080, open_browser: bool = True) -> Viewer:
        """Open a live page with hand, object, forces and friction over time; see :func:`pinograsp.viz.viewer.view`.

        Returns the viewer; its :meth:`~pinograsp.viz.viewer.Viewer.close` closes the page. Needs the extra ``viz``.
        """
        from pinograsp.viz.viewer import view

        return view(self.with_margins(), simulation=simulation, port=port, open_browser=open_browser)

    def save_html(self, path: str | Path, *, simulation: Simulation | None = None) -> Path:
        """Write the viewer as one page that needs no server: see :func:`~pinograsp.viz.page.save_html`."""
        from pinograsp.viz.page import save_html

        return save_html(self, path, simulation=simulation)

    def save_rerun(self, path: str | Path, *, simulation: Simulation | None = None) -> Path:
        """Write a recording for the Rerun viewer, .rrd: see :func:`~pinograsp.viz.rerun_file.write_rerun`."""
        from pinograsp.viz.rerun_file import write_rerun
        from pinograsp.viz.scene import make_scene

        return write_rerun(make_scene(self.with_margins(), simulation), path)

    def picture(
        self,
        path: str | Path,
        *,
        time: float | None = None,
        view: ArrayLike | None = None,
        collision_shapes: bool = False,
    ) -> Path:
        """Write a picture of hand, object, contacts and forces; returns its path.

        Args:
            path: .png, or .svg or .pdf for print (arrows and letters as vector graphics); an existing file is
                overwritten.
            time, view, collision_shapes: as for :func:`pinograsp.viz.still.picture`.

        Raises:
            InvalidInput: as there, or another suffix.
            ResultsNotWritten: the file cannot be written.
        """
        from pinograsp.viz.scene import make_scene
        from pinograsp.viz.still import write_picture

        scene = make_scene(self)
        when = scene.closed if time is None else time
        return write_picture(scene, path, when, view=view, collision_shapes=collision_shapes)

    def film(
        self,
        path: str | Path,
        *,
        view: ArrayLike | None = None,
        collision_shapes: bool = False,
        seconds: float = 4.0,
        progress: bool | None = None,
    ) -> Path:
        """Write a film in which the fingers close and the forces grow; returns its path.

        Args:
            path: .gif or .mp4; an existing file is overwritten.
            view, collision_shapes, seconds, progress: as for :func:`pinograsp.viz.film.write_film`.

        Raises:
            InvalidInput, ExtraMissing, ResultsNotWritten: as there.
        """
        from pinograsp.viz.film import write_film
        from pinograsp.viz.scene import make_scene

        scene = make_scene(self)
        return write_film(scene, path, view=view, collision_shapes=collision_shapes, seconds=seconds, progress=progress)

    def save_figures(self, folder: str | Path) -> list[Path]:
        """Write every figure as PNG; returns their paths. See :mod:`pinograsp.viz.figures` for one of them alone."""
        from pinograsp.viz.figures import save_figures

        return save_figures(self.with_reach(), folder)


def add_tolerance(plan: GraspPlan, found: PoseTolerance | None, drop: float | None = None) -> GraspPlan:
    """The plan with its tolerance, and the warnings of a small one and of a far ``drop`` of the object [m], which is
    found if it is not known; as it is without a tolerance.
    """
    if found is None:
        return plan
    others = [one for one in plan.cautions if not one.startswith((SMALL, DROPS))]
    small = [f"{SMALL} {found.describe()}"] if found.is_small else []
    drops = tell_drop(find_drop(plan) if drop is None else drop)
    return replace(plan, tolerance=found, cautions=(*others, *small, *filter(None, [drops])))
