"""Joints over time, as far as their actuators are concerned."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from pinograsp.hands.coupling import Coupling


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSamples:
    """What joints do over time.

    Attributes:
        names: of the joints (n,).
        times: (m,) [s].
        q, dq, ddq: (m, n) [rad, rad/s, rad/s^2; m where joints slide].
        effort: feed-forward torques (m, n) [N m or N].
        contact_effort: the share of ``effort`` that the contact forces ask for (m, n) [N m or N]; None: not known.
        couplings: by coupled joint, what it follows and how.
    """

    names: tuple[str, ...]
    times: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    ddq: np.ndarray
    effort: np.ndarray
    contact_effort: np.ndarray | None = None
    couplings: Mapping[str, Coupling] = field(default_factory=dict)
