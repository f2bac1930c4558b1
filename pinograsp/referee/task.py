"""What is tried: a plan as plain numbers, from Python or from a run folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pinograsp.checks import brief, instance_of, shown
from pinograsp.errors import InvalidInput
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.storage import Run, load_run


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Task:
    """A plan as the referee sees it: the commands, and what they are said to bring about.

    Attributes:
        hand, object: where they are at the start.
        times: (m,) [s].
        q, dq: commanded (m, n).
        torques: feed-forward (m, n) [N m], and after the end holding_torques (n,).
        torque_limit: (n,), infinity: none.
        impact_time, final_time: [s].
        names: of the planned contacts (k).
        links: that touch there (k).
        points_o: (k, 3) [m].
        forces_o: planned at the end, on the object (k, 3) [N].
        normal_forces: (k,) [N].
        depths: (k,) [m].
        mu: (k,).
        torsion: largest moment about a normal per newton [m].
        law: K, lambda, rho.
        load: besides the weight, on the object about its centre of mass (6,) [N, N m].
        gravity_o: (3,) [m/s^2].
    """

    hand: HandModel
    object: Body
    times: np.ndarray
    q: np.ndarray
    dq: np.ndarray
    torques: np.ndarray
    holding_torques: np.ndarray
    torque_limit: np.ndarray
    impact_time: float
    final_time: float
    names: tuple[str, ...]
    links: tuple[str, ...]
    points_o: np.ndarray
    forces_o: np.ndarray
    normal_forces: np.ndarray
    depths: np.ndarray
    mu: np.ndarray
    torsion: float
    law: tuple[float, float, float]
    load: np.ndarray
    gravity_o: np.ndarray

    __repr__ = brief("hand", "object", "names", "normal_forces", "mu", "impact_time", "final_time")

    @classmethod
    def of(cls, plan, object: Body | None = None) -> Task:
        """From a grasp plan, a run, or a run's folder; ``object`` where the plan does not know its own.

        Raises:
            InvalidInput: neither, an older run, or no object.
        """
        instance_of("object", object, Body, type(None))
        if isinstance(plan, str | Path):
            plan = load_run(plan)
        if isinstance(plan, Run):
            hand, thing, arrays = plan.hand(), object or plan.object(), plan.arrays
        elif hasattr(plan, "arrays") and hasattr(plan, "hand"):
            hand, thing, arrays = plan.hand, object or plan.problem.object, plan.arrays()
        else:
            raise InvalidInput(f"simulate: expected a grasp plan, or the folder of a run, got {shown(plan)}")
        if thing is None:
            raise InvalidInput(
                "simulate: this plan does not know its object's shape: give object=..., a pinograsp.objects shape"
            )
        if "contact_law" not in arrays:
            raise InvalidInput("simulate: this run was written by an older version: plan it again")
        links = tuple(str(link) for link in arrays["contact_links"])
        if not all(links):
            raise InvalidInput("simulate: expected contacts of a hand; these were made without one (hand=None)")
        gravity = arrays["gravity"]
        load = np.array(arrays["load"])
        # The weight acts on the simulated object by itself. A plan that did not know its object has the given one's in
        # its load.
        load[:3] -= (float(arrays["object_mass"]) or thing.mass) * gravity
        impact = int(arrays["impact"])
        return cls(
            hand=hand,
            object=thing,
            times=arrays["times"],
            q=arrays["q"],
            dq=arrays["dq"],
            torques=arrays["torques"],
            holding_torques=arrays["holding_torques"],
            torque_limit=arrays["torque_limit"],
            impact_time=float(arrays["times"][impact]),
            final_time=float(arrays["times"][-1]),
            names=tuple(str(name) for name in arrays["contact_names"]),
            links=links,
            points_o=arrays["points_o"],
            forces_o=arrays["forces_o"][-1],
            normal_forces=arrays["normal_forces"][-1],
            depths=arrays["depth"][-1],
            mu=arrays["mu"],
            torsion=float(arrays["torsion_length"]),
            law=tuple(float(v) for v in arrays["contact_law"]),
            load=load,
            gravity_o=gravity,
        )

    def joint_of(self, link: str) -> int:
        """Pinocchio's index of the joint that carries a link (0: none, the palm)."""
        return self.hand.model.frames[self.hand.frame_id(link)].parentJoint
