"""What hand and arm are sent on the way: how the hand closes, how much deeper its fingers go, with which torques."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from pinograsp.carry.squeeze import WaySqueeze
from pinograsp.carry.task import CarryTask
from pinograsp.checks import brief
from pinograsp.errors import PinograspError, Status
from pinograsp.forces import ConvexSolution, optimize_forces
from pinograsp.motion import MotionSpec, plan_motion, torque_limits
from pinograsp.plan import Motion
from pinograsp.spatial import Array, multiply_rows

_NEAR = 1e-4  # relative, of the normal forces that a hand closes to
_GIVING = 1e-2  # joints that move a contact less than this, over the largest, do not press it
_FREELY = 2e-2  # motions along the surface less than this, over the largest, are let be


@dataclass(frozen=True, kw_only=True, eq=False)
class Commands:
    """What is sent for a squeeze on the way; N samples, k contacts, n joints.

    Attributes:
        task: what is carried.
        squeeze: along its path.
    """

    task: CarryTask
    squeeze: WaySqueeze

    __repr__ = brief("task")

    @cached_property
    def local(self) -> Array:
        """Forces in the contacts' axes (N, k, 3) [N]."""
        problem, x = self.task.limits.problem, self.squeeze.x
        widths = problem.friction.scale(problem.mu)
        return np.concatenate([x[..., :2] * widths[:, :2], x[..., -1:]], axis=2)

    @cached_property
    def torsion(self) -> Array:
        """Moments about the normals (N, k) [N m]."""
        problem, x = self.task.limits.problem, self.squeeze.x
        if problem.friction.d < 4:
            return np.zeros(x.shape[:2])
        return np.asarray(x[..., 2] * problem.friction.scale(problem.mu)[:, 2])

    @cached_property
    def bare(self) -> Array:
        """Torques of all joints without contact forces on the fingers (N, n) [N m or N]."""
        return self.squeeze.passage.constraints.middle.torque.at_square(self.squeeze.passage.level)

    @property
    def torques(self) -> Array:
        """Of all joints (N, n) [N m or N]."""
        return self._press(self.local, self.torsion)

    @property
    def feed_forward(self) -> Array:
        """Torques that go with the commanded forces (N, n) [N m or N].

        What is commanded once has the tangential forces of the first load, when normal forces are the commanded ones.
        """
        commanded = self.squeeze.commanded
        once = slice(0, 1) if not np.ptp(commanded, axis=0).any() else slice(None)
        pressed = np.broadcast_to(self.local[once], self.local.shape).copy()
        pressed[..., 2] = commanded
        return self._press(pressed, np.broadcast_to(self.torsion[once], self.torsion.shape))

    @property
    def positions(self) -> Array:
        """Of the joints (N, n) [rad or m]: the fingers as much deeper as contacts have to be."""
        loaded, (closing, first) = self.task.loaded[0], self.first_closing
        found = np.array(self.squeeze.passage.constraints.middle.q)
        reference = self.task.grasp.forces.final_depths if first is None else first.profile.final_depth
        found[:, loaded.fingers] = closing.q[-1][loaded.finger_dofs] + self._go_deeper(reference)
        return found

    @cached_property
    def first_closing(self) -> tuple[Motion, ConvexSolution | None]:
        """How the grasp's hand closes to the first squeeze of the way, and the forces it then has.

        It is planned as any grasp's motion, since surfaces, friction and servos make more of it than depths along
        normals. Where that is not to be had, it is the grasp's own, and there are no forces.
        """
        grasp, normal, passage = self.task.grasp, self.squeeze.commanded[0], self.squeeze.passage
        own, fingers = grasp.motion, [(finger.name, finger.dofs) for finger in grasp.hand.fingers]
        spec = MotionSpec(
            start={name: own.q[0, dofs] for name, dofs in fingers},
            posture={name: own.q[own.impact, dofs] for name, dofs in fingers},
        )
        first = passage.constraints.middle.wrench
        problem = replace(
            self.task.limits.problem,
            load=-first.at_square(passage.level)[0],
            gravity_o=-first.still[0, :3] / self.task.loaded[0].inertia.mass,
            torques=None,
            # A little room, for rounding.
            min_normal_force=normal * (1.0 - _NEAR),
            max_normal_force=normal * (1.0 + _NEAR),
        )
        try:
            forces = optimize_forces(problem, grasp.forces.impact_time, objective="least_squares")
            if forces.found:
                motion = plan_motion(grasp.hand, forces, spec)
                if motion.status is Status.OK:
                    return motion, forces
        except PinograspError:
            pass
        return own, None

    @cached_property
    def _jacobian(self) -> Array:
        """Of the contact points (k, 6, n_h) in the joints of the grasp's hand, where the grasp was planned."""
        problem, loaded = self.task.limits.problem, self.task.loaded[0]
        if problem.torques is not None:
            return problem.torques.jacobian
        return torque_limits(loaded.hand, problem.contacts, loaded.posture[loaded.of_hand], limit=np.inf).jacobian

    def _go_deeper(self, reference: Array) -> Array:
        """How much further the fingers' joints have to be (N, ...) for the commanded forces than for depths (k,) [m].

        Of the ways to be deeper the one that moves contacts along the surface least: friction would hold against it.
        """
        problem, dofs = self.task.limits.problem, self.task.loaded[0].finger_dofs
        depths = np.asarray(problem.compliance.depth(np.maximum(self.squeeze.commanded, 0.0))) - reference
        moved = np.einsum("kxn,kxc->kcn", self._jacobian[:, :3, dofs], problem.contacts.rotations_oc)
        along, into = moved[:, :2].reshape(-1, len(dofs)), moved[:, 2]
        deeper = np.linalg.pinv(into, rcond=_GIVING)
        _, size, axes = np.linalg.svd(into)
        free = axes[int((size > _GIVING * size[0]).sum()) :].T
        drag, damping = along @ free, _FREELY * np.linalg.norm(along, 2)
        # Damped: what hardly moves contacts would have to go far.
        deeper -= free @ np.linalg.solve(drag.T @ drag + damping**2 * np.eye(free.shape[1]), drag.T @ along @ deeper)
        return multiply_rows(depths, deeper.T)

    def _press(self, local: Array, torsion: Array) -> Array:
        """Torques of all joints (N, n) with J^T f of the fingers [N m or N]."""
        contacts, loaded = self.task.limits.problem.contacts, self.task.loaded[0]
        J, found = self._jacobian[..., loaded.finger_dofs], np.array(self.bare)
        forces = np.einsum("kij,nkj->nki", contacts.rotations_oc, local)
        moments = np.einsum("nk,kx->nkx", torsion, contacts.rotations_oc[:, :, 2])
        found[:, loaded.fingers] += np.einsum("kxj,nkx->nj", J[:, :3], forces)
        found[:, loaded.fingers] += np.einsum("kxj,nkx->nj", J[:, 3:], moments)
        return found
