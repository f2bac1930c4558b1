"""The record of a simulation of a plan, and its verdict."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any

import numpy as np

from pinograsp.checks import brief
from pinograsp.showing import in_notebook
from pinograsp.spatial import Array

# The object counts as held if it has moved less than this since the release and has come to rest.
MOVED, TURNED = 5e-3, 10.0  # [m], [deg]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Verdict:
    """The result of a simulated plan.

    Attributes:
        held: whether the object stayed in the hand.
        reason: the reason, in words.
        drift: of its centre of mass since the release [m].
        tilt: of its upright direction [deg].
        turn: about any axis [deg].
        force_error: largest |F_n - planned| / planned at the end, over the parts of the hand that should touch (planned
            counts as a twentieth of the largest at least).
        force_errors: each.
        settled_error: as ``force_error``, compared with the plan's prediction for the object let go; None if it was
            never let go.
        penetration_error: largest |depth - planned| in the last tenth of the hold, as for the forces [m].
        slipped: parts that slipped by more than 0.1 mm after the release.
        unplanned: parts that touch without being planned.
        limit_hits: joints beyond their position limits.
        saturated: joints whose motor was at its torque limit at the end.
        energy_error: energy that the audit does not account for, relative to the energy turned over.
        causes: for a lost object, the first causes in the order of time, in words: motors at their torque limits,
            contacts that slipped or opened, a joint that gave way.
        remedies: what to change then, in words.
    """

    held: bool
    reason: str
    drift: float
    tilt: float
    turn: float
    force_error: float
    force_errors: dict[str, float]
    penetration_error: float
    slipped: tuple[str, ...]
    unplanned: tuple[str, ...]
    limit_hits: tuple[str, ...]
    saturated: tuple[str, ...]
    energy_error: float | None
    settled_error: float | None = None
    causes: tuple[str, ...] = ()
    remedies: tuple[str, ...] = ()

    __repr__ = brief(
        "held", "reason", "causes", "drift", "turn", "force_error", "penetration_error", "slipped", "unplanned"
    )

    def summary(self) -> dict[str, Any]:
        """As plain JSON values, units in the names."""
        return {
            "held": self.held,
            "reason": self.reason,
            "drift_mm": 1e3 * self.drift,
            "tilt_deg": self.tilt,
            "turn_deg": self.turn,
            "force_error": self.force_error,
            "force_errors": dict(self.force_errors),
            "settled_error": self.settled_error,
            "penetration_error_mm": 1e3 * self.penetration_error,
            "slipped": list(self.slipped),
            "unplanned_contacts": list(self.unplanned),
            "joint_limit_hits": list(self.limit_hits),
            "saturated": list(self.saturated),
            "energy_error": self.energy_error,
            "causes": list(self.causes),
            "remedies": list(self.remedies),
        }


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class History:
    """The samples of a simulation.

    Attributes:
        complete: the sample at which the grasp is complete, at t_F; drift and slip count from there.
        times: samples (s,) [s].
        q: joint positions (s, n) [rad; m where joints slide].
        dq: joint velocities (s, n) [rad/s or m/s].
        torques: of the motors (s, n) [N m or N].
        object_poses: oMb of the object's frame, that of its file (s, 4, 4).
        parts: names of the parts of the hand that touch or should touch (p), in the order of the plan's contacts, then
            those that touch although not planned. Contacts of one part share a row, under the name of their link.
        forces_o: on the object by part, sums over its points (s, p, 3) [N].
        normal_forces: by part (s, p) [N].
        tangential_forces: by part (s, p) [N].
        depths: of a part's deepest point (s, p) [m].
        slips: path slipped (s, p) [m].
        planned_forces: sum of F_n by part (p,) [N].
        energies: by name (s,) [J]: ``joint_work``, of the motors less the joints' dry friction, and ``load_work`` (put
            in); ``mechanical``, the change of kinetic and potential energy, and ``elastic`` (held); ``damped``,
            ``slipped`` (lost); ``normal_work``, the integral of F_n over the depth.
    """

    complete: int
    times: Annotated[Array, "s"]
    q: Annotated[Array, "s n"]
    dq: Annotated[Array, "s n"]
    torques: Annotated[Array, "s n"]
    object_poses: Annotated[Array, "s 4 4"]
    parts: Annotated[tuple[str, ...], "p"]
    forces_o: Annotated[Array, "s p 3"]
    normal_forces: Annotated[Array, "s p"]
    tangential_forces: Annotated[Array, "s p"]
    depths: Annotated[Array, "s p"]
    slips: Annotated[Array, "s p"]
    planned_forces: Annotated[Array, "p"]
    energies: Mapping[str, Annotated[Array, "s"]]

    __repr__ = brief("times", "parts", "planned_forces")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Simulation(History):
    """The simulation of a plan: its samples and its verdict.

    Attributes:
        verdict: held or lost, with its numbers.
        mode: ``"servo"`` or ``"prescribed"``.
        time_step: [s].
        release: when the object was let go [s]; None: never.
        com_b: the object's centre of mass in its frame (3,) [m].
        disturbance: differences from the plan, as plain values.
        notes: differences of the geometry from the plan's.
        elapsed: [s].
        exponent: rho of the contact law.
        servo: control of the joints and stiffness [N m/rad or N/m], as plain values; empty: prescribed motion.
    """

    verdict: Verdict
    mode: str
    time_step: float
    release: float | None
    com_b: Annotated[Array, "3"]
    disturbance: Mapping[str, Any]
    notes: tuple[str, ...]
    elapsed: float
    exponent: float
    servo: Mapping[str, Any] = field(default_factory=dict)

    __repr__ = brief("verdict", "mode", "time_step", "parts", "planned_forces", "notes", "elapsed")
    _repr_html_ = in_notebook

    def __str__(self) -> str:
        return self.describe()

    @property
    def grasp_energy(self) -> float:
        """Grasp energy by Eq. (9), (rho + 1) times the work of the normal forces, when the grasp was complete [J]."""
        return (self.exponent + 1) * float(self.energies["normal_work"][self.complete])

    @property
    def com_o(self) -> Array:
        """Positions of the object's centre of mass (s, 3) [m]."""
        return np.asarray(self.object_poses[:, :3, :3] @ self.com_b + self.object_poses[:, :3, 3])

    @property
    def drift(self) -> Array:
        """Distance of the object's centre of mass from its position when the grasp was complete (s,) [m]; 0 before."""
        position = self.com_o
        moved: Array = np.linalg.norm(position - position[self.complete], axis=1)
        moved[: self.complete] = 0.0
        return moved

    def describe_controller(self) -> str:
        """The controller of the hand from t_F on, in words; "" if the hand followed the plan alone."""
        felt = self.disturbance.get("controller_feels")
        return "" if felt is None else f"with a controller that measures {', '.join(map(str, felt)) or 'nothing'}"

    def summary(self) -> dict[str, Any]:
        """Verdict and settings as plain JSON values."""
        return {
            **self.verdict.summary(),
            "mode": self.mode,
            "servo": dict(self.servo),
            "time_step_s": self.time_step,
            "release_s": self.release,
            "complete": self.complete,
            "end_s": float(self.times[-1]),
            "planned_forces_N": dict(zip(self.parts, self.planned_forces.tolist())),
            "final_forces_N": dict(zip(self.parts, self.normal_forces[-1].tolist())),
            "grasp_energy_mJ": 1e3 * self.grasp_energy,
            "contact_exponent": self.exponent,
            "energies_mJ": {name: 1e3 * float(values[-1]) for name, values in self.energies.items()},
            "disturbance": dict(self.disturbance),
            "notes": list(self.notes),
            "elapsed_s": self.elapsed,
        }

    def describe(self) -> str:
        """The verdict and the measurements as readable text."""
        v = self.verdict
        lines = [
            f"{'HELD' if v.held else 'LOST'}: {v.reason}",
            *(f"  why: {cause}" for cause in v.causes),
            *(f"  what helps: {remedy}" for remedy in v.remedies),
            *(f"  {line}" for line in self.list_measures()),
        ]
        return "\n".join([*lines, *(f"  note: {note}" for note in self.notes)])

    def list_measures(self) -> list[str]:
        """Motions, forces and limits, a line each, without the verdict."""
        v = self.verdict
        lines = [
            f"drift {1e3 * v.drift:.3f} mm, tilt {v.tilt:.3f} deg, turn {v.turn:.3f} deg",
            f"largest force error {100 * v.force_error:.2f} %, penetration error {1e3 * v.penetration_error:.4f} mm",
        ]
        if v.settled_error is not None and v.settled_error < 0.5 * v.force_error:
            lines.append(f"{100 * v.settled_error:.2f} % off the plan's prediction for the object let go")
        for i, part in enumerate(self.parts):
            lines.append(
                f"{part}: F_n {self.normal_forces[-1, i]:.3f} N (planned {self.planned_forces[i]:.3f} N), "
                f"slipped {1e3 * self.slips[-1, i]:.3f} mm"
            )
        for what, which in (
            ("touching although not planned", v.unplanned),
            ("beyond their limits", v.limit_hits),
            ("at their torque limit", v.saturated),
        ):
            if which:
                lines.append(f"{what}: {', '.join(which)}")
        if controlled := self.describe_controller():
            lines.append(f"squeezed {controlled}")
        audit = "not made (the hand was shaken)" if v.energy_error is None else f"closes to {v.energy_error:.1e}"
        control = self.servo.get("control", self.mode)
        lines.append(f"energy audit {audit}; {control}, step {1e3 * self.time_step:g} ms, {self.elapsed:.2f} s")
        return lines
