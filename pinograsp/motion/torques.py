"""Joint torques with contact forces: tau = M ddq + h + J^T f, f being the force on the *object*."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import null_space

from pinograsp.checks import array_of, each_of, floats_of, frozen, instance_of, shorten
from pinograsp.contacts import ContactSet
from pinograsp.errors import InvalidInput
from pinograsp.forces import TorqueLimit, TorqueLimits, Underactuation
from pinograsp.forces.conditions import given_limit
from pinograsp.hands import Finger, HandModel, servo_gains
from pinograsp.hands.efforts import find_stops, spring_torques
from pinograsp.motion.jacobian import contact_jacobians, contact_points
from pinograsp.spatial import Array, BoolArray, skew

# Weighed in benchmarks/forgiving.py: motion of a joint [rad] that takes all of its torque or doubles it while the hand
# closes, a centimetre at a fingertip; and the gain of joints that bear next to nothing [N m/rad].
_FORGIVEN, _SOFTEST = 0.15, 0.3

DRY_FRICTION = (
    0.05  # share of the contacts' torques that tendons and joints bear by their friction, which is mostly more
)
_NONE = 1e-9  # [m] arms of contacts that load no joint
_ROUNDING = 1e-3  # of a limit that torques lie on


def inverse_dynamics(
    hand: HandModel, q: ArrayLike, dq: ArrayLike, ddq: ArrayLike, *, gravity_o: ArrayLike = (0.0, 0.0, -9.81)
) -> Array:
    """M ddq + h (m, n) [N m] along trajectories (m, n): inertia, Coriolis and gravity, no contact (RNEA).

    ``gravity_o`` (3,) [m/s^2] acts in the world.
    """
    paths = [array_of("trajectory", path, (None, hand.n)) for path in (q, dq, ddq)]
    if len({len(path) for path in paths}) > 1:
        raise InvalidInput(f"trajectories: expected equal lengths, got {', '.join(str(len(path)) for path in paths)}")
    model = hand.model
    if not np.array_equal(model.gravity.linear, gravity_o):
        model = model.copy()
        model.gravity.linear = array_of("gravity", gravity_o, (3,))
    tau = pin.rneaInParallel(1, pin.ModelPool(model, 1), *(path.T for path in paths))  # one call, no loop in Python
    torques: Array = tau.reshape(hand.n, -1).T  # flat where there is one joint
    return torques


def finger_dynamics(
    hand: HandModel, finger: Finger, posture: Array, path: tuple[Array, Array, Array], gravity_o: ArrayLike
) -> Array:
    """As :func:`inverse_dynamics`, of a finger's joints alone (m, n_f) along their ``path`` of q, dq and ddq (m, n_f).

    All others stay as in ``posture`` (n,): what they carry besides does not load the finger.
    """
    if hand.model.njoints - 1 > hand.n:  # Pinocchio does not reduce models with mimic joints
        whole_hand = [np.tile(posture, (len(path[0]), 1)), *np.zeros((2, len(path[0]), hand.n))]
        for own, all_joints in zip(path, whole_hand):
            all_joints[:, finger.dofs] = own
        found: Array = inverse_dynamics(hand, *whole_hand, gravity_o=gravity_o)[:, finger.dofs]
        return found
    # Pinocchio's joints are in the order of q here, and the universe is the first.
    others = [j for j in range(1, hand.model.njoints) if hand.model.joints[j].idx_v not in set(finger.dofs.tolist())]
    model = pin.buildReducedModel(hand.model, others, np.array(posture))
    model.gravity.linear = array_of("gravity", gravity_o, (3,))
    order = np.argsort(finger.dofs)
    tau = pin.rneaInParallel(1, pin.ModelPool(model, 1), *(one[:, order].T for one in path))
    torques = np.empty(path[0].shape)
    torques[:, order] = tau.reshape(finger.n, -1).T
    return torques


def contact_torques(jacobians: Array, wrenches_o: Array) -> Array:
    """Sum over contacts of J^T f (m, n) [N m].

    Args:
        jacobians: contact Jacobians (m, c, r, n), world axes: r = 3 (linear velocity) or 6 (linear first).
        wrenches_o: on the object (m, c, r): forces [N], and with r = 6 moments [N m].
    """
    torques: Array = np.einsum("mcxn,mcx->mn", jacobians, wrenches_o)
    return torques


def effort_of(hand: HandModel, torque_limit: TorqueLimit) -> Array:
    """Return the largest |torque| per joint (n,) [N m] for a ``torque_limit``; infinity: not limited.

    Args:
        hand: the hand with these joints.
        torque_limit: (n,) or one number; ``"effort"``: the hand's own effort limits, for joints that have one; None: no
            limit.
    """
    instance_of("hand", hand, HandModel)
    limit = given_limit(torque_limit)
    if limit is None:
        return np.full(hand.n, np.inf)
    if isinstance(limit, str):
        return drives_limit(hand)
    limit = np.full(hand.n, limit) if limit.ndim == 0 else limit
    if limit.shape != (hand.n,):
        raise InvalidInput(
            f"torque limit: expected one number > 0 or {hand.n} [N m], or 'effort', got {shorten(torque_limit)}"
        )
    return limit


def drives_limit(hand: HandModel) -> Array:
    """Largest |torque| per joint (n,) [N m]: its effort limit, or what its drives can do there where that is less."""
    driven = np.zeros(hand.n)
    for drive, arms in zip(hand.drives, np.abs(hand.transmission)):
        driven += np.where(arms > 0, arms * drive.limit if np.isfinite(drive.limit) else np.inf, 0.0)
    least: Array = np.minimum(hand.effort_or_infinity, np.where(driven > 0, driven, np.inf))
    return least


def beyond_limits(hand: HandModel, torques: Array) -> dict[str, str]:
    """In words, by joint, where ``torques`` (m, n) [N m or N] pass what the joints or their drives can do."""
    peaks, limits, slides = np.abs(torques).max(axis=0), drives_limit(hand), hand.slides
    return {
        joint: f"{joint} needs up to {peak:.3g} {unit}, more than its effort limit of {limit:g} {unit}"
        for joint, peak, limit, unit in zip(hand.joint_names, peaks, limits, np.where(slides, "N", "N m"))
        if peak > limit * (1 + _ROUNDING)
    }


def soften_servos(hand: HandModel, torques: Array) -> Array | None:
    """Gains (n,) [N m/rad or N/m] with which a closing hand forgives a misplaced object; None: none of its own do.

    A joint that the object holds off, or that goes on to reach it, presses with tau - K (q - q*): the gain is what the
    contacts ask of it, ``torques`` (n,) [N m or N], over the motion that it is to forgive.
    """
    fingers = np.concatenate([finger.dofs for finger in hand.fingers])
    of_positions = [drive for drive in hand.drives if drive.control == "position" and drive.stiffness is not None]
    fixed = {joint for drive in of_positions for joint in drive.joints}
    # Jaws keep an object between them by being stiff; of motors that take positions known gains are what they are.
    ours = ~hand.slides & np.isin(np.arange(hand.n), fingers) & ~np.isin(hand.joint_names, sorted(fixed))
    if not ours.any():
        return None
    own = servo_gains(hand)
    return frozen(np.where(ours, np.minimum(np.maximum(np.abs(torques) / _FORGIVEN, _SOFTEST), own), own))


def torques_matter(hand: HandModel, limit: Array | None) -> bool:
    """Whether forces depend on the torques of ``hand``: through a ``limit`` (n,) [N m], or because drives move several
    joints.

    None: torques do not count.
    """
    instance_of("hand", hand, HandModel)
    if limit is None:
        return False
    limit = floats_of("torque limit", limit)
    return bool(np.isfinite(limit).any() or hand.ratios)


def _underactuation(hand: HandModel, q: Array, jacobian: Array) -> Underactuation | None:
    """What the drives of ``hand`` cannot choose of the torques at q (n,), its springs stretched; None: nothing.

    Joints that no contact loads, together with all that their drives move, settle elsewhere: they are left out. Joints
    at the end of their range rest on it.
    """
    ratios = tuple(ratio for ratio in hand.ratios if np.abs(jacobian @ ratio.row).max(initial=0.0) > _NONE)
    if not ratios:
        return None
    rows, why, stops = np.array([ratio.row for ratio in ratios]), [ratio.why for ratio in ratios], find_stops(hand, q)
    for drive in set(why) if stops.any() else ():
        same = np.array([one == drive for one in why])
        rows[same] = _one_row_each(rows[same], stops != 0)
    pushes = rows * stops
    more, less = (pushes > _NONE).any(axis=1), (pushes < -_NONE).any(axis=1)
    kept = np.flatnonzero(~(more & less))
    if not len(kept):
        return None
    return Underactuation(
        rows=rows[kept],
        torques=rows[kept] @ spring_torques(hand, q),
        why=tuple(why[i] for i in kept),
        stops=(more.astype(int) - less)[kept],
        friction=DRY_FRICTION,
    )


def _one_row_each(rows: Array, stopped: BoolArray) -> Array:
    """As many combinations of rows (p, n), of unit length: each of the ``stopped`` joints (n,) in one of them alone, as
    far as there are enough.
    """
    joints = np.flatnonzero(stopped & (np.abs(rows) > _NONE).any(axis=0))[: len(rows)]
    if not len(joints) or np.linalg.matrix_rank(rows[:, joints]) < len(joints):
        return rows
    own = np.linalg.pinv(rows[:, joints]) @ rows
    combined = np.concatenate([own, null_space(rows[:, joints].T).T @ rows])
    return np.asarray(combined / np.linalg.norm(combined, axis=1, keepdims=True))


def preload_slope(
    hand: HandModel, contacts: ContactSet, q: ArrayLike, forces_o: ArrayLike, *, depth: ArrayLike = 0.0
) -> Array:
    """Compute the slope of J^T f over q (n, n) [N m/rad, N or N/m] for forces of constant size and direction in the
    world.

    This is what the forces add to the stiffness of the joints (``object_stiffness(joint_preload=...)``): negative if a
    finger is compressed, like a column that may buckle. A joint turns whatever it carries: that changes the velocity v
    that a joint farther on gives the contact point by omega x v, per rad of a joint that turns about omega.

    Args:
        hand: the hand.
        contacts: its contacts on the object.
        q: the posture in which it touches (n,) [rad].
        forces_o: on the object (k, 3) [N], world axes.
        depth: penetration of the contact points along their normals at ``q`` [m], one or (k,).

    Raises:
        InvalidInput: contacts without links, or wrong sizes.
    """
    model = instance_of("hand", hand, HandModel).model
    k = len(instance_of("contacts", contacts, ContactSet))
    q = array_of("q", q, (hand.n,))
    forces = array_of("forces", forces_o, (k, 3))
    data = model.createData()
    pin.computeJointJacobians(model, data, q)
    held = contact_points(hand, contacts, data, each_of("depth", depth, k))
    # Of all joints, coupled ones too, at the world's origin; the universe, joint 0, carries everything and stays.
    columns = np.vstack([np.zeros(6), data.J.T])
    carrying = np.zeros((k, model.njoints, 1))
    for own, (joint, _) in zip(carrying, held):
        own[list(model.supports[joint])] = 1.0
    points = np.array([data.oMi[joint].act(point) for joint, point in held])
    moved = carrying * (columns[:, :3] + columns[:, 3:] @ skew(points))
    turned = skew(forces) @ (carrying * columns[:, 3:]).transpose(0, 2, 1)
    each = np.tril((moved @ turned).sum(axis=0))  # (farther on, nearer to the palm)
    each += np.tril(each, -1).T
    moves = np.zeros((hand.n, model.njoints))
    moves[[joint.idx_v for joint in model.joints][1:], np.arange(1, model.njoints)] = 1.0
    slope: Array = moves @ each @ moves.T
    return slope


def torque_limits(
    hand: HandModel,
    contacts: ContactSet,
    q: ArrayLike,
    *,
    depth: ArrayLike = 0.0,
    limit: TorqueLimit = "effort",
    gravity_o: ArrayLike = (0.0, 0.0, -9.81),
) -> TorqueLimits:
    """Return the torque limits of ``hand`` at rest in the posture ``q`` (n,) [rad], for ``ForceProblem(torques=...)``.

    Each contact point, pressed in by ``depth``, counts as a point of its link at ``q``; gravity torques are the bias.

    Args:
        hand: the hand.
        contacts: its contacts on the object.
        q: the posture in which it touches (n,) [rad].
        depth: penetration of the contact points along their normals at ``q`` [m], one or (k,): at t_F the links have
            this depth (``solution.profile.final_depth``).
        limit: largest |torque| per joint (n,) [N m] (a number applies to all), or ``"effort"``, the default: the hand's
            own effort limits, or its drives' if these are lower; joints without one are not limited.
        gravity_o: gravity (3,) [m/s^2].

    The limits include the equations of a hand with fewer drives than joints (tendons, springs).

    Raises:
        InvalidInput: contacts without links, or a hand without any effort limit.

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, up = pg.load_hand("panda"), pg.spatial.pose_of([0, 0, 0.1034], np.eye(3))
        >>> closure = pg.close_hand(hand, pg.Sphere(radius=0.02, mass=0.1).placed(up))
        >>> limits = pg.torque_limits(hand, closure.contacts(), closure.q)
        >>> print(limits.joints, limits.limit, "N")
        ('panda_finger_joint1',) [140.] N

    See Also:
        :class:`~pinograsp.forces.TorqueLimits`, :class:`~pinograsp.forces.ForceProblem`.
    """
    model = instance_of("hand", hand, HandModel).model
    k = len(instance_of("contacts", contacts, ContactSet))
    gravity = array_of("gravity", gravity_o, (3,))
    if not np.array_equal(model.gravity.linear, gravity):
        model = model.copy()
        model.gravity.linear = gravity
    q = array_of("q", q, (hand.n,))
    if isinstance(limit, str) and not torques_matter(hand, drives_limit(hand)):
        raise InvalidInput(f"effort limits: no joint of hand '{hand.name}' has one: give limit= in N m")
    limit = effort_of(hand, limit)
    depth = each_of("depth", depth, k)
    data = model.createData()
    bias = pin.computeGeneralizedGravity(model, data, q)
    pin.computeJointJacobians(model, data, q)
    jacobian = contact_jacobians(hand, contacts, data, depth)
    return TorqueLimits(
        jacobian=jacobian,
        bias=bias,
        limit=limit,
        joints=hand.joint_names,
        underactuation=_underactuation(hand, q, jacobian),
    )
