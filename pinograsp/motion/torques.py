"""Joint torques with contact forces: tau = M ddq + h + J^T f, f being the force on the *object*."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from pinograsp.checks import array_of
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel


def inverse_dynamics(hand: HandModel, q, dq, ddq, *, gravity_o=(0.0, 0.0, -9.81)) -> np.ndarray:
    """M ddq + h (m, n) [N m] along trajectories (m, n): inertia, Coriolis and gravity, no contact (RNEA).

    ``gravity_o`` (3,) [m/s^2] acts in the world.
    """
    q, dq, ddq = (array_of("trajectory", v, (None, hand.n)) for v in (q, dq, ddq))
    if not len(q) == len(dq) == len(ddq):
        raise InvalidInput(f"trajectories: expected equal lengths, got {len(q)}, {len(dq)}, {len(ddq)}")
    model = hand.model
    if not np.array_equal(model.gravity.linear, gravity_o):
        model = model.copy()
        model.gravity.linear = array_of("gravity", gravity_o, (3,))
    return pin.rneaInParallel(1, pin.ModelPool(model, 1), q.T, dq.T, ddq.T).T  # one call, no loop in Python


def contact_torques(jacobians, forces_o) -> np.ndarray:
    """Sum over contacts of J^T f (m, n) [N m] from contact Jacobians (m, c, 3, n) and forces on the object (m, c, 3)."""
    return np.einsum("mcxn,mcx->mn", jacobians, forces_o)
