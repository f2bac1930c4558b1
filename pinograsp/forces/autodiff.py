"""The optimal forces as a function of PyTorch or JAX, with the gradients of ``force_sensitivity``."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
from scipy.linalg import expm

from pinograsp.checks import instance_of
from pinograsp.contacts import ContactSet
from pinograsp.errors import ExtraMissing, InvalidInput, Status
from pinograsp.forces.optimize import optimize_forces
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.sensitivity import force_sensitivity
from pinograsp.forces.solve.program import Objective, weights_of
from pinograsp.spatial import Array, skew


def to_torch(
    problem: ForceProblem, impact_time: float, *, objective: Objective = "least_squares"
) -> Callable[..., tuple[Any, Any]]:
    """The optimal forces of a problem as a function of PyTorch tensors, with gradients.

    The function is ``solve(load=None, mu=None, points_o=None, turns_o=None)``: load (6,) [N, N m], friction (k,) [-],
    contact points (k, 3) [m], and rotation vectors in world axes by which the contact frames turn (k, 3) [rad]. What is
    not given is that of ``problem``. It returns contact forces in their frames (k, 3) [N] and the objective (), as
    doubles on the CPU. The moment length stays.

    At a kink, where a limit of a contact is about to become active or inactive, the gradient of the forces is a
    derivative to one side, with the limits that count as active there; that of the objective by the load is a
    subgradient. There are no second derivatives.

    Args:
        problem: without torque limits; with a cone, soft fingers or a pyramid of 4 edges.
        impact_time: t_I [s], as for :func:`~pinograsp.forces.optimize_forces`.
        objective: as there, with a weight of ``"least_squares"``, which determines the forces, and none of ``"peak"``.

    Raises:
        InvalidInput: from the function, an objective without that weight, or contacts that do not hold the load; from
            its gradient, what :func:`~pinograsp.forces.force_sensitivity` refuses.
        ExtraMissing: PyTorch is not installed.
    """
    try:
        import torch
        from torch.autograd.function import once_differentiable
    except ImportError as error:
        raise ExtraMissing("tensors need PyTorch: pip install 'pinograsp[torch]'") from error
    optimum = _Optimum(problem, impact_time, objective)

    class Forces(torch.autograd.Function):  # type: ignore[misc]  # checked without PyTorch
        @staticmethod
        def forward(ctx: Any, *inputs: Any) -> tuple[Any, ...]:
            arrays = (one.numpy(force=True) for one in inputs)
            forces, cost, *ctx.slopes = optimum.evaluate(*arrays, slopes=any(ctx.needs_input_grad))
            return torch.tensor(forces), torch.tensor(cost)

        @staticmethod
        @once_differentiable  # type: ignore[untyped-decorator]
        def backward(ctx: Any, by_forces: Any, by_cost: Any) -> tuple[Any, ...]:
            pairs = zip(ctx.slopes[::2], ctx.slopes[1::2])
            pull, price = by_forces.numpy(force=True), float(by_cost)
            return tuple(torch.tensor(np.tensordot(pull, dforces, 2) + price * dcost) for dforces, dcost in pairs)

    def convert(value: Any, shape: tuple[int, ...]) -> Any:
        return torch.as_tensor(value, dtype=torch.float64, device="cpu").broadcast_to(shape)

    return optimum.as_function(Forces.apply, convert)


def to_jax(
    problem: ForceProblem, impact_time: float, *, objective: Objective = "least_squares"
) -> Callable[..., tuple[Any, Any]]:
    """The same as a function of JAX, for ``grad``, ``jacfwd``, ``jit`` and ``vmap`` (one problem after the other).

    Arguments, results, gradients at kinks and errors are those of :func:`to_torch`; JAX wraps the errors of the
    function in its own. It is solved in doubles, and rounded to single numbers unless ``jax_enable_x64`` is set.
    """
    try:
        import jax
        import jax.numpy as jnp
    except ImportError as error:
        raise ExtraMissing("arrays of JAX need it: pip install 'pinograsp[jax]'") from error
    optimum = _Optimum(problem, impact_time, objective)

    def call(inputs: tuple[Any, ...], slopes: bool) -> Any:
        kind, k = jnp.result_type(float), problem.k
        shapes = [(k, 3), (), *(shape for one in inputs if slopes for shape in ((k, 3, *one.shape), one.shape))]
        results = [jax.ShapeDtypeStruct(shape, kind) for shape in shapes]

        def on_host(*values: Any) -> list[Array]:
            return [np.asarray(one, kind) for one in optimum.evaluate(*values, slopes=slopes)]

        return jax.pure_callback(on_host, results, *inputs, vmap_method="sequential")

    apply = jax.custom_jvp(lambda *inputs: tuple(call(inputs, slopes=False)))

    @apply.defjvp  # type: ignore[untyped-decorator]  # checked without JAX
    def push(inputs: Any, steps: Any) -> Any:
        forces, cost, *slopes = call(inputs, slopes=True)
        dforces = sum(jnp.tensordot(slope, step, step.ndim) for slope, step in zip(slopes[::2], steps))
        return (forces, cost), (dforces, sum(jnp.vdot(slope, step) for slope, step in zip(slopes[1::2], steps)))

    return optimum.as_function(apply, lambda value, shape: jnp.broadcast_to(jnp.asarray(value, float), shape))


class _Optimum:
    """The function in numpy."""

    def __init__(self, problem: ForceProblem, impact_time: float, objective: Objective):
        self.problem, self.impact_time = instance_of("problem", problem, ForceProblem), impact_time
        self.objective, weights = objective, weights_of(objective, problem)
        if not weights.get("least_squares"):
            raise InvalidInput(f"objective: expected a weight of 'least_squares', got {objective!r:.80}")
        self.defaults = problem.load, problem.mu, problem.contacts.points_o, np.zeros((problem.k, 3))

    def as_function(self, apply: Callable[..., Any], convert: Callable[..., Any]) -> Callable[..., tuple[Any, Any]]:
        """``apply`` with the problem's own where an input is None; ``convert(value, shape)`` makes inputs."""

        def solve(load: Any = None, mu: Any = None, points_o: Any = None, turns_o: Any = None) -> tuple[Any, Any]:
            given = zip((load, mu, points_o, turns_o), self.defaults)
            forces, cost = apply(*(convert(own.copy() if one is None else one, own.shape) for one, own in given))
            return forces, cost

        return solve

    def evaluate(self, *inputs: Any, slopes: bool) -> list[Array]:
        """Forces (k, 3) [N] and objective (); with ``slopes`` the derivatives of both by each input, in turn."""
        load, mu, points, turns = (np.array(one, dtype=float) for one in inputs)
        generators = np.zeros((len(turns), 6, 6))
        generators[:, :3, :3], generators[:, :3, 3:] = skew(turns), np.eye(3)
        # R(turn + d) = exp(J d) R(turn), and the blocks of one exponential are R and J (Van Loan 1978).
        rotations, jacobians = np.split(expm(generators)[:, :3], 2, axis=2)
        contacts = tuple(
            replace(contact, point_o=point, rotation_oc=rotation @ contact.rotation_oc)
            for contact, point, rotation in zip(self.problem.contacts, points, rotations)
        )
        moved = ContactSet(contacts=contacts, com_o=self.problem.contacts.com_o)
        problem = replace(self.problem, contacts=moved, load=load, mu=mu)
        solution = optimize_forces(problem, self.impact_time, objective=self.objective)
        if solution.status is not Status.OK or solution.certificate is None:
            raise InvalidInput(f"forces: expected contacts that hold the load, got status '{solution.status}'")
        values = [solution.forces_c, np.array(solution.certificate.objective)]
        if not slopes:
            return values
        own = force_sensitivity(solution)
        values += [own.forces_load, own.cost_load, own.forces_mu, own.cost_mu, own.forces_points, own.cost_points]
        return values + [np.einsum("...im,imn->...in", one, jacobians) for one in (own.forces_turns, own.cost_turns)]
