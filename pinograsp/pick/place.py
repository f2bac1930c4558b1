"""Where an object is to be put: at one pose, or anywhere in a region."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinograsp.checks import array_of, brief, flag, placement_of
from pinograsp.errors import InvalidInput
from pinograsp.objects import Scene
from pinograsp.objects.body import Body
from pinograsp.objects.scene import STANDS
from pinograsp.spatial import Array, inverse_of, pose_of

_DRAWS = 64  # places of a region that are looked at, _ENOUGH of which are kept
_ENOUGH = 4
_MEETS = 1e-3  # [m] by which an object may be in what it stands on


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaceRegion:
    """A level rectangle along the world's axes; the object may be put anywhere in it.

    Attributes:
        x, y: least and largest coordinates (2,) of the origin of the object's frame [m].
        z: height of that origin [m]; None: unchanged.
        turned: whether the object may be turned about the vertical; else it keeps its rotation.
    """

    x: ArrayLike
    y: ArrayLike
    z: float | None = None
    turned: bool = True

    __repr__ = brief("x", "y", "z", "turned")

    def __post_init__(self) -> None:
        for name in ("x", "y"):
            low, high = array_of(f"{name} of a region [m]", getattr(self, name), (2,))
            if low > high:
                raise InvalidInput(f"{name} of a region: expected the least first, got {low:g} and {high:g}")
        flag("turned", self.turned)

    def draw_poses(self, body: Body, up_o: Array, rng: np.random.Generator) -> list[Array]:
        """Draw poses (4, 4) of the body's frame: first the middle with the present rotation, then any."""
        (left, right), (near, far) = np.asarray(self.x), np.asarray(self.y)
        height = float(body.pose[2, 3]) if self.z is None else self.z
        found = [pose_of(((left + right) / 2.0, (near + far) / 2.0, height), body.pose[:3, :3])]
        for _ in range(_DRAWS - 1):
            turn = pin.exp3(rng.uniform(-np.pi, np.pi) * up_o) if self.turned else np.eye(3)
            found.append(pose_of((rng.uniform(left, right), rng.uniform(near, far), height), turn @ body.pose[:3, :3]))
        return found


def find_places(
    place: ArrayLike | PlaceRegion | None, body: Body, scene: Scene, up_o: Array, rng: np.random.Generator
) -> tuple[Array, ...]:
    """Poses (4, 4) of the object's frame at which it may be put, with room for it; none where it is only lifted.

    Raises:
        InvalidInput: no pose, position or region; something is where the object is to be.
    """
    check_room("object", scene, body, 0.0)
    if place is None:
        return ()
    if not isinstance(place, PlaceRegion):
        if np.shape(place) == (3,):
            pose = pose_of(array_of("place", place, (3,)), body.pose[:3, :3])
        else:
            pose = np.array(placement_of("place", place))
        check_room("place", scene, body.placed(pose), scene.clearance)
        return (pose,)
    found, why = list[Array](), ""
    for pose in place.draw_poses(body, up_o, rng):
        try:
            check_room("place", scene, body.placed(pose), scene.clearance)
        except InvalidInput as error:
            why = why or str(error)
            continue
        found.append(pose)
        if len(found) == _ENOUGH:
            break
    if not found:
        raise InvalidInput(f"place: expected a region with room for the object, got one without, {_DRAWS} tried: {why}")
    return tuple(found)


def check_room(name: str, scene: Scene, body: Body, clearance: float) -> None:
    """Raise where obstacles are nearer to a body than ``clearance`` [m], or it is deep in what it stands on."""
    for obstacle, gap in scene.measure_gaps(body).items():
        if gap < clearance and not -_MEETS <= gap <= STANDS:
            how = f"{1e3 * gap:.3g} mm from it" if gap > 0 else f"{-1e3 * gap:.3g} mm in it"
            raise InvalidInput(
                f"{name}: expected room for the object, {1e3 * clearance:g} mm from '{obstacle}', got it {how}"
            )


def measure_tilts(places: tuple[Array, ...], body: Body, up_o: Array) -> Array:
    """How far the object's axis that is vertical now tilts at places: (p,) [rad]."""
    axes = np.array([(place @ inverse_of(body.pose))[:3, :3] @ up_o for place in places]).reshape(-1, 3)
    return np.asarray(np.arctan2(np.linalg.norm(np.cross(axes, up_o), axis=1), axes @ up_o))
