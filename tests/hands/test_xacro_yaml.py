"""What xacro files read from YAML files: the same as xacro itself, and nothing that is not theirs."""

from __future__ import annotations

import re

import pytest

from pinograsp.errors import HandNotLoaded
from pinograsp.hands.xacro_files import expand_xacro

HEAD = '<?xml version="1.0"?><robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">'
DATA = """
joint1: {limit: {lower: -1.5, upper: !degrees 90, velocity: !radians 2*pi}, names: [a, b]}
link0:
  mass: 0.629
  y: 1e-3
  on: yes
  reach: !millimeters 250
  inertia: &one {xx: 1.0e-4, yy: 2}
  other: {<<: *one, yy: 3}
  none:
"""


def write(folder, body, data=DATA):
    (folder / "parts").mkdir(exist_ok=True)
    (folder / "package.xml").write_text("<package><name>hand_description</name></package>")
    (folder / "parts" / "data.yaml").write_text(data)
    path = folder / "hand.urdf.xacro"
    path.write_text(
        f'{HEAD}<xacro:property name="cfg" value="${{xacro.load_yaml(\'parts/data.yaml\')}}"/>{body}</robot>'
    )
    return path


@pytest.mark.parametrize(
    "expression",
    [
        "cfg['joint1']['limit']['upper']",
        "cfg.joint1.limit.lower + 1",
        "cfg.joint1.limit.velocity",
        "cfg['joint1'].names[1]",
        "cfg.link0.y",
        "cfg.link0['mass'] * 2",
        "cfg.link0.reach",
        "cfg.link0.inertia.xx",
        "cfg.link0.other.xx + cfg.link0.other.yy",
        "cfg.link0.get('mass', 1)",
        "cfg.link0.get('volume', 1)",
        "'mass' in cfg.link0",
        "'volume' in cfg.link0",
        "cfg.link0.none is None",
        "len(cfg)",
        "'1 2 3'.split(' ')[2]",
        "'Left'.lower() + 'x'.upper()",
        "'left_hand'.startswith('left')",
        "xacro.load_yaml('$(find hand_description)/parts/$(arg file).yaml')['link0']['mass']",
        "load_yaml('parts/data.yaml')['link0']['mass']",
        "xacro.warning('a' + 'b')",
    ],
)
def test_data_is_read_as_xacro_reads_it(tmp_path, expression):
    path = write(tmp_path, f'<xacro:arg name="file" default="data"/><link name="${{{expression}}}"/>')
    assert expand_xacro(path) == expand_xacro(path, trusted=True, packages={"hand_description": tmp_path})


def test_data_goes_through_macros_and_included_files(tmp_path):
    """As Franka's descriptions do it: a file's parameter, looked at by name in another."""
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "macro.xacro").write_text(
        f'{HEAD}<xacro:macro name="body" params="name data:=^"><xacro:unless value="${{name in data}}">'
        "${xacro.warning('nothing of: ' + name)}</xacro:unless><xacro:if value=\"${name in data}\">"
        '<xacro:property name="own" value="${data[name]}" lazy_eval="false"/><mass value="${own.mass}"/></xacro:if>'
        "</xacro:macro></robot>"
    )
    body = (
        '<xacro:arg name="kind" default="macro"/><xacro:include filename="$(find hand_description)/parts/$(arg kind).xacro"/>'
        '<xacro:property name="data" value="${cfg}"/><xacro:body name="link0"/><xacro:body name="link9"/>'
    )
    text = expand_xacro(write(tmp_path, body))
    assert re.findall("<mass.*>", text) == ['<mass value="0.629"/>']


@pytest.mark.parametrize(
    "name",
    [
        "../secret.yaml",
        "/etc/hostname",
        "parts/link.yaml",
        "hand.urdf.xacro",
        "$(find other)/secret.yaml",
        "parts/../../secret.yaml",
    ],
)
def test_no_other_file_is_read(tmp_path, name):
    own = tmp_path / "own"
    own.mkdir()
    (tmp_path / "secret.yaml").write_text("key: hidden")
    path = write(own, f"<link name=\"${{load_yaml('{name}')}}\"/>")
    (own / "parts" / "link.yaml").symlink_to(tmp_path / "secret.yaml")
    with pytest.raises(HandNotLoaded, match="packages=" if "$(find other)" in name else "trusted=True") as caught:
        expand_xacro(path)
    assert "hidden" not in str(caught.value)


