"""The record of a grasp plan."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from pinograsp.checks import brief
from pinograsp.contacts import PALM, Closure
from pinograsp.contacts.quality import ferrari_canny, grasp_map_metrics, grasp_stiffness
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import (
    ForceProblem,
    ForceSolution,
    disturbance_margin,
    force_closure,
    grasp_margins,
)
from pinograsp.hands import HandModel
from pinograsp.motion import Motion

_SLIDES = 1e-4  # [m] across the normal: worth telling
_DIRECTIONS = 48  # around a plane, in which margins are kept


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspPlan:
    """A grasp: contact forces, and the joint motion and torques that bring them about.

    Attributes:
        hand: the hand.
        forces: the force search's record.
        motion: trajectory and torques.
        elapsed: seconds per stage, ``{"forces": ..., "motion": ...}``, and ``"closing"`` where the hand was closed.
        closure: how the contacts were found, or None where they were given.
    """

    hand: HandModel
    forces: ForceSolution
    motion: Motion
    elapsed: dict[str, float]
    closure: Closure | None = None

    __repr__ = brief("status", "hand", "problem", "forces", "motion", "elapsed")

    @property
    def problem(self) -> ForceProblem:
        """The force problem that was solved."""
        return self.forces.problem

    @property
    def status(self) -> Status:
        """``OK``, or the first stage's complaint."""
        return self.forces.status if self.forces.status is not Status.OK else self.motion.status

    @property
    def remedy(self) -> str:
        """What is behind a status other than ``OK`` and what to do about it; empty for ``OK``."""
        own = self.motion.remedy if self.forces.status is Status.OK else ""
        return own or self.status.remedy

    @property
    def cautions(self) -> tuple[str, ...]:
        """What the plan's promise does not cover, in words: look here before a simulation or a robot does."""
        problem, contacts, motion = self.problem, self.problem.contacts, self.motion
        told = []
        if problem.balance == "force":
            told.append("forces are balanced, moments are not: a free object turns (balance='wrench')")
        if problem.friction.safety == 1.0:
            told.append("friction is used up to its limit: ask for a friction safety factor above 1")
        told += [
            f"{name} cannot press: its force builds up only as the object gives way to the fingers"
            for name, contact in zip(contacts.names, contacts)
            if contact.finger == PALM
        ]
        if problem.torques is not None and problem.torques.limited.any():
            loaded = np.abs(problem.torques.jacobian).max(axis=(0, 1)) > 0
            free = [
                name
                for name, bears, has in zip(problem.torques.joints, loaded, problem.torques.limited)
                if bears and not has
            ]
            if free:
                told.append(f"no limit is known of the torques of {', '.join(free)}: they are not limited")
        for name, slip in zip(contacts.names, motion.slip):
            if slip > _SLIDES:
                told.append(
                    f"{name} slides {1e3 * slip:.2f} mm across its normal while it presses: friction then points "
                    "elsewhere"
                )
        if problem.object is not None:
            links = [contact.link for contact in contacts]
            for name, contact in zip(contacts.names, contacts):
                # The corners of a flat area may lie on an edge; a single point there has no normal of its own.
                if links.count(contact.link) == 1 and _on_edge(problem.object, contact.point_o):
                    told.append(
                        f"{name} touches an edge of the object, where the normal is a matter of a hair's breadth"
                    )
        return tuple(told)

    def torque_maxima(self) -> dict[str, dict[str, np.ndarray]]:
        """Largest |torque| per joint [N m], ``{finger: {"approach": (n_f,), "grasp": (n_f,)}}``."""
        torques, impact = np.abs(self.motion.torques), self.motion.impact
        return {
            finger.name: {
                "approach": torques[: impact + 1, finger.dofs].max(axis=0),
                "grasp": torques[impact:, finger.dofs].max(axis=0),
            }
            for finger in self.hand.fingers
        }

    def summary(self) -> dict:
        """The plan's figures as plain JSON values, units in the names."""
        forces, names = self.forces, self.problem.contacts.names
        return {
            "status": str(self.status),
            "remedy": self.remedy,
            "search": forces.search,
            "solver": forces.backend or "none",
            "balance": self.problem.balance,
            "measure": self.problem.measure,
            "friction": {
                "mu": self.problem.mu.tolist(),
                "model": self.problem.friction.model,
                "edges": self.problem.friction.edges if self.problem.friction.model == "pyramid" else None,
                "safety": self.problem.friction.safety,
                "torsion_m": self.problem.friction.torsion,
            },
            "impact_time_s": forces.impact_time,
            "final_time_s": self.problem.final_time,
            "normal_forces_N": dict(zip(names, forces.normal_forces.tolist())),
            "multipliers": dict(zip(names, forces.multipliers.tolist())),
            "contact_forces_N": dict(zip(names, forces.forces_c.tolist())),
            "torsion_Nm": dict(zip(names, forces.torsion.tolist())) if self.problem.friction.torsion else {},
            "accelerations_m_s2": dict(zip(names, forces.acceleration.tolist())),
            "work_J": forces.work,
            "impulse_Ns": forces.impulse,
            "residual_N": forces.residual_force,
            "residual_Nm": forces.residual_moment,
            "max_penetration_m": float(forces.profile.final_depth.max()),
            "joint_torque_max_Nm": {
                finger: {phase: values.tolist() for phase, values in phases.items()}
                for finger, phases in self.torque_maxima().items()
            },
            "peak_torque_Nm": self.motion.peak_torque,
            "tracking_error_m": dict(zip(names, self.motion.tracking_error.tolist())),
            "postures_tried": self.motion.postures,
            "grid": None
            if forces.grid is None
            else {
                "points": forces.grid.points,
                "cells": forces.grid.cells,
                "rejections": forces.grid.rejections,
                "qp_solves": forces.grid.qp_solves,
            },
            "certificate": self._certificate(),
            "margins": self._margins(),
            "closing": None if self.closure is None else self.closure.summary(),
            "cautions": list(self.cautions),
            "notes": [*self.motion.notes, *(() if self.closure is None else self.closure.notes)],
            "elapsed_s": sum(self.elapsed.values()),
            "elapsed_by_stage_s": dict(self.elapsed),
        }

    def _certificate(self) -> dict | None:
        certificate = self.forces.certificate
        if certificate is None:
            return None
        return {
            "weights": dict(self.forces.weights),
            "objective": certificate.objective,
            "lower_bound": certificate.lower_bound,
            "relative_gap": certificate.relative_gap,
            "violation_N": certificate.violation,
            "active": list(certificate.active(self.problem.contacts.names)),
            "branches": len(self.forces.branches),
        }

    def _margins(self) -> dict:
        """Margins of the forces and quality of the grasp, as plain values; None where a figure is infinite."""
        problem, forces = self.problem, self.forces
        margins = grasp_margins(forces, tolerance=1e-3)
        closure = force_closure(problem.contacts, problem.mu, balance=problem.balance)
        settings = {"friction": replace(problem.friction, safety=1.0), "moment_length": problem.moment_length}
        epsilon = ferrari_canny(problem.contacts, problem.mu, balance=problem.balance, tolerance=1e-2, **settings)
        stiffness = grasp_stiffness(problem.contacts, problem.compliance, forces.normal_forces)
        metrics = grasp_map_metrics(problem.contacts, moment_length=problem.moment_length)

        def finite(value):
            return None if value is None or not np.isfinite(value) else float(value)

        names = problem.contacts.names
        return {
            "friction_used": {name: finite(v) for name, v in zip(names, margins.friction_used)},
            "least_mu": dict(zip(names, margins.least_mu.tolist())),
            "slip_distance_N": dict(zip(names, margins.slip_distance.tolist())),
            "load_factor": finite(margins.load_factor),
            "disturbance_any_N": margins.disturbance.lower,
            "weakest_direction": margins.disturbance.direction.tolist(),
            "disturbance_force_N": margins.disturbance_force,
            "disturbance_moment_Nm": margins.disturbance_moment,
            "force_closure": closure.closed,
            "ferrari_canny_L1": epsilon.lower,
            "min_singular_value": float(metrics.min_singular_value),
            "isotropy": float(metrics.isotropy),
            "stiffness_N_m": np.asarray(stiffness.matrix).tolist(),
        }

    def margins_around(self) -> dict[str, np.ndarray]:
        """Forces that may come on top of the load while the squeeze stays, around the planes xy, xz, yz.

        ``margin_directions``: unit vectors (3, d, 3); ``margin_forces``: the largest force along each (3, d) [N].
        """
        problem = replace(self.problem, friction=replace(self.problem.friction, safety=1.0))

        def margin(direction) -> float:
            held = disturbance_margin(
                problem, np.append(direction, np.zeros(3)), normal_forces=self.forces.normal_forces
            )
            return max(0.0, held)  # forces on their limits leave nothing, and rounding of that may be less than nothing

        reach = {(axis, sign): margin(sign * np.eye(3)[axis]) for axis in range(3) for sign in (1.0, -1.0)}
        angles = np.linspace(0, 2 * np.pi, _DIRECTIONS, endpoint=False)
        directions = np.zeros((3, _DIRECTIONS, 3))
        for plane, axes in enumerate(((0, 1), (0, 2), (1, 2))):
            for axis, share in zip(axes, (np.cos(angles), np.sin(angles))):
                # Denser where the set is thin: as on an ellipse that reaches as far.
                size = np.where(share > 0, reach[axis, 1.0], reach[axis, -1.0])
                directions[plane][:, axis] = share * np.maximum(size, 1e-3 * max(1e-3, *reach.values()))
        directions /= np.linalg.norm(directions, axis=2, keepdims=True)
        forces = np.array([[margin(direction) for direction in plane] for plane in directions])
        return {"margin_directions": directions, "margin_forces": forces}

    def arrays(self) -> dict[str, np.ndarray]:
        """The plan's arrays: shapes and units as in :class:`~pinograsp.motion.Motion` and the contact set."""
        motion, contacts, compliance = self.motion, self.problem.contacts, self.problem.compliance
        profile = self.forces.profile
        depth, rate = profile.depth(motion.times), profile.rate(motion.times)
        return {
            "times": motion.times,
            "impact": np.array(motion.impact),
            "q": motion.q,
            "dq": motion.dq,
            "ddq": motion.ddq,
            "torques": motion.torques,
            "holding_torques": motion.holding_torques,
            "forces_o": motion.forces_o,
            "depth": depth,
            "rate": rate,
            "normal_forces": compliance.normal_force(depth, rate),
            "residual_force_o": motion.forces_o.sum(axis=1) + self.problem.load[:3],
            "points_o": contacts.points_o,
            "rotations_oc": contacts.rotations_oc,
            "com_o": contacts.com_o,
            "grasp_map": contacts.G,
            "load": self.problem.load,
            "gravity": self.problem.gravity_o,
            "object_mass": np.array(0.0 if self.problem.object is None else self.problem.object.mass),
            "mu": self.problem.mu,
            "torsion_length": np.array(self.problem.friction.torsion),
            "contact_law": np.array([compliance.stiffness, compliance.damping, compliance.exponent]),
            "contact_names": np.array(contacts.names),
            "contact_links": np.array([contact.link for contact in contacts]),
            "torque_limit": self.hand.effort_or_infinity
            if self.problem.torques is None
            else self.problem.torques.limit,
            # Branch and bound: start and end of each interval of t_I [s], its proven bound, the best objective then.
            "branches": np.array([(b.start, b.end, b.lower_bound, b.best) for b in self.forces.branches]).reshape(
                -1, 4
            ),
        }

    def to_csv(self, path, *, followers: bool = False, **settings):
        """Write the motion for a controller as a table; see :meth:`pinograsp.handover.JointTrajectory.to_csv`.

        ``settings``: rate, start, lead, blend, as for :func:`pinograsp.handover.joint_trajectory`. Returns the
        trajectory, which tells how far it is from the plan.
        """
        from pinograsp.handover import joint_trajectory

        return joint_trajectory(self, **settings).to_csv(path, followers=followers)

    def to_ros2(
        self,
        path=None,
        *,
        followers: bool = False,
        effort: bool = True,
        goal: bool = False,
        frame: str = "",
        **settings,
    ) -> dict:
        """The motion as ROS 2's ``trajectory_msgs/JointTrajectory``, written where a path (.yaml, .json) is given.

        See :meth:`pinograsp.handover.JointTrajectory.to_ros2`; ``settings`` as for :meth:`to_csv`.
        """
        from pinograsp.handover import joint_trajectory

        return joint_trajectory(self, **settings).to_ros2(
            path, followers=followers, effort=effort, goal=goal, frame=frame
        )

    def to_mujoco(self, path, *, model=None, qpos=None, feed_forward: bool = True, prefix: str = "", **settings):
        """Write the motion as MuJoCo keyframes (.xml) and controls over time (.npz beside it); returns the trajectory.

        See :meth:`pinograsp.handover.JointTrajectory.to_mujoco`; ``settings`` as for :meth:`to_csv`.
        """
        from pinograsp.handover import joint_trajectory

        trajectory = joint_trajectory(self, **settings)
        return trajectory.to_mujoco(path, model=model, qpos=qpos, feed_forward=feed_forward, prefix=prefix)

    def show(self, *, simulation=None, port: int = 8080, open_browser: bool = True):
        """Open a live page with hand, object, forces and friction over time; see :func:`pinograsp.viz.viewer.view`.

        Returns the viewer; its :meth:`~pinograsp.viz.viewer.Viewer.close` takes the page down. Needs the extra ``viz``.
        """
        from pinograsp.storage import run_of
        from pinograsp.viz.viewer import view

        return view(run_of(self), simulation=simulation, port=port, open_browser=open_browser)


def _on_edge(body, point_o) -> bool:
    try:
        body.curvature(point_o[None])
    except InvalidInput:
        return True
    return False
