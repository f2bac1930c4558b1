"""Advice of the hands' room: keywords from Python, options on the command line."""

from __future__ import annotations

import json

import pytest

from pinograsp.cli.remedies import as_options
from pinograsp.errors import HandNotLoaded
from pinograsp.hands import load_hand

HEAD = '<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
INERTIAL = '<inertial><mass value="0.1"/><inertia ixx="1e-5" iyy="1e-5" izz="1e-5" ixy="0" ixz="0" iyz="0"/></inertial>'


@pytest.mark.parametrize(
    ("said", "typed"),
    [
        ("pass trusted=True if you trust it", "pass --trusted if you trust it"),
        ("root='arm_hand' is the hand", "--root arm_hand is the hand"),
        ("root='my hand' or root='x'", "--root 'my hand' or --root x"),
        ("(packages= gives the folders)", "(--package NAME=DIR gives the folders)"),
        ("masses='estimate'; exclude=: a", "--masses estimate; --exclude LINK: a"),
        ("limits={'a': (0, 1)}, drives= gives", "from Python limits={'a': (0, 1)}, from Python drives= gives"),
        ("--root=x, hand.root=y, /a/root=z, 'root=w'", "--root=x, hand.root=y, /a/root=z, 'root=w'"),
    ],
)
def test_keywords_become_options(said, typed):
    assert as_options(said) == typed and as_options(typed) == typed


@pytest.mark.parametrize(
    ("body", "keyword", "option"),
    [
        ('<link name="$(env HOME)"/>', "trusted=True", "--trusted"),
        ('<xacro:include filename="$(find nowhere)/a.xacro"/>', "packages=", "--package NAME=DIR"),
        ('<link name="$(arg size)"/>', "xacro_args=", "--arg NAME=VALUE"),
    ],
)
def test_each_side_reads_its_own_words(tmp_path, command, body, keyword, option):
    path = tmp_path / "hand.urdf.xacro"
    path.write_text(f"{HEAD}{body}</robot>")
    with pytest.raises(HandNotLoaded) as caught:
        load_hand(path)
    assert keyword in str(caught.value) and option not in str(caught.value)
    _, _, error = command("hands", str(path))
    _, out, _ = command("hands", str(path), "--json")
    for text in (error, json.loads(out)["message"]):
        assert option in text and keyword not in text


def test_notes_are_shown_with_options(tmp_path, command):
    text, last = f'<link name="base">{INERTIAL}</link>', "base"
    for i in range(6):
        text += (
            f'<link name="link{i}">{INERTIAL}<collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision></link>'
            f'<joint name="joint{i}" type="revolute"><parent link="{last}"/><child link="link{i}"/><axis xyz="0 1 0"/>'
            '<origin xyz="0 0 0.1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>'
        )
        last = f"link{i}"
    path = tmp_path / "arm.urdf"
    path.write_text(f'<robot name="arm">{text}</robot>')
    _, out, _ = command("hands", str(path))
    assert "--root link4" in " ".join(out.split()) and "root='link4'" not in out