@pytest.mark.parametrize(
    "expression",
    [
        "cfg.__class__",
        "cfg.get.__self__",
        "cfg.pop('link0')",
        "cfg.update(cfg)",
        "cfg.link0.clear()",
        "cfg.joint1.names.append(1)",
        "'{0}'.format(cfg)",
        "cfg['link0'].keys",
        "xacro.load_yaml",
        "xacro.abs_filename('x')",
        "python.list(cfg)",
        "load_yaml('parts/data.yaml', 1)",
        "cfg.nothing",
        "str(cfg) * 100",
    ],
)
def test_data_is_looked_up_and_nothing_else(tmp_path, expression):
    with pytest.raises(HandNotLoaded):
        expand_xacro(write(tmp_path, f'<link name="${{{expression}}}"/>'))


BOMBS = {
    "objects": "a: !!python/object/apply:os.system ['touch ran']",
    "aliases": "a0: &a0 [1,1,1,1,1,1,1,1,1,1]\n"
    + "\n".join(f"a{i}: &a{i} [{f'*a{i - 1},' * 10}]" for i in range(1, 9)),
    "aliases in pairs": "a0: &a0 !!omap [x: 1]\n"
    + "\n".join(f"a{i}: &a{i} !!omap [{f'x: *a{i - 1},' * 10}]" for i in range(1, 9)),
    "a loop": "a: &a [*a]",
    "a loop of pairs": "a: &a !!omap [x: *a]",
    "depth": "a: " + "[" * 2000 + "]" * 2000,
    "length": "a: " + "x" * 90_000,
    "bytes": "a: x\n" * 100_000,
    "an expression": "a: !degrees load_yaml('data.yaml')",
    "what is no YAML": "a: [1",
    "bad bytes": "a: \x00",
}


@pytest.mark.parametrize("bomb", BOMBS)
def test_bombs_in_data_do_not_go_off(tmp_path, monkeypatch, bomb):
    monkeypatch.chdir(tmp_path)
    with pytest.raises(HandNotLoaded, match=r"load_yaml of .*data\.yaml"):
        expand_xacro(write(tmp_path, '<link name="${len(cfg)}"/>', BOMBS[bomb]))
    assert not (tmp_path / "ran").exists()


def test_merges_that_double_come_to_an_end(tmp_path):
    """PyYAML takes each key once, from 6.0.3 on; before, the file is refused."""
    data = "a0: &a0 {x: 1}\n" + "\n".join(f"a{i}: &a{i} {{<<: [*a{i - 1}, *a{i - 1}]}}" for i in range(1, 60))
    path = write(tmp_path, '<link name="x${cfg.a59.x}"/>', data)
    try:
        assert 'name="x1"' in expand_xacro(path)
    except HandNotLoaded as error:
        assert "values in a mapping" in str(error)


@pytest.mark.slow
def test_data_that_is_written_out_again_and_again_comes_to_an_end(tmp_path, monkeypatch):
    monkeypatch.setattr("pinograsp.hands.xacro_guard._MOST_TIME", 600.0)  # by its size, however slow the machine
    data = "\n".join(f"k{i}: {i}" for i in range(3000))
    with pytest.raises(HandNotLoaded, match="it expands to more than"):
        expand_xacro(write(tmp_path, f'<link name="{"${cfg}" * 1000}"/>', data))


def test_packages_that_nothing_asks_for_may_be_missing(tmp_path):
    """In a branch that is not taken, as Gazebo's in Franka's descriptions."""
    gone = "$(find gone_gazebo)/a.yaml"
    path = write(tmp_path, f'<xacro:if value="0"><a file="{gone}"/></xacro:if><link name="a"/>')
    assert 'name="a"' in expand_xacro(path)
    path = write(tmp_path, f'<a file="{gone}"/><b file="$(find gone_too)"/>')
    with pytest.raises(HandNotLoaded, match=r"find gone_gazebo.*nor of gone_too.*packages="):
        expand_xacro(path)
