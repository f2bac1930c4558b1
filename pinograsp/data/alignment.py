"""Two descriptions of the same hand laid on each other, by the axes of their joints.

An axis in space is a line: descriptions put a joint's origin anywhere on it, and point along it either way. Lines of
corresponding joints, at corresponding zeros, fix the placement of one root frame in the other, which way each joint
turns, and tell where the descriptions differ: another zero, another length, another hand.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from pinograsp.checks import (
    array_of,
    brief,
    instance_of,
    items_of,
    mapping_of,
    number,
    one_of,
    placement_of,
    read_only,
)
from pinograsp.data.rotations import placements
from pinograsp.errors import InvalidInput
from pinograsp.hands.model import HandModel
from pinograsp.spatial import Array, BoolArray, inverse_of

_ARM = 0.05  # [m] at which an angle between axes counts like a distance: about a finger's length
_ALIKE = 1e-4  # [m] of rounding in descriptions: below it all pairs count alike
_TIGHT: dict[str, Any] = {"x_scale": [1, 1, 1, _ARM, _ARM, _ARM], "xtol": 1e-14, "ftol": 1e-14, "gtol": 1e-14}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointAxes:
    """Axes of a hand's joints (n) with all of these joints at zero.

    Attributes:
        names: of the joints.
        origins: a point of each axis in the hand's root frame (n, 3) [m].
        directions: unit vectors along them (n, 3), in the sense of positive positions.
        slides: which joints slide (n,), so that only the direction of their axis is defined; None: none of them.
    """

    names: tuple[str, ...]
    origins: Array
    directions: Array
    slides: BoolArray | None = None

    __repr__ = brief("names")

    def choose(self, names: Sequence[str]) -> JointAxes:
        """Return the axes of some joints, in this order; :class:`~pinograsp.errors.InvalidInput` for others."""
        names = items_of("names", names, str)
        at = np.array([self.names.index(one_of("joint", name, self.names)) for name in names], dtype=int)
        return JointAxes(
            names=names,
            origins=read_only(self.origins[at]),
            directions=read_only(self.directions[at]),
            slides=None if self.slides is None else read_only(self.slides[at]),
        )

    def move(self, pose: ArrayLike) -> JointAxes:
        """Return the same axes in a frame in which this root frame is at ``pose`` (4, 4) [m].

        Raises:
            InvalidInput: not a placement.
        """
        pose = placement_of("pose", pose)
        return JointAxes(
            names=self.names,
            origins=read_only(self.origins @ pose[:3, :3].T + pose[:3, 3]),
            directions=read_only(self.directions @ pose[:3, :3].T),
            slides=self.slides,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Alignment:
    """The placement of one hand on another.

    Attributes:
        names: of the joints in the two hands (n pairs).
        pose: aMb (4, 4), the root frame of hand b in that of hand a.
        signs: 1 if a joint of b counts in the same direction as that of a, -1 if in the opposite one (n,).
        distances: between the axes (n,) [m]; 0 for joints that slide.
        angles: between the axes (n,) [rad].
    """

    names: tuple[tuple[str, str], ...]
    pose: Array
    signs: Array
    distances: Array
    angles: Array

    __repr__ = brief("names", "distances", "angles")

    @property
    def residual(self) -> float:
        """The largest distance [m] of any pair; angles count as distances 50 mm from the intersection of the axes."""
        return float(max(self.distances.max(), _ARM * self.angles.max()))

    @property
    def worst(self) -> tuple[str, str]:
        """The pair of joints that differ most."""
        return self.names[int(np.maximum(self.distances, _ARM * self.angles).argmax())]


def joint_axes(
    hand: HandModel, joints: Sequence[str] | None = None, at: Mapping[str, float] | None = None
) -> JointAxes:
    """Return the axes of a hand's joints (by default all actuated ones) with these at zero, and others at ``at`` or, if
    that does not name them, at ``hand.resting``.

    Raises:
        InvalidInput: a joint does not exist, or follows another.
    """
    instance_of("hand", hand, HandModel)
    names = hand.joint_names if joints is None else tuple(items_of("joints", joints, str))
    q, all_names = np.array(hand.resting), hand.joint_names
    given = {name: number(f"at: '{name}'", one) for name, one in mapping_of("at", {} if at is None else at).items()}
    for name, value in {**given, **dict.fromkeys(names, 0.0)}.items():
        q[all_names.index(one_of(f"joint of hand '{hand.name}'", name, all_names))] = value
    model = hand.model
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    root = inverse_of(np.asarray(hand.pose))
    origins, directions, slides = [], [], []
    for name in names:
        j = model.getJointId(name)
        # Mimic joints share the column of the one they follow; here it is of this joint, in its own frame.
        jacobian = pin.getJointJacobian(model, data, j, pin.ReferenceFrame.LOCAL).reshape(6, -1)
        motion = jacobian[:, model.joints[j].idx_v]
        slides.append(bool(np.abs(motion[3:]).max() < 0.5))
        along = motion[:3] if slides[-1] else motion[3:]
        placed = root @ data.oMi[j].homogeneous
        origins.append(placed[:3, 3])
        directions.append(placed[:3, :3] @ along)
    return JointAxes(
        names=names,
        origins=read_only(np.array(origins).reshape(-1, 3)),
        directions=read_only(np.array(directions).reshape(-1, 3)),
        slides=read_only(np.array(slides, dtype=bool)),
    )


def alignment(a: JointAxes, b: JointAxes) -> Alignment:
    """Align hand b with hand a, whose joints correspond in their order.

    The placement minimises the distances between the axes, and angles times 50 mm; pairs that agree count more than
    those that do not (a smooth sum of absolute values).

    Raises:
        InvalidInput: fewer than three pairs, or axes that leave a rotation or a shift undetermined.
    """
    instance_of("a", a, JointAxes)
    instance_of("b", b, JointAxes)
    n = len(a.names)
    if n != len(b.names) or n < 3:
        raise InvalidInput(f"alignment: expected at least three pairs of joints, got {n} and {len(b.names)}")
    p, u = array_of("a.origins", a.origins, (n, 3)), array_of("a.directions", a.directions, (n, 3))
    r, v = array_of("b.origins", b.origins, (n, 3)), array_of("b.directions", b.directions, (n, 3))
    turning = ~np.any([np.zeros(n, dtype=bool) if one.slides is None else one.slides for one in (a, b)], axis=0)

    def lines(x: Array) -> tuple[Array, Array]:
        turn = Rotation.from_rotvec(x[:3]).as_matrix() @ start
        return r @ turn.T + shift + x[3:], v @ turn.T

    def residuals(x: Array) -> Array:
        points, axes = lines(x)
        gaps = points - p
        across = (gaps - u * np.sum(gaps * u, axis=1, keepdims=True)) * turning[:, None]
        result: Array = np.concatenate([across, _ARM * np.cross(u, axes)]).ravel()
        return result

    # From the origins as points first, which slides along the axes spoil but little.
    start, shift = _points_on_points(p, r)
    near = least_squares(residuals, np.zeros(6), **_TIGHT)
    found = least_squares(residuals, near.x, loss="soft_l1", f_scale=_ALIKE, **_TIGHT)
    if np.linalg.svd(near.jac * [1, 1, 1, _ARM, _ARM, _ARM], compute_uv=False)[-1] < 1e-3 * _ARM:
        raise InvalidInput("alignment: these joints' axes leave a turn or a shift open: give a link or a placement")
    turn = Rotation.from_rotvec(found.x[:3]).as_matrix() @ start
    points, axes = lines(found.x)
    gaps = points - p
    signs = np.where(np.sum(u * axes, axis=1) < 0, -1.0, 1.0)
    return Alignment(
        names=tuple(zip(a.names, b.names)),
        pose=read_only(placements(shift + found.x[3:], turn)),
        signs=read_only(signs),
        distances=read_only(np.linalg.norm(gaps - u * np.sum(gaps * u, axis=1, keepdims=True), axis=1) * turning),
        angles=read_only(np.arcsin(np.clip(np.linalg.norm(np.cross(u, axes), axis=1), 0, 1))),
    )


def _points_on_points(p: Array, r: Array) -> tuple[Array, Array]:
    """The rotation (3, 3) and the shift (3,) that bring points r (n, 3) nearest to points p (n, 3)."""
    U, _, V = np.linalg.svd((p - p.mean(0)).T @ (r - r.mean(0)))
    rotation = U @ np.diag([1.0, 1.0, np.sign(np.linalg.det(U @ V)) or 1.0]) @ V
    return rotation, p.mean(0) - rotation @ r.mean(0)
