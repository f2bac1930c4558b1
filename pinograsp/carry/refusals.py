"""Why there is no timing, or not this one: where, with the proof, and how fast it may be."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pinograsp.carry.cautions import doubt_path
from pinograsp.carry.constraints import PathConstraints
from pinograsp.carry.passage import Passage
from pinograsp.carry.program import CarrySolution
from pinograsp.carry.task import CarryTask
from pinograsp.errors import CarryInfeasible, CarryUndecided, PinograspError
from pinograsp.forces import ConvexSolution, diagnose, optimize_forces
from pinograsp.spatial import Array

_IMPACT = 0.9  # t_I over t_F where a force problem asks for one: how fast the hand closed does not matter any more
_TRIED = 60  # points of the path at which a proof is looked for


def refuse_timing(task: CarryTask, passage: Passage) -> PinograspError:
    """Why a given timing cannot be: where there are no forces, with the proof, and how fast it may be."""
    slow, kept = int(passage.headroom.argmin()), task.settings.reserve
    at, factor = float(passage.s[slow]), passage.factor
    where = f"at {passage.instants[slow]:.4g} s, {100 * at:.3g} % of the path"
    if over := _name_broken_limit(passage.constraints, slow, passage.level):
        turns = doubt_path(task.robot, task.path)
        remedies = "; ".join([f"{factor:.4g} times the speed is within the limits", *turns])
        text = f"{where}, this speed needs {over} (less {100 * kept:g} %); {remedies}"
        return CarryInfeasible(text, at=at, solution=passage.solution, factor=factor)
    proof = _find_proof(passage.constraints, slow, passage.level)
    if proof is None:
        return CarryUndecided(
            f"no forces were found at {100 * at:.3g} % of the path at this speed, but it is not proven that none exist",
            solution=passage.solution,
        )
    return CarryInfeasible(
        f"{where}, the grasp cannot hold the object at this speed and with this headroom (proven): {_describe(proof)}; "
        f"{factor:.4g} times the speed can be held: go slower, squeeze from other sides, keep less headroom",
        at=at,
        solution=proof,
        factor=factor,
    )


def refuse_path(constraints: PathConstraints, s: Array, found: CarrySolution) -> PinograspError:
    """Why there is no timing: where the object cannot even be held at rest, with the proof; s: of the samples (N,)."""
    for i in np.unique(np.linspace(0, len(s) - 1, min(len(s), _TRIED)).astype(int)).tolist():
        proof = _find_proof(constraints, i, 0.0)
        if proof is not None:
            return CarryInfeasible(
                f"at {100 * s[i]:.3g} % of the path the grasp cannot hold the object even at rest with this headroom "
                f"(proven): {_describe(proof)}; turn the hand less, squeeze from other sides, keep less headroom",
                at=float(s[i]),
                solution=proof,
                factor=0.0,
            )
    return CarryUndecided(
        f"no timing was found, but it is not proven that none exists: relative gap {found.gap:.1e}, balance to "
        f"{found.residual:.1e} after {found.rounds} rounds; the arm may be too weak to hold the object at rest: check "
        "its torque limits",
        solution=found,
    )


def _name_broken_limit(constraints: PathConstraints, i: int, level: float) -> str:
    """Which limit of the joints, or of the object's speed, an interval breaks at a squared speed of timed loads,
    whatever the forces; "".
    """
    slopes, names = np.abs(constraints.slopes), constraints.loaded.robot.joint_names
    fast = np.maximum(slopes[i], slopes[i + 1]) * np.sqrt(level) / constraints.arm.speed
    found = [(float(fast.max()), f"speed of {names[int(fast.argmax())]}")]
    quick = constraints.object_slopes[i : i + 2].max() * np.sqrt(level) / constraints.arm.object_speed
    found.append((float(quick), "speed of the object"))
    rows = constraints.arm_rows
    if rows.names:  # over what their limits leave of what is there at rest
        over = rows.C[i].sum(axis=1) * level + (1.0 - rows.c[i])
        found.append((float(over.max()), rows.names[int(over.argmax())]))
    share, what = max(found)
    return f"{share:.4g} times the largest {what}" if share > 1.0 else ""


def _find_proof(constraints: PathConstraints, i: int, level: float) -> ConvexSolution | None:
    """That there are no forces at a sample, at the squared speed of timed loads (0: at rest), in any scenario."""
    for one in (constraints, *constraints.others):
        grasp, of_hand = one.grasp, one.loaded.of_hand
        problem = replace(grasp.problem, min_normal_force=None, max_normal_force=grasp.most - grasp.spare)
        torques = problem.torques
        # What contacts keep to withstand disturbances is not there to bear the load.
        normals = np.column_stack([np.zeros((problem.k, 2)), grasp.spare]).ravel()
        kept = grasp.spare[:, None] * problem.contacts.rotations_oc[:, :, 2]
        if torques is not None:
            own = one.middle.torque.at_square(level)[i, of_hand]
            torques = replace(torques, bias=own + np.einsum("kxn,kx->n", torques.jacobian[:, :3], kept))
        wrench = one.middle.wrench.at_square(level)[i] - problem.contacts.G @ normals
        problem = replace(problem, load=-wrench, torques=torques)
        found = optimize_forces(problem, _IMPACT * problem.final_time, objective="peak")
        if found.infeasibility is not None:
            return found
    return None


def _describe(proof: ConvexSolution) -> str:
    """What is missing, which load and which friction would do."""
    first, *rest = diagnose(proof.problem, _IMPACT * proof.problem.final_time).text.splitlines()
    told = [first.partition(" s: ")[2].removesuffix(" (proven)")]
    told += [line.strip() for line in rest if "could be held" in line or "would suffice" in line]
    return "; ".join(told)
