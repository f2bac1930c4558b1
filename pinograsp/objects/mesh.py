"""Solids bounded by triangles."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, items_of, number, one_line, read_only
from pinograsp.errors import InvalidInput
from pinograsp.objects.body import Body
from pinograsp.objects.decomposition import ConvexParts, convex_parts
from pinograsp.objects.mesh_checks import convex_surface, is_convex
from pinograsp.objects.mesh_files import mesh_files, read_regions, read_surface
from pinograsp.objects.mesh_union import concatenate, convex_pieces, one_of_several, one_solid
from pinograsp.objects.triangles import TriangleSurface
from pinograsp.spatial import Array, IntArray, pose_of

if TYPE_CHECKING:
    import coal
    from typing_extensions import Unpack

    from pinograsp.objects.body import BodyArguments

# Default radius of the curvature fit, in typical heights of the triangles: smaller radii see the facets, larger ones
# more than the curvature at the point. Of 2.5 to 6, this has the smallest largest error on spheres and ellipsoids.
_FIT_HEIGHTS = 3.0
_OUTSIDE = 1e-3  # [m] by which a centre of mass may lie outside the bounding box: files have few digits


@dataclass(slots=True)
class _Derived:
    """What follows from a mesh's surface and is kept with it; None until it is asked for.

    Vertices count from the centre of mass here, since far from the origin integrals and distances would lose digits.
    """

    shape_b: Array = field(default_factory=lambda: np.eye(4))
    vertices_s: Array = field(default_factory=lambda: np.zeros((0, 3)))
    volume: float = 0.0
    radius: float = 0.0
    inertia_per_mass: Array = field(default_factory=lambda: np.zeros((3, 3)))
    surface: TriangleSurface | None = None
    collision: coal.CollisionGeometry | None = None
    fit_radius: float | None = None
    fills_hull: bool | None = None
    parts: ConvexParts | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mesh(Body):
    """A solid bounded by a closed surface of triangles, or the convex hull of one.

    The body frame is that of the vertices, as in the file.

    Vertices within 1e-8 m are merged. Small holes, as in scans (at most 0.2 % of the surface), are closed, and a mesh
    that is inside out is inverted; ``notes`` say so. Parts that meet, such as those of a convex decomposition, become
    one solid, their union (needs the extra ``mesh``), with a note. Surfaces that are open, wound inconsistently or
    without volume are rejected, unless you ask for the hull. A part that crosses itself is not detected.

    :meth:`project`: on a face the normal is the face's. On an edge or a corner it is the direction between the point
    and its nearest surface point, and for a point on the edge itself the mean of the faces' that meet there (weighted
    by their angles).

    Attributes:
        vertices: (n, 3) in the body frame [m].
        faces: (m, 3) indices into the vertices, counter-clockwise seen from outside.
        convex: whether to take the convex hull.
        com: the centre of mass (3,) in the body frame [m], if it was measured; None: that of a homogeneous solid, see
            :attr:`com_b`.
        mass, density, pose, inertia, notes, shape_pose: see :class:`~pinograsp.objects.body.Body`.

    Example:
        >>> import trimesh
        >>> import pinograsp as pg
        >>> _ = trimesh.creation.box((40, 60, 100)).export("block.stl")  # in millimetres
        >>> block = pg.Mesh.load("block.stl", scale=1e-3, mass=0.2)
        >>> print(f"{len(block.faces)} triangles, {block.density:.0f} kg/m^3")
        12 triangles, 833 kg/m^3

    See Also:
        :class:`~pinograsp.objects.Box` and the other exact shapes; :func:`~pinograsp.objects.load_object` reads URDF,
        SDF and MJCF files.
    """

    vertices: Array
    faces: IntArray
    convex: bool = False
    com: Array | None = field(default=None, repr=False)
    _derived: _Derived = field(init=False, repr=False, default_factory=lambda: _Derived())

    if TYPE_CHECKING:  # arguments may be lists, attributes are arrays

        def __init__(
            self,
            *,
            vertices: ArrayLike,
            faces: ArrayLike,
            convex: bool = ...,
            com: ArrayLike | None = ...,
            **body: Unpack[BodyArguments],
        ) -> None: ...

    __repr__ = brief()

    @classmethod
    def load(
        cls,
        path: str | Path | Sequence[str | Path],
        *,
        scale: float = 1.0,
        mass: float | None = None,
        density: float | None = None,
        convex: bool = False,
        pose: ArrayLike | None = None,
    ) -> Mesh:
        """Load the mesh in a file: STL, OBJ, PLY, GLB, OFF or DAE; the parts of a scene make one solid.

        Several files are the parts of one object in the same frame, as in a convex decomposition; they become one
        solid, their union (needs the extra ``mesh``).

        Args:
            path: a file, a folder of mesh files, a pattern of them (``parts/*.obj``), or a sequence of files.
            scale: metres per unit of the file (0.001 for millimetres). A COLLADA file states its unit and is read in
                metres; for it, a factor on the size.
            mass, density, convex, pose: see the class.

        Raises:
            InvalidInput: no such file, not a mesh, or a mesh that the class rejects.
        """
        scale = number("mesh scale", scale, above=0)
        paths = mesh_files(path)
        given: dict[str, Any] = {"mass": mass, "density": density, "pose": pose}
        given = {name: value for name, value in given.items() if value is not None}
        surfaces = {str(one): (scale * vertices, faces) for one in paths for vertices, faces in [read_surface(one)]}
        if len(surfaces) == 1:
            ((vertices, faces),) = surfaces.values()
        elif convex:
            vertices, faces = concatenate(surfaces.values())
        else:
            vertices, faces, given["notes"] = one_of_several(surfaces)
        try:
            mesh = cls(vertices=vertices, faces=faces, convex=convex, **given)
        except InvalidInput as error:
            rest = f" and {len(paths) - 1} more" if len(paths) > 1 else ""
            raise InvalidInput(f"mesh file '{paths[0]}'{rest}: {error}") from None
        if len(paths) == 1:
            mesh._set(regions={name: scale * box for name, box in read_regions(paths[0]).items()})
        if not convex and (pieces := convex_pieces(surfaces.values())):
            mesh._derived.parts = ConvexParts(tuple(read_only(corners - mesh.com_b) for corners in pieces), 0.0)
        return mesh

    @property
    def shape_b(self) -> Array:
        """bMs (4, 4): the body's axes at the centre of mass, in the body frame [m]."""
        return self._derived.shape_b

    @property
    def _across(self) -> float:
        return float(np.ptp(self.vertices, axis=0).max())

    def _check_shape(self) -> None:
        from trimesh.triangles import mass_properties

        flag("mesh convex", self.convex)
        notes: tuple[str, ...] = ()
        if self.convex:
            vertices, faces = convex_surface(self.vertices, self.faces)
        else:
            vertices, faces, notes = one_solid(self.vertices, self.faces)
        # Integrals over a far-off origin would lose digits: first to the middle, then to the centre of mass.
        middle = (vertices.min(axis=0) + vertices.max(axis=0)) / 2
        if self.com is None:
            centre = middle + mass_properties((vertices - middle)[faces], skip_inertia=True).center_mass
        else:
            centre = array_of("mesh com", self.com, (3,))
            low, high = vertices.min(axis=0), vertices.max(axis=0)
            if np.any(centre < low - _OUTSIDE) or np.any(centre > high + _OUTSIDE):
                raise InvalidInput(
                    f"mesh com: expected a centre of mass within the solid, {low.round(4).tolist()} to "
                    f"{high.round(4).tolist()} m, got {centre.round(4).tolist()}: are frame and units right? With "
                    "density= alone it is that of a homogeneous solid"
                )
            self._set(com=centre)
        vertices_s = vertices - centre
        properties = mass_properties(vertices_s[faces], center_mass=np.zeros(3))
        self._derived.shape_b = read_only(pose_of(centre))
        self._derived.vertices_s = read_only(vertices_s)
        self._derived.radius = float(np.linalg.norm(vertices_s, axis=1).max())
        self._derived.volume = float(properties.volume)
        self._derived.inertia_per_mass = np.asarray(properties.inertia) / properties.volume
        self._set(
            vertices=read_only(vertices),
            faces=read_only(faces),
            convex=bool(self.convex),
            notes=(*items_of("notes", self.notes, str), *notes),
        )

    @property
    def volume(self) -> float:
        """[m^3]."""
        return self._derived.volume

    @property
    def _inertia_per_mass(self) -> Array:
        return self._derived.inertia_per_mass

    @property
    def bounding_radius(self) -> float:
        """Largest distance of a surface point from the centre of mass [m]."""
        return self._derived.radius

    @property
    def collision_geometry(self) -> coal.CollisionGeometry:
        """A ``coal.Convex`` of a convex hull, otherwise a ``coal.BVHModelOBBRSS``, in the shape's own frame.

        The latter is a surface: a body inside it does not collide.
        """
        if self._derived.collision is None:
            from pinograsp.hands.mesh_file import collision_model  # with coal and Pinocchio, slow to import

            try:
                model = collision_model(self._derived.vertices_s, self.faces)
                if self.convex:
                    model.buildConvexRepresentation(False)
                    model = model.convex
            except (RuntimeError, ValueError) as error:
                raise InvalidInput(
                    f"mesh: coal, the collision library, rejects its {len(self.faces)} triangles ({one_line(error)}): "
                    "repair or simplify it (MeshLab, Blender), or use its convex hull: convex=True"
                ) from error
            self._derived.collision = model
        return self._derived.collision

    @property
    def convex_parts(self) -> ConvexParts:
        """Convex parts that together approximate the solid, in the shape's own frame, and their error.

        If the files are convex parts, as in a decomposition, these are used. Otherwise the parts are computed, always
        the same for the same mesh. This takes seconds, once, or a minute if the surface crosses itself, and needs the
        extra ``mesh``.

        Raises:
            ExtraMissing: coacd (extra ``mesh``) is not installed.
            InvalidInput: the surface crosses itself over much of its area.
        """
        if self._derived.parts is None:
            vertices = self._derived.vertices_s
            one = ConvexParts((vertices,), 0.0)
            self._derived.parts = one if self.convex else convex_parts(vertices, self.faces, self.surface)
        return self._derived.parts

    @property
    def fills_hull(self) -> bool:
        """Whether the surface is that of its convex hull, up to a thousandth of the volume."""
        if self._derived.fills_hull is None:
            self._derived.fills_hull = self.convex or is_convex(self._derived.vertices_s, self.faces)
        return self._derived.fills_hull

    @property
    def surface(self) -> TriangleSurface:
        """Its triangles, in the shape's own frame."""
        if self._derived.surface is None:
            self._derived.surface = TriangleSurface(self._derived.vertices_s, self.faces)
        return self._derived.surface

    def curvature(self, points_o: ArrayLike, radius: float | None = None) -> tuple[Array, Array]:
        """Principal curvatures (k, 2) [1/m], smaller first, and the direction (k, 3) of the first, in the world.

        Estimated at the surface points nearest to ``points_o`` (k, 3) [m] from a quadratic fitted to the surface within
        ``radius`` [m], by default three times the height of the triangles (over their longest sides; the median by
        area). On spheres and ellipsoids both are then within 2 % of the larger curvature if the triangles' height is a
        tenth of the smallest radius of curvature, and within 4 % if it is a fifth. An edge appears as a curvature of
        about one over the radius.

        Raises:
            InvalidInput: as in :meth:`project`, a point on a sharp edge or tip, or a radius not above zero.
        """
        if radius is None:
            if self._derived.fit_radius is None:
                heights, areas = self.surface.heights, self.surface.areas
                order = np.argsort(heights)
                median = np.searchsorted(np.cumsum(areas[order]), areas.sum() / 2)
                self._derived.fit_radius = float(_FIT_HEIGHTS * heights[order[min(median, len(order) - 1)]])
            radius = self._derived.fit_radius
        radius = number("radius of the curvature fit", radius, above=0, unit="m")
        surface, outward, _ = self._nearest_s(self._local(points_o))
        curvatures, first = self.surface.curvature(surface, outward, radius)
        self._refuse(
            np.isnan(curvatures[:, 0]),
            surface,
            "a sharp edge or tip of the mesh has no tangent plane, so no curvature: move the point off it",
        )
        return curvatures, first @ self.shape_pose[:3, :3].T

    def _nearest_s(self, local: Array) -> tuple[Array, Array, Array]:
        surface, outward, distance, opposite = self.surface.nearest(local)
        self._refuse(
            opposite,
            local,
            "a point between two opposite sides of the mesh has no nearest surface point: move it to the surface",
        )
        return surface, outward, distance
