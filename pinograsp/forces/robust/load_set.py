"""Sets of loads that one squeeze is to hold."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, number
from pinograsp.errors import InvalidInput
from pinograsp.spatial import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LoadSet:
    """Loads on the object that must all be held: the convex hull of several loads, and a ball around it.

    Attributes:
        loads: external wrenches (s, 6), linear first, about the centre of mass, world axes [N, N m].
        ball: largest size of an additional wrench in any direction [N; moments over the problem's moment length].

    Example:
        >>> import pinograsp as pg
        >>> ball = pg.Sphere(radius=0.03, mass=0.2)
        >>> points = [[0.03, 0, 0], [-0.015, 0.026, 0], [-0.015, -0.026, 0]]
        >>> contacts = pg.contacts_at(None, ball, points)
        >>> problem = pg.ForceProblem.holding(ball, contacts, mu=0.6)
        >>> push = [0.1, 0.1, 0.1, 0, 0, 0]  # [N, N m]
        >>> loads = pg.LoadSet.around(problem.load, mass_range=(0.9, 1.2), box=push)
        >>> print(loads.loads.shape)
        (16, 6)

    See Also:
        :func:`~pinograsp.forces.optimize_robust`, :class:`~pinograsp.forces.Reserve`.
    """

    loads: Array
    ball: float = 0.0

    __repr__ = brief()

    def __post_init__(self) -> None:
        loads = array_of("loads", self.loads, (None, 6))
        if len(loads) == 0:
            raise InvalidInput("loads: expected at least one, got none")
        object.__setattr__(self, "loads", loads)
        object.__setattr__(self, "ball", number("ball of disturbances", self.ball, at_least=0, unit="N"))

    @classmethod
    def around(
        cls,
        load: ArrayLike,
        *,
        box: ArrayLike | None = None,
        ball: float = 0.0,
        mass_range: tuple[float, float] = (1.0, 1.0),
    ) -> LoadSet:
        """Return loads around a nominal one (6,) [N, N m].

        Args:
            load: the nominal load, usually a weight.
            box: half-widths (6,) of a box of disturbances [N, N m].
            ball: radius of a ball of disturbances [N].
            mass_range: least and largest multiple of the nominal load, e.g. (0.9, 1.2).
        """
        load = array_of("load", load, (6,))
        low, high = array_of("mass range", mass_range, (2,))
        if not 0 <= low <= high:
            raise InvalidInput(f"mass range: expected 0 <= least <= largest multiple, got {low:g} and {high:g}")
        half = np.zeros(6) if box is None else array_of("box of disturbances", box, (6,))
        if np.any(half < 0):
            raise InvalidInput(f"box of disturbances: expected half-widths >= 0, got {half.tolist()}")
        corners = itertools.product(*[(-h, h) if h > 0 else (0.0,) for h in half])
        offsets = np.array(list(corners))
        scales = (low, high) if high > low else (low,)
        return cls(loads=np.concatenate([scale * load + offsets for scale in scales]), ball=ball)
