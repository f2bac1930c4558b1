"""The numbers that steer rounds within rounds, as a closed hand's press and its rest are worked out."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class PressRounds:
    """How long is searched for a press, and when it is good enough.

    Attributes:
        knots: depths at which the joints are solved for: their course over the depth is smooth.
        newton_steps: at one of these depths.
        halvings: of such a step that leads too far.
        well: share of their depth to which surfaces are brought [-].
        as_planned: share of the forces that a force at rest may be off [-].
        depths: rounds by other depths.
        depth_gain: what such a round has to gain, over what is left [-].
        astray: how many of them may gain less.
        longer: how much longer a step to other depths may be than the one before.
        shifts: rounds by another shift of the object.
        shift_gain: what such a round has to gain, over what is left [-].
        furthest: the furthest that it moves the object, in shifts that cost 1.
        shorter: how much shorter the next one is where it led astray.
    """

    knots: int = 5
    newton_steps: int = 15
    halvings: int = 3
    well: float = 2e-4
    as_planned: float = 0.01
    depths: int = 6
    depth_gain: float = 0.1
    astray: int = 2
    longer: float = 2.0
    shifts: int = 2
    shift_gain: float = 0.5
    furthest: float = 10.0
    shorter: float = 3.0


@dataclass(frozen=True, slots=True, kw_only=True)
class RestRounds:
    """How a rest is looked for as the object is let go.

    Attributes:
        parts: steps of the sliding between two known depths.
        stages: steps of the support as it fades.
        rounds: in each of these, with cones of other sizes.
        steps: Newton steps to the least energy.
        halvings: of each.
        full_steps: Newton steps with all that changes.
        left: share of the imbalance that one of these may leave [-].
        quick: share from which on the next one needs a stiffness of its own [-].
        balanced: what is left of the forces at a rest, as a share [-].
        nearly: share that a rest may leave [-].
    """

    parts: int = 2
    stages: int = 2
    rounds: int = 20
    steps: int = 30
    halvings: int = 25
    full_steps: int = 10
    left: float = 0.5
    quick: float = 0.1
    balanced: float = 1e-6
    nearly: float = 1e-2


# Weighed in benchmarks/grasps.py, whose column ``error`` is how far simulated forces are off the planned ones, against
# the time in benchmarks/motion.py, whose column ``presses`` counts the rounds by other depths and shifts.
PRESS = PressRounds()
# As above, by the column ``foreseen``, how far simulated forces are off the rest that is worked out here: with more
# parts or stages normal forces at rest change by less than 0.001 of themselves in nine of ten grasps (of 48), and by
# 0.006 and 0.009 at most.
REST = RestRounds()
