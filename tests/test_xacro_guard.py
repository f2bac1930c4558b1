"""A stranger's xacro may compute, and nothing else."""

from __future__ import annotations

import os

import pytest

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.xacro_guard import expand_xacro

HEAD = '<?xml version="1.0"?><robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'


def write(folder, body, name="hand.urdf.xacro", head=HEAD):
    path = folder / name
    path.write_text(f"{head}{body}</robot>")
    return path


def test_arithmetic_properties_macros_arguments_and_conditions_work(tmp_path):
    path = write(
        tmp_path,
        """<xacro:arg name="n" default="0"/><xacro:property name="n" value="$(arg n)"/>
        <xacro:property name="a" value="${pi/2}"/>
        <xacro:macro name="m" params="x y:=3"><link name="l${x}" v="${max(x, y)*sin(a)**2 - math.floor(1.5)}"/></xacro:macro>
        <xacro:if value="${n > 1}"><xacro:m x="1"/></xacro:if>""",
    )
    text = expand_xacro(path, {"n": 5})
    assert 'name="l1"' in text and 'v="2.0"' in text


def test_includes_from_the_own_folder_work(tmp_path):
    (tmp_path / "parts").mkdir()
    write(tmp_path / "parts", '<link name="inner"/>', "part.xacro")
    path = write(tmp_path, '<xacro:include filename="parts/part.xacro"/>')
    assert 'name="inner"' in expand_xacro(path)


@pytest.fixture
def secret(tmp_path):
    outside = tmp_path / "outside"
    outside.mkdir()
    (outside / "secret.yaml").write_text("key: hidden")
    write(outside, '<link name="hidden"/>', "secret.xacro")
    inside = tmp_path / "inside"
    inside.mkdir()
    return inside


@pytest.mark.parametrize(
    "body",
    [
        '<link name="${load_yaml(\'../outside/secret.yaml\')[\'key\']}"/>',
        '<link name="${xacro.load_yaml(\'../outside/secret.yaml\')}"/>',
        '<xacro:property name="f" value="${load_yaml}"/><link name="${f(\'../outside/secret.yaml\')}"/>',
        '<xacro:property name="f" value="${xacro}"/><link name="a"/>',
        '<link name="${python.map(str, [1])}"/>',
        '<link name="${().__class__}"/>',
        '<link name="${[x for x in [1]]}"/>',
        '<link name="${(lambda: 1)()}"/>',
        "<link name=\"${'%c{load_yaml(1)}' % 36}\"/>",
        '<link name="$(env HOME)"/>',
        '<link name="$(optenv HOME x)"/>',
        '<link name="$(eval 1+1)"/>',
        '<link name="$(find pkg)"/>',
        '<link name="$(dirname)"/>',
        '<link name="$(cwd)"/>',
        '<link name="$${load_yaml(1)}"/>',
        '<link name="a $ b"/>',
        "<xacro:property name=\"d\" value=\"${'$'}\"/><link name=\"a\"/>",
        '<link name="&#36;{load_yaml(1)}"/>',
        "<link name=\"a\">${load_yaml('x')}</link>",
        '<xacro:macro name="m" params="x:=${load_yaml(1)}"><link name="a"/></xacro:macro>',
        '<xacro:include filename="../outside/secret.xacro"/>',
        '<xacro:include filename="${f}"/>',
        '<xacro:include filename="*.xacro"/>',
        '<xacro:include filename="/etc/hostname"/>',
        '<xacro:include filename="link.xacro"/>',
        "<xacro:call macro=\"${xacro.print_location()}\"/>",
    ],
)
def test_anything_more_is_refused_before_it_runs(secret, body):
    (secret / "link.xacro").symlink_to(secret.parent / "outside" / "secret.xacro")
    path = write(secret, body)
    with pytest.raises(HandNotLoaded, match="trusted=True"):
        expand_xacro(path)


def test_included_files_are_scanned_too(tmp_path):
    write(tmp_path, '<link name="$(env HOME)"/>', "part.xacro")
    path = write(tmp_path, '<xacro:include filename="part.xacro"/>')
    with pytest.raises(HandNotLoaded, match=r"part\.xacro"):
        expand_xacro(path)


def test_entities_are_refused(tmp_path):
    head = '<?xml version="1.0"?><!DOCTYPE robot [<!ENTITY e "x">]><robot name="r">'
    with pytest.raises(HandNotLoaded, match="entity"):
        expand_xacro(write(tmp_path, "", head=head))


def test_a_trusted_file_may_do_all_that_xacro_does(tmp_path, monkeypatch):
    monkeypatch.setitem(os.environ, "PINOGRASP_TEST", "from_environment")
    path = write(tmp_path, '<link name="$(env PINOGRASP_TEST)"/>')
    assert "from_environment" in expand_xacro(path, trusted=True)


@pytest.mark.parametrize(
    "body", ["<unclosed>", '<link name="${unknown}"/>', '<xacro:nothing/>', '<xacro:include filename="gone.xacro"/>']
)
def test_broken_files_are_named(tmp_path, body):
    with pytest.raises(HandNotLoaded):
        expand_xacro(write(tmp_path, body))
