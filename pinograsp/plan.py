"""From a hand and a force problem to a grasp plan: forces, then motion. The only file that knows the order."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np

from pinograsp.errors import GraspInfeasible, Status
from pinograsp.forces import ForceProblem, ForceSolution, GridSpec, grid_search
from pinograsp.hands import HandModel
from pinograsp.motion import Motion, MotionSpec, plan_motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GraspPlan:
    """A grasp: contact forces, and the joint motion and torques that bring them about.

    Attributes:
        hand: the hand. forces: the force search's record. motion: trajectory and torques.
        elapsed: seconds per stage, ``{"forces": ..., "motion": ...}``.
    """

    hand: HandModel
    forces: ForceSolution
    motion: Motion
    elapsed: dict[str, float]

    @property
    def problem(self) -> ForceProblem:
        """The force problem that was solved."""
        return self.forces.problem

    @property
    def status(self) -> Status:
        """``OK``, or the first stage's complaint."""
        return self.forces.status if self.forces.status is not Status.OK else self.motion.status

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
            "remedy": self.status.remedy,
            "search": forces.search,
            "solver": forces.solver or "none",
            "balance": self.problem.balance,
            "measure": self.problem.measure,
            "impact_time_s": forces.impact_time,
            "final_time_s": self.problem.final_time,
            "normal_forces_N": dict(zip(names, forces.normal_forces.tolist())),
            "multipliers": dict(zip(names, forces.multipliers.tolist())),
            "contact_forces_N": dict(zip(names, forces.forces_c.tolist())),
            "accelerations_m_s2": dict(zip(names, forces.acceleration.tolist())),
            "work_J": forces.work,
            "impulse_Ns": forces.impulse,
            "net_force_N": forces.net_force,
            "net_moment_Nm": forces.net_moment,
            "max_penetration_m": float(forces.profile.final_depth.max()),
            "joint_torque_max_Nm": {
                finger: {phase: values.tolist() for phase, values in phases.items()}
                for finger, phases in self.torque_maxima().items()
            },
            "peak_torque_Nm": self.motion.peak_torque,
            "tracking_error_m": dict(zip(names, self.motion.tracking_error.tolist())),
            "postures_tried": self.motion.postures,
            "grid": {
                "points": forces.points,
                "cells": forces.cells,
                "rejections": forces.rejections,
                "qp_solves": forces.qp_solves,
            },
            "notes": list(self.motion.notes),
            "elapsed_s": sum(self.elapsed.values()),
            "elapsed_by_stage_s": dict(self.elapsed),
        }

    def arrays(self) -> dict[str, np.ndarray]:
        """The plan's arrays: shapes and units as in :class:`~pinograsp.motion.Motion` and the contact set."""
        motion, contacts = self.motion, self.problem.contacts
        profile = self.forces.profile
        depth, rate = profile.depth(motion.times), profile.rate(motion.times)
        return {
            "times": motion.times,
            "impact": np.array(motion.impact),
            "q": motion.q,
            "dq": motion.dq,
            "ddq": motion.ddq,
            "torques": motion.torques,
            "forces_o": motion.forces_o,
            "depth": depth,
            "rate": rate,
            "normal_forces": self.problem.compliance.normal_force(depth, rate),
            "net_force_o": motion.forces_o.sum(axis=1) + self.problem.load[:3],
            "points_o": contacts.points_o,
            "rotations_oc": contacts.rotations_oc,
            "com_o": contacts.com_o,
            "grasp_map": contacts.G,
            "load": self.problem.load,
        }


def plan_grasp(
    hand: HandModel,
    problem: ForceProblem,
    *,
    grid: GridSpec | None = None,
    search: str = "hybrid",
    solver: str = "daqp",
    motion: MotionSpec | None = None,
    progress: bool | None = None,
) -> GraspPlan:
    """Plan a grasp: least-energy contact forces, then the joint motion and torques with the least peak torque.

    Args:
        hand: the hand, placed in the world.
        problem: contacts (of this hand), load, friction and limits.
        grid, search, solver, progress: see :func:`~pinograsp.forces.grid_search`.
        motion: postures and sampling; see :class:`~pinograsp.motion.MotionSpec`.

    Returns:
        The plan with its status: ``OK``; ``UNBALANCED`` where the QP found that the paper's grid point balances only
        within its net-force limit; ``JOINT_LIMIT`` or ``NOT_TRACKED`` where the motion is at fault; ``INTERRUPTED``.

    Raises:
        GraspInfeasible: no forces on the grid; carries the search record with its rejection histogram.
        ContactNotReached: a finger cannot reach its contact points.
    """
    started = time.perf_counter()
    forces = grid_search(problem, grid, search=search, solver=solver, progress=progress)
    if not forces.found or forces.status is Status.INACCURATE:
        raise GraspInfeasible(f"no grasp found ({forces.status}). {forces.status.remedy}\n{forces.explain()}", forces)
    found = time.perf_counter()
    moved = plan_motion(hand, forces, motion)
    elapsed = {"forces": found - started, "motion": time.perf_counter() - found}
    return GraspPlan(hand=hand, forces=forces, motion=moved, elapsed=elapsed)
