"""Fingers that would start through each other."""

from dataclasses import replace

import numpy as np
import pytest
from own_hands import joint, link, robot

from pinograsp import load_hand
from pinograsp.contacts.self_collision import SelfCollisions
from pinograsp.synthesis import prepared_hand
from pinograsp.synthesis.preshapes import rest_of


@pytest.fixture
def crossing(tmp_path):
    """A hand with a thumb and two fingers that can be spread until they cross."""
    finger, close = ("box 0.012 0.014 0.07", "0 0 0.035"), "-0.6 0.6 5 3"
    parts = [
        link("palm", 0.3, "box 0.09 0.09 0.02"),
        link("thumb", 0.03, *finger),
        joint("thumb_close", "palm", "thumb", "-0.035 0 0.01", "0 1 0", close),
    ]
    for name, y in (("index", -0.02), ("middle", 0.02)):
        parts += [
            link(f"{name}_base", 0.02, "box 0.012 0.012 0.012"),
            joint(f"{name}_spread", "palm", f"{name}_base", f"0.035 {y} 0.016", "1 0 0", "-1 1 5 3"),
            link(name, 0.03, *finger),
            joint(f"{name}_close", f"{name}_base", name, "0 0 0.006", "0 -1 0", close),
        ]
    path = tmp_path / "crossing.urdf"
    path.write_text(robot("crossing", *parts), encoding="utf-8")
    return load_hand(path)


@pytest.mark.parametrize("crossed", [0.3, 1.0])
def test_hands_do_not_start_with_fingers_through_each_other_where_others_are_clear(crossing, monkeypatch, crossed):
    spread = [crossing.joint_names.index(f"{name}_spread") for name in ("index", "middle")]
    collisions = SelfCollisions(crossing)

    def draw(hand, rng, **options):
        shapes = drawn(hand, rng, **options)[:60]
        cross = int(crossed * len(shapes))
        for i, shape in enumerate(shapes[:cross]):
            opened = np.array(shape.opened)
            opened[spread] = [-0.4, 0.4]
            shapes[i] = replace(shape, opened=opened)
        return shapes

    drawn = prepared_hand.preshapes
    monkeypatch.setattr(prepared_hand, "preshapes", draw)
    monkeypatch.setattr(prepared_hand, "_usable", lambda hand, shapes: shapes)
    prepared = prepared_hand.prepare_hand.__wrapped__(crossing, None)
    through = [bool(collisions.between(rest_of(crossing), one.opened)) for one in prepared.preshapes]
    if crossed < 0.5:
        assert prepared.parts and not any(through)
    else:  # by design, as far as one can know: better than none
        assert not prepared.parts and all(through)
