"""The solids of a scene: links as they are seen, their collision shapes, and the object."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from pinograsp.checks import brief
from pinograsp.hands.geometry import PRIMITIVES, Shape
from pinograsp.hands.model import HandModel
from pinograsp.hands.visuals import MeshKey, Part, mean_colour, mesh_of, meshes_of, share
from pinograsp.objects.body import Body
from pinograsp.spatial import Array, IntArray
from pinograsp.viz.raster import Surface
from pinograsp.viz.scene_meshes import LINK, OBJECT, PALM, paint, rgb, split_creases, triangulate

# When a solid is drawn: always, or with the hand as it is seen, or with its collision shapes in place of that.
Look: TypeAlias = Literal["always", "visual", "collision"]

_TINT = 0.45  # share of its contact's colour that a touching link takes
_MARKER = 2e-3  # [m] of shapes that mark a frame, and would be specks in a picture
_DARKEST, _BRIGHTEST = 42, 236  # of 255, for what descriptions call black and white
_MOST = 60_000  # triangles of a hand: what a page can hold, and any browser draws


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Solid:
    """A rigid part of the scene.

    Attributes:
        name: for display.
        link: index into ``ViewScene.link_poses``; None: the object.
        vertices: in the frame of the link or the object (n, 3) [m].
        faces: (m, 3).
        colour: ``#rrggbb``.
        look: when it is drawn.
    """

    name: str
    link: int | None
    vertices: Array
    faces: IntArray
    colour: str
    look: Look = "always"

    __repr__ = brief()


class Links:
    """Placements of the joints that carry what is drawn."""

    def __init__(self, hand: HandModel):
        self.hand = hand
        frames = [hand.model.frames[one.parentFrame] for one in hand.geometry.geometryObjects]
        frames += [hand.model.frames[hand.frame_id(one.link)] for one in hand.visuals]
        first = {frame.parentJoint: frame for frame in reversed(frames)}
        self.index = {joint: i for i, joint in enumerate(first)}
        self.names = [frame.name for frame in first.values()]
        self.back = np.array([frame.placement.inverse().homogeneous for frame in first.values()]).reshape(-1, 4, 4)

    def poses(self, q: Array) -> Array:
        """(f, l, 7) at q (f, n)."""
        return to_sevens(self.hand.frame_placements(q, self.names) @ self.back)


def to_sevens(poses: Array) -> Array:
    """Placements (..., 4, 4) as positions and quaternions w, x, y, z (..., 7)."""
    quaternions = Rotation.from_matrix(poses[..., :3, :3].reshape(-1, 3, 3)).as_quat()[:, [3, 0, 1, 2]]
    return np.concatenate([poses[..., :3, 3], quaternions.reshape(*poses.shape[:-2], 4)], axis=-1)


def make_solids(
    hand: HandModel, body: Body | None, links: Links, touching: dict[str, str]
) -> tuple[tuple[Solid, ...], list[str]]:
    """Triangles and colours of the hand's links and of the object, and what cannot be shown, in words.

    Links are shown as they are seen. Moving parts of which nothing is seen show their collision shapes.

    Args:
        hand: with its visuals, if there are any.
        body: the object.
        links: of the hand.
        touching: colours of contacts by link.
    """
    meshes, problems = meshes_of(hand.visuals, _MOST)
    seen = [one for one in hand.visuals if (mesh_of(one) in meshes if one.kind == "mesh" else max(one.size) > _MARKER)]
    visuals = [*_visuals(hand, seen, meshes, links, touching)]
    shown = {solid.link for solid in visuals}
    solids = _each_once(visuals, [*_collision_shapes(hand, links, touching, shown)])
    if body is not None:
        vertices, faces = triangulate(body.collision_geometry)
        vertices = vertices @ body.shape_b[:3, :3].T + body.com_b
        solids.append(Solid(name="object", link=None, vertices=vertices, faces=faces, colour=OBJECT))
    cautions = (
        [f"collision shapes are shown where there is nothing else: {'; '.join(problems[:5])}"] if problems else []
    )
    return tuple(solids), cautions


def _each_once(visuals: Sequence[Solid], shapes: Sequence[Solid]) -> list[Solid]:
    """What is seen and the collision shapes; those that are the same solid only once, in its own colour."""
    colours = {(one.link, one.vertices.tobytes()): one.colour for one in visuals}
    same = {place for one in shapes if (place := (one.link, one.vertices.tobytes())) in colours}
    return [
        *(one for one in visuals if (one.link, one.vertices.tobytes()) not in same),
        *(
            replace(one, colour=colours[place], look="always")
            if (place := (one.link, one.vertices.tobytes())) in same
            else one
            for one in shapes
        ),
    ]


def _visuals(
    hand: HandModel,
    shapes: Sequence[Shape],
    meshes: dict[MeshKey, tuple[Part, ...]],
    links: Links,
    touching: dict[str, str],
) -> Iterator[Solid]:
    """What is seen of the hand; ``meshes``: as :func:`meshes_of` has them."""
    frames = [hand.model.frames[hand.frame_id(shape.link)] for shape in shapes]
    own = {frame.name for frame in frames}
    tints = {link: colour for link, colour in touching.items() if link in own}
    by_joint = {  # of contacts on links of which nothing is seen: what moves with them
        hand.model.frames[hand.frame_id(link)].parentJoint: colour
        for link, colour in touching.items()
        if link not in own and hand.model.existFrame(link)
    }
    for i, (shape, frame) in enumerate(zip(shapes, frames)):
        parts = (
            meshes[mesh_of(shape)]
            if shape.kind == "mesh"
            else [(mean_colour(shape), *triangulate(PRIMITIVES[shape.kind](*shape.size)))]
        )
        at, joint = frame.placement * shape.placement, frame.parentJoint
        tint = tints.get(frame.name) or by_joint.get(joint)
        for painted, vertices, faces in parts:
            if shape.kind == "mesh":
                faces = faces[:, ::-1] if np.prod(shape.size) < 0 else faces
                vertices, faces = split_creases(vertices * shape.size, faces)
            natural = painted or shape.colour
            colour = _display(natural) if natural else LINK if joint else PALM
            yield Solid(
                name=f"{shape.link} seen {i}",
                link=links.index[joint],
                vertices=vertices @ at.rotation.T + at.translation,
                faces=faces,
                colour=_mix(colour, tint) if tint else colour,
                look="visual",
            )


def _collision_shapes(
    hand: HandModel, links: Links, touching: dict[str, str], shown: set[int | None]
) -> Iterator[Solid]:
    """Collision shapes; ``shown``: links that are seen without them.

    Where they stand for what is seen, the links' own meshes show more than their hulls.
    """
    objects = list(hand.geometry.geometryObjects)
    own = hand.own_shapes or [one.geometry for one in objects]
    shapes = [one.geometry if links.index[one.parentJoint] in shown else shape for one, shape in zip(objects, own)]
    sizes = [getattr(shape, "num_tris", 0) for shape in shapes]
    most = share(sizes, [1] * len(sizes), _MOST)
    for one, shape in zip(objects, shapes):
        vertices, faces = triangulate(shape, most)
        frame = hand.model.frames[one.parentFrame]
        colour = LINK if one.parentJoint else PALM
        link = links.index[one.parentJoint]
        yield Solid(
            name=one.name,
            link=link,
            faces=faces,
            colour=_mix(colour, touching[frame.name]) if frame.name in touching else colour,
            vertices=vertices @ one.placement.rotation.T + one.placement.translation,
            look="collision" if link in shown else "always",
        )


def _display(colour: str) -> str:
    """A colour of a description, neither so dark nor so bright that shading is lost."""
    return _hex(_DARKEST + (_BRIGHTEST - _DARKEST) / 255 * rgb(colour))


def _hex(values: ArrayLike) -> str:
    return "#" + "".join(f"{round(value):02X}" for value in np.ravel(values))


def _mix(colour: str, other: str) -> str:
    return _hex((1 - _TINT) * rgb(colour) + _TINT * rgb(other))


def place_solid(solid: Solid, pose: Array) -> Array:
    """Vertices (n, 3) of a solid whose frame is at ``pose`` (7,) [m]."""
    turned: Array = Rotation.from_quat(pose[[4, 5, 6, 3]]).apply(solid.vertices)
    return turned + pose[:3]


def make_surfaces(
    solids: Sequence[Solid], link_poses: Array, object_pose: Array | None
) -> tuple[list[Surface], list[Surface]]:
    """Hand and object where they are at one instant: poses of the links (l, 7), and of the object (7,)."""
    hand, thing = list[Surface](), list[Surface]()
    for solid in solids:
        pose = object_pose if solid.link is None else link_poses[solid.link]
        if pose is not None:
            surface = Surface(place_solid(solid, pose), solid.faces, paint(solid.colour))
            (thing if solid.link is None else hand).append(surface)
    return hand, thing


def sample_cloud(solids: Sequence[Solid], link_poses: Array, object_pose: Array | None) -> Array:
    """Some vertices of all solids at one instant (n, 3) [m], which show the size of the scene."""
    clouds = [np.zeros((0, 3))]
    for solid in solids:
        pose = object_pose if solid.link is None else link_poses[solid.link]
        if pose is not None:
            few = replace(solid, vertices=solid.vertices[:: 1 + len(solid.vertices) // 500])
            clouds.append(place_solid(few, pose))
    return np.concatenate(clouds)
