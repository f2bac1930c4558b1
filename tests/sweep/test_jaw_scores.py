"""Jaws scored as GraspNet-1Billion scores them, on scenes in its layout whose answers are known in closed form."""

import numpy as np
import pytest
import trimesh

import pinograsp as pg
from pinograsp.sweep import DataSet, certify_files

pytest.importorskip("pyarrow")
TIP, RADIUS, WIDTH = 0.003, 0.03, 0.04  # [m]
GRID = (300, 12, 4)
# Two fingertips that are balls; the root's frame lies between them, x approaches and y closes.
FINGER = """
<link name="{side}"><inertial><mass value="0.02"/><inertia ixx="1e-6" iyy="1e-6" izz="1e-6" ixy="0" ixz="0" iyz="0"/>
</inertial><collision><geometry><sphere radius="{tip}"/></geometry></collision></link>
<joint name="{side}_joint" type="prismatic"><parent link="palm"/><child link="{side}"/><axis xyz="0 {sign} 0"/>
<limit lower="0.004" upper="0.08" effort="100" velocity="1"/>{mimic}</joint>"""
JAWS = "<robot name='balls'><link name='palm'/>{}</robot>".format(
    "".join(
        FINGER.format(side=side, sign=sign, tip=TIP, mimic=mimic)
        for side, sign, mimic in (("left", 1, ""), ("right", -1, '<mimic joint="left_joint" multiplier="1"/>'))
    )
)


def label(mu):
    """The least of 0.1, 0.2 ... 1.0 that is enough; -1 where none is."""
    steps = np.ceil(np.round(mu / 0.1, 9)) / 10
    return np.where(steps <= 1.0, np.maximum(steps, 0.1), -1.0)


def poses_of(points, offsets):
    """Rotations (..., 3, 3) and places of GraspNet's grippers, written again from its own description: views on a
    spiral, x along the view, turned about it.
    """
    i = np.arange(300)
    z = (2 * i + 1) / 300 - 1
    phi = 2 * np.pi * i * (np.sqrt(5) - 1) / 2
    views = np.column_stack([np.sqrt(1 - z**2) * np.cos(phi), np.sqrt(1 - z**2) * np.sin(phi), z])
    x = -views
    y = np.column_stack([-x[:, 1], x[:, 0], np.zeros(300)])
    y /= np.linalg.norm(y, axis=1)[:, None]
    frames = np.stack([x, y, np.cross(x, y)], axis=2)
    c, s = np.cos(offsets[..., 0]), np.sin(offsets[..., 0])
    zero, one = np.zeros_like(c), np.ones_like(c)
    turns = np.stack([one, zero, zero, zero, c, -s, zero, s, c], axis=-1).reshape(*c.shape, 3, 3)
    R = frames[None, :, None, None] @ turns
    places = points[:, None, None, None] + offsets[..., 1:2] * R[..., 0]
    return R, places


def ball(R, places):
    """tan of the angle between the closing line and the normals of balls that touch a ball."""
    along = np.einsum("...x,...x->...", places, R[..., 1])
    off = np.linalg.norm(places - along[..., None] * R[..., 1], axis=-1)
    sine = off / (RADIUS + TIP)
    return np.where(sine < 0.9, sine / np.sqrt(np.maximum(1 - sine**2, 1e-9)), np.inf)


def slab(R, places):
    """The same on a slab that is WIDTH thick along x and wide along y and z."""
    cosine = np.abs(R[..., 0, 1])
    tangent = np.sqrt(1 - cosine**2) / np.maximum(cosine, 1e-9)
    reach = (WIDTH / 2 + TIP) / np.maximum(cosine, 1e-9)
    inside = (np.abs(places) < [0.01, 0.05, 0.05]).all(axis=-1) & (reach < 0.07)
    return np.where(inside, tangent * (WIDTH + 2 * TIP) / WIDTH, np.inf)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "answer", "share"), [("ball", ball, 0.04), ("slab", slab, 0.1)])
def test_scores_are_within_a_step_of_known_answers(tmp_path, name, answer, share):
    rng, objects = np.random.default_rng(6), tmp_path / "objects"
    objects.mkdir()
    trimesh.creation.icosphere(subdivisions=5, radius=RADIUS).export(objects / "ball.obj")
    trimesh.creation.box((WIDTH, 0.3, 0.3)).export(objects / "slab.obj")
    (tmp_path / "jaws.urdf").write_text(JAWS)
    points = rng.uniform(-0.02, 0.02, size=(3, 3))
    angles = np.broadcast_to(np.pi / 12 * np.arange(12)[None, None, :, None], (3, *GRID))
    depths = np.broadcast_to(np.array([0.01, 0.02, 0.03, 0.04]), (3, *GRID))
    offsets = np.stack([angles, depths, np.full((3, *GRID), 0.1)], axis=-1)
    mu = answer(*poses_of(points, offsets))
    scores = label(mu)
    kept = (scores > 0) & (rng.random(scores.shape) < share)
    scores = np.where(kept, scores, -1.0)
    path = tmp_path / f"{name}_labels.npz"
    np.savez(path, points=points, offsets=offsets, scores=scores, collision=np.zeros(scores.shape, dtype=bool))
    data = DataSet(
        files=[path],
        hand=pg.load_hand(tmp_path / "jaws.urdf"),
        objects=objects,
        format="graspnet",
        mass=0.1,
        palm_in_root=np.eye(4),
    )
    done = certify_files(data, tmp_path / "out", pg.GraspConditions(mu=1.0), jobs=1, progress=False)
    assert not done.faults, done.faults
    table = done.table()
    found = label(table["antipodal_mu"].to_numpy())
    expected = scores[kept]
    assert len(found) == len(expected) > 500
    assert len(np.unique(expected)) >= 8
    # None is the step after 1.0.
    close = np.abs(np.where(found > 0, found, 1.1) - expected) < 0.1 + 1e-9
    assert close.mean() >= 0.99
    assert (found == expected).mean() > 0.8  # facets of 2 mm turn normals by a degree
