"""Objects that jaws push: by the compiled core as without it, and to where nothing overlaps."""

import secrets

import numpy as np
import pinocchio as pin

import pinograsp as pg
from pinograsp.contacts import clearance, close_hand
from pinograsp.contacts.advance import PreparedClosing
from pinograsp.errors import InvalidInput
from pinograsp.spatial import pose_of

TIPS = np.array([0.0, 0.0, 0.1034])  # between the Panda's fingertips
TOUCH = 2e-7  # [m] a little more than a gap that counts as touching


def test_the_core_pushes_as_the_exact_method():
    seed = secrets.randbelow(10**9)
    rng = np.random.default_rng(seed)
    hand = pg.load_hand("panda")
    pushed = closed = alike = 0
    for body in (
        pg.Box(size=(0.03, 0.025, 0.05), mass=0.1),
        pg.Cylinder(radius=0.018, height=0.06, mass=0.1),
        pg.Ellipsoid(semi_axes=(0.015, 0.02, 0.03), mass=0.1),
    ):
        compiled, plain = PreparedClosing(hand, body), PreparedClosing(hand, body)
        plain.pushing = None
        for _ in range(10):
            there = body.placed(pose_of(TIPS + rng.uniform(-0.008, 0.008, 3), pin.exp3(rng.normal(size=3))))
            try:
                first, other = (close_hand(hand, there, prepared=one) for one in (compiled, plain))
            except InvalidInput:  # it overlaps the open hand
                continue
            assert clearance(first.hand, first.object, first.q) > -TOUCH, f"seed {seed}"
            moved = np.linalg.norm(first.object.com_o - other.object.com_o)
            closed += 1
            pushed += not np.array_equal(other.pushed, np.eye(4))
            # Where a face is turned over an edge, the last digit decides which way.
            alike += bool(moved < 1e-3 and {t.link for t in first.touches} == {t.link for t in other.touches})
    assert pushed >= 3 and alike >= 0.6 * closed, f"seed {seed}: {alike} of {closed} alike, {pushed} pushed"
