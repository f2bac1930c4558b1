"""Units of mesh files: COLLADA says its own, others are guessed from the joints where they are far off."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

import pinograsp as pg
from pinograsp.errors import InvalidInput
from pinograsp.hands import load_hand
from pinograsp.hands.visuals import mesh_of, meshes_of
from pinograsp.objects.load import load_object

SIZE = (0.012, 0.02, 0.06)  # [m] of a jaw
INERTIAL = '<inertial><mass value="0.5"/><inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial>'


def write_mesh(path, unit, tag=None, up="Z_UP"):
    """A box that stands on its origin, drawn in a unit [m]."""
    box = trimesh.creation.box(np.array(SIZE) / unit)
    box.apply_translation((0, 0, SIZE[2] / 2 / unit))
    if path.suffix != ".dae":
        box.export(path)
        return
    told = f'<unit name="some" meter="{unit}"/>' if tag is None else tag
    numbers = " ".join(f"{x:.9g}" for x in box.vertices.ravel())
    path.write_text(
        f"""<?xml version="1.0"?><COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><created>2026-01-01T00:00:00Z</created><modified>2026-01-01T00:00:00Z</modified>{told}<up_axis>{up}</up_axis>
</asset><library_geometries><geometry id="g"><mesh><source id="p"><float_array id="pa" count="24">{numbers}</float_array>
<technique_common><accessor source="#pa" count="8" stride="3"><param name="X" type="float"/>
<param name="Y" type="float"/><param name="Z" type="float"/></accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices><triangles count="12">
<input semantic="VERTEX" source="#v" offset="0"/><p>{" ".join(map(str, box.faces.ravel()))}</p></triangles></mesh>
</geometry></library_geometries><library_visual_scenes><visual_scene id="s"><node id="n"><instance_geometry url="#g"/>
</node></visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/></scene></COLLADA>"""
    )


def jaws(folder, ending, unit, apart, kind="prismatic", **drawn):
    links = ""
    for name, sign in (("left", 1), ("right", -1)):
        write_mesh(folder / f"{name}{ending}", unit, **drawn)
        mesh = f'<geometry><mesh filename="{name}{ending}"/></geometry>'
        links += (
            f'<link name="{name}"><collision>{mesh}</collision><visual>{mesh}</visual></link>'
            f'<joint name="{name}_joint" type="{kind}"><parent link="base"/><child link="{name}"/>'
            f'<origin xyz="{sign * apart / 2} 0 0"/><axis xyz="{-sign} 0 0"/>'
            '<limit lower="0" upper="0.04" effort="50" velocity="1"/></joint>'
        )
    path = folder / "jaws.urdf"
    path.write_text(f'<robot name="jaws"><link name="base">{INERTIAL}</link>{links}</robot>')
    return load_hand(path)


def size_of(hand):
    shape = next(one.geometry for one in hand.geometry.geometryObjects if one.name.startswith("left"))
    shape.computeLocalAABB()
    return np.array(shape.aabb_local.max_) - np.array(shape.aabb_local.min_)


@pytest.mark.parametrize("apart", [0.0, 4e-4, 0.05])
@pytest.mark.parametrize("unit", [1, 1e-3, 0.01, 0.0254, 0.3048, 1e-6])
def test_collada_is_read_in_the_unit_that_it_says(tmp_path, unit, apart):
    hand = jaws(tmp_path, ".dae", unit, apart)
    assert size_of(hand) == pytest.approx(SIZE, rel=1e-6)
    assert hand.finger_mass("left") == pytest.approx(1000 * np.prod(SIZE), rel=1e-6)
    assert not [note for note in hand.notes if "drawn" in note or note.startswith("units")]
    # What is seen has the same size.
    (shape,) = (one for one in hand.visuals if one.link == "left")
    ((_, vertices, _),) = meshes_of([shape], 1000)[0][mesh_of(shape)]
    assert np.ptp(vertices * shape.size, axis=0) == pytest.approx(SIZE, rel=1e-6)


@pytest.mark.parametrize("tag", ["", '<unit name="meter"/>'])
def test_collada_without_a_unit_is_in_metres(tmp_path, tag):
    assert size_of(jaws(tmp_path, ".dae", 1, 0.05, tag=tag)) == pytest.approx(SIZE, rel=1e-6)


def test_collada_is_not_turned_by_its_up_axis(tmp_path):
    """As in RViz, which clears the turn that the reader of such files makes."""
    assert size_of(jaws(tmp_path, ".dae", 1e-3, 0.05, up="Y_UP")) == pytest.approx(SIZE, rel=1e-6)


@pytest.mark.parametrize("meter", ["0", "-1", "nan", "fast", "1 2", "1e300"])
def test_units_that_are_none_are_told(tmp_path, meter):
    write_mesh(tmp_path / "box.dae", 1, tag=f'<unit meter="{meter}"/>')
    with pytest.raises(InvalidInput, match="unit meter"):
        pg.Mesh.load(tmp_path / "box.dae", mass=0.1)


@pytest.mark.parametrize("ending", [".stl", ".obj", ".ply"])
@pytest.mark.parametrize(("apart", "kind"), [(0.0, "prismatic"), (0.0, "revolute"), (0.05, "prismatic")])
def test_millimetres_are_seen_where_all_joints_sit_in_one_place(tmp_path, ending, apart, kind):
    hand = jaws(tmp_path, ending, 1e-3, apart, kind)
    assert size_of(hand) == pytest.approx(SIZE, rel=1e-5)
    assert any("taken as drawn in millimetres" in note for note in hand.notes)


def test_metres_stay_metres_where_joints_are_next_to_each_other(tmp_path):
    hand = jaws(tmp_path, ".stl", 1, 4e-4)
    assert size_of(hand) == pytest.approx(SIZE, rel=1e-5) and not any("drawn" in note for note in hand.notes)


@pytest.mark.parametrize("unit", [0.01, 0.0254])
def test_other_units_of_meshes_are_told(tmp_path, unit):
    hand = jaws(tmp_path, ".stl", unit, 0.0)
    (note,) = (note for note in hand.notes if note.startswith("units"))
    assert "left" in note


@pytest.mark.parametrize("unit", [1, 1e-3, 0.01, 0.0254])
def test_objects_are_read_in_the_unit_that_collada_says(tmp_path, unit):
    write_mesh(tmp_path / "box.dae", unit)
    box = pg.Mesh.load(tmp_path / "box.dae", mass=0.1)
    assert box.volume == pytest.approx(np.prod(SIZE), rel=1e-5)
    assert pg.Mesh.load(tmp_path / "box.dae", mass=0.1, scale=2).volume == pytest.approx(8 * box.volume)
    (tmp_path / "box.urdf").write_text(
        '<robot name="box"><link name="box"><inertial><mass value="0.1"/></inertial><collision><geometry>'
        '<mesh filename="box.dae"/></geometry></collision></link></robot>'
    )
    assert load_object(tmp_path / "box.urdf").volume == pytest.approx(box.volume)
