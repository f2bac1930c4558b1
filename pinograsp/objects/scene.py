"""What stands around a robot and the object that it is to take."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import coal
import numpy as np
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, instance_of, mapping_of, number, text_of
from pinograsp.errors import InvalidInput
from pinograsp.hands.geometry import solid_of
from pinograsp.objects.body import Body
from pinograsp.objects.primitives import Box
from pinograsp.spatial import Array, pose_of

_DENSITY = 700.0  # [kg/m^3] of boards, which nobody weighs: they stay
_BOARD = 0.04  # [m]
CLEARANCE = 0.01  # [m]
STANDS = 2e-3  # [m] what is no farther from an object is what it stands on


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Fixed obstacles, and how near a robot may come to them.

    Obstacles are bodies: tables, boxes, meshes, or objects in URDF, SDF and MJCF files
    (:func:`~pinograsp.objects.load_object` reads them). Their masses do not matter.

    Attributes:
        obstacles: ``{name: body}``, in their places in the world.
        clearance: distance that robot and held object keep from the obstacles, and the robot from an object that it
            does not hold [m]. A hand that takes or puts down an object may come nearer to it and to its support.

    Example:
        >>> import pinograsp as pg
        >>> table = pg.Scene.on_table(height=0.7)
        >>> scene = table.with_box("wall", (0.02, 0.4, 0.3), at=(0.5, 0.0, 0.85))
        >>> print(sorted(scene.obstacles), scene.clearance, "m")
        ['table', 'wall'] 0.01 m

    See Also:
        :func:`~pinograsp.pick.plan_pick`, :func:`~pinograsp.synthesis.find_grasps`.
    """

    obstacles: Mapping[str, Body] = field(default_factory=dict)
    clearance: float = CLEARANCE

    __repr__ = brief()

    def __post_init__(self) -> None:
        obstacles = mapping_of("obstacles", self.obstacles, "{name: body}")
        for name, body in obstacles.items():
            if not text_of("name of an obstacle", name):
                raise InvalidInput("name of an obstacle: expected a text, got an empty one: give each a name")
            instance_of(f"obstacle '{name}'", body, Body)
        object.__setattr__(self, "obstacles", dict(obstacles))
        object.__setattr__(self, "clearance", number("clearance", self.clearance, at_least=0, at_most=1, unit="m"))

    @classmethod
    def on_table(
        cls,
        height: float = 0.0,
        *,
        size: ArrayLike = (1.2, 0.8),
        at: ArrayLike = (0.5, 0.0),
        clearance: float = CLEARANCE,
    ) -> Scene:
        """Return a scene with a level table only: a board of 40 mm, ``size`` (2,) [m] with its middle ``at`` (2,) [m],
        its top at ``height`` [m] along the world's z axis.
        """
        (x, y), (across, along) = array_of("at", at, (2,)), array_of("size of a table", size, (2,))
        top = number("height of a table", height, unit="m")
        return cls(clearance=clearance).with_box("table", (across, along, _BOARD), at=(x, y, top - _BOARD / 2))

    def with_obstacle(self, name: str, body: Body) -> Scene:
        """Return the scene with one more obstacle.

        Raises:
            InvalidInput: the name already exists, or this is not a body.
        """
        if name in self.obstacles:
            raise InvalidInput(f"obstacle '{name}': expected a new name, got one that already exists")
        return replace(self, obstacles={**self.obstacles, name: body})

    def with_box(self, name: str, size: ArrayLike, *, at: ArrayLike) -> Scene:
        """Return the scene with one more obstacle: a box, edges ``size`` (3,) [m] along the world's axes, middle ``at``
        (3,) [m].
        """
        place = pose_of(array_of(f"at of obstacle '{name}'", at, (3,)), np.eye(3))
        return self.with_obstacle(name, Box(size=size, density=_DENSITY, pose=place))

    def find_supports(self, body: Body, places: Sequence[Array] = ()) -> set[str]:
        """Return the names of the obstacles on which a body stands, or nearly so, here or at ``places`` (4, 4) of its
        frame.
        """
        everywhere = (body, *(body.placed(place) for place in places))
        return {name for one in everywhere for name, gap in self.measure_gaps(one).items() if gap <= STANDS}

    def measure_gaps(self, body: Body) -> dict[str, float]:
        """Return the distances of the obstacles from a body [m]; below 0 if they overlap."""
        found = dict[str, float]()
        for name, obstacle in self.obstacles.items():
            at = [coal.Transform3s(one.shape_pose[:3, :3], one.shape_pose[:3, 3]) for one in (obstacle, body)]
            request, result = coal.DistanceRequest(), coal.DistanceResult()
            request.enable_signed_distance = True
            geometries = obstacle.collision_geometry, solid_of(body.collision_geometry)
            found[name] = float(coal.distance(geometries[0], at[0], geometries[1], at[1], request, result))
        return found
