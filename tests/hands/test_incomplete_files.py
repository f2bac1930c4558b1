"""Files of others that leave something out, which is taken from what else they say; and what is said where it is not."""

import numpy as np
import pytest
import trimesh

from pinograsp.errors import HandNotLoaded, InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.geometry import hull_of, read_mesh

BOX = '<geometry><box size="0.02 0.02 0.1"/></geometry>'
MASS = '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
LIMIT = '<limit lower="-1" upper="1" effort="1" velocity="1"/>'


def link(name, *parts):
    return f'<link name="{name}">{"".join(parts)}</link>'


def joint(name, parent, child, *parts, limit=LIMIT):
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0.02 0 0"/><axis xyz="0 1 0"/>'
    return f'<joint name="{name}" type="revolute">{ends}{limit}{"".join(parts)}</joint>'


def load(folder, *parts, name="hand.urdf", **options):
    path = folder / name
    path.write_text(f'<robot name="r">{"".join(parts)}</robot>')
    return load_hand(path, **options)


def one_finger(*first, limit=LIMIT):
    return link("base"), link("a", *first), joint("j", "base", "a", limit=limit)


def test_what_is_seen_stands_for_collision_shapes_where_no_link_that_moves_has_one(tmp_path):
    seen, solid = f"<visual>{BOX}</visual>", f"<collision>{BOX}</collision>"
    hand = load(tmp_path, *one_finger(MASS, seen))
    assert hand.geometry.ngeoms == 1 and any("what is seen of the links" in note for note in hand.notes)
    # It gives masses, too.
    assert load(tmp_path, *one_finger(seen)).mass == pytest.approx(0.04)
    # A file that says what collides is believed.
    other = link("b", MASS, seen), joint("k", "base", "b")
    hand = load(tmp_path, *one_finger(MASS, solid), *other)
    assert hand.geometry.ngeoms == 1 and not any("what is seen" in note for note in hand.notes)


def test_limits_given_stand_for_those_of_the_file_that_have_no_range(tmp_path):
    parts = one_finger(MASS, limit='<limit lower="0" upper="0" effort="2" velocity="1"/>')
    with pytest.raises(HandNotLoaded, match="give limits="):
        load(tmp_path, *parts)
    hand = load(tmp_path, *parts, limits={"j": (-0.5, 0.7)})
    assert (hand.lower[0], hand.upper[0], hand.effort[0]) == (-0.5, 0.7, 2.0)
    for wrong in ((0.7, -0.5), ("a", "b"), (1.0,)):
        with pytest.raises((InvalidInput, HandNotLoaded), match="limit"):
            load(tmp_path, *parts, limits={"j": wrong})


def test_a_motor_may_turn_nothing_but_what_follows_it(tmp_path):
    motor = link("base"), link("horn"), joint("motor", "base", "horn")
    finger = link("a", MASS), joint("j", "base", "a", '<mimic joint="motor" multiplier="0.5"/>')
    hand = load(tmp_path, *motor, *finger)
    assert hand.n == 1 and hand.mass == pytest.approx(0.1)
    with pytest.raises(HandNotLoaded, match="moves no mass"):
        load(tmp_path, *motor, *one_finger(MASS)[1:])


def test_what_follows_an_unknown_joint_says_which_it_may_be(tmp_path):
    parts = link("base"), link("a", MASS), joint("knuckle_joint", "base", "a")
    followed = link("b", MASS), joint("j", "a", "b", '<mimic joint="knuckle"/>')
    hand = load(tmp_path, *parts, *followed)
    assert hand.n == 1 and any("taken as knuckle_joint" in note for note in hand.notes)
    followed = link("b", MASS), joint("j", "a", "b", '<mimic joint="knukle_joint"/>')
    with pytest.raises(HandNotLoaded, match=r"unknown joint 'knukle_joint'; is it knuckle_joint\?"):
        load(tmp_path, *parts, *followed)


def test_an_unknown_parent_is_no_loop(tmp_path):
    with pytest.raises(HandNotLoaded, match="unknown link 'world'") as error:
        load(tmp_path, *one_finger(MASS), joint("k", "world", "base"))
    assert "loop" not in str(error.value)


def test_text_with_a_dollar_is_no_expression(tmp_path):
    told = '<xacro:if value="false"><plugin name="$robot_namespace"/></xacro:if>'
    space = '<xacro:property name="unused" value="0"/>'
    path = tmp_path / "hand.urdf.xacro"
    parts = "".join(one_finger(MASS))
    path.write_text(f'<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">{space}{told}{parts}</robot>')
    assert load_hand(path).n == 1


def test_corners_may_have_any_number_of_neighbours(tmp_path):
    disc = trimesh.creation.cylinder(radius=0.02, height=0.01, sections=700)
    disc.export(tmp_path / "disc.stl")
    mesh = read_mesh(str(tmp_path / "disc.stl"))
    assert hull_of(mesh).computeVolume() == pytest.approx(disc.volume, rel=1e-6)
    assert np.ptp(np.array([hull_of(mesh).point(i) for i in range(hull_of(mesh).num_points)]), axis=0).max() < 0.0401
