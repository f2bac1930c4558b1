"""Stiffness with preload, against finite differences of mechanisms made of springs, and thresholds known in closed form."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import make_contacts
from marks import slow_except
from scipy.optimize import root
from scipy.spatial.transform import Rotation

import pinograsp as pg
from pinograsp.actuation import CompliantHand, contact_stiffness, object_stiffness, quasistatic_maps
from pinograsp.contacts import MarhefkaOrin
from pinograsp.spatial import rotation_rpy, tangent_frame

STEP = 1e-4  # of twists: differences are exact to its square, and to rounding over it


def still(k):
    """A hand that does not yield."""
    return CompliantHand(jacobian=np.zeros((3 * k, 1)), gains=[np.inf])


def differences(wrench):
    """-dw/dx (6, 6) at the origin of the twists, by central differences of fourth order."""
    columns = []
    for j in range(6):
        at = [wrench(s * STEP * np.eye(6)[j]) for s in (-2, -1, 1, 2)]
        columns.append((at[0] - 8 * at[1] + 8 * at[2] - at[3]) / (12 * STEP))
    return -np.column_stack(columns)


def some_grasp(seed, k=4):
    rng = np.random.default_rng(seed)
    points = rng.uniform(-1, 1, (k, 3))
    rotations = np.array([rotation_rpy(*rng.uniform(-3, 3, 3)) for _ in range(k)])
    roots = rng.normal(size=(k, 3, 3))
    springs = roots @ roots.transpose(0, 2, 1) + np.eye(3)
    return rng, points, rotations, springs, rng.normal(size=(k, 3))


def blocks(springs):
    K = np.zeros((3 * len(springs),) * 2)
    for i, one in enumerate(springs):
        K[3 * i : 3 * i + 3, 3 * i : 3 * i + 3] = one
    return K


@pytest.mark.parametrize("soft", [False, True], ids=["still hand", "soft hand"])
@pytest.mark.parametrize("fixed_in", ["hand", "object"])
@pytest.mark.parametrize("seed", range(3))
def test_springs_between_points_of_hand_and_object(seed, fixed_in, soft):
    """Axes of the springs fixed in the hand act on the object's points; fixed in the object, at the hand's points."""
    rng, points, rotations, springs, forces = some_grasp(seed)
    k = len(points)
    J = rng.normal(size=(3 * k, 5)) if soft else np.zeros((3 * k, 5))
    gains = rng.uniform(1, 4, 5)
    com = rng.uniform(-0.3, 0.3, 3)
    stretch = np.linalg.solve(springs, forces[:, :, None])[:, :, 0]
    hands = points + np.einsum("kxc,kc->kx", rotations, stretch)  # where the hand's points are
    arms = points if fixed_in == "hand" else hands
    contacts = make_contacts(arms, rotations, com)

    def springs_at(twist, q):
        """Forces (k, 3) in world axes and the points that they act on, for a twist of the object and joints q."""
        turn = Rotation.from_rotvec(twist[3:]).as_matrix()
        own = com + twist[:3] + (points - com) @ turn.T
        other = hands + np.einsum("kxc,kc->kx", rotations, (J @ q).reshape(k, 3))
        axes = rotations if fixed_in == "hand" else turn @ rotations
        pull = np.einsum("kxc,kcd,kyd,ky->kx", axes, springs, axes, other - own)
        return pull, own if fixed_in == "hand" else other

    def torques(twist, q):
        """J^T f, the work of the forces on the hand's points."""
        pull, _ = springs_at(twist, q)
        return J.T @ np.einsum("kxc,kx->kc", rotations, pull).ravel()

    at_rest = torques(np.zeros(6), np.zeros(5))

    def wrench(twist):
        q = np.zeros(5)
        if soft:
            q = root(lambda q: gains * q + torques(twist, q) - at_rest, q, tol=1e-14, options={"xtol": 1e-14}).x
        pull, where = springs_at(twist, q)
        return np.concatenate([pull.sum(axis=0), np.cross(where - com - twist[:3], pull).sum(axis=0)])

    curvatures = (np.inf, 0.0) if fixed_in == "hand" else (0.0, np.inf)
    found = object_stiffness(
        contacts.G,
        blocks(springs),
        CompliantHand(jacobian=J, gains=gains if soft else np.full(5, np.inf)),
        forces,
        object_curvature=curvatures[0],
        hand_curvature=curvatures[1],
    )
    expected = differences(wrench)
    np.testing.assert_allclose(found.matrix, expected, atol=2e-9 * np.abs(expected).max())
    assert np.abs(found.preload).max() > 0.1  # not a test of the elastic part alone


@pytest.mark.parametrize("radii", ["two balls", "hollow", "nearly flat hand", "nearly flat object"])
@pytest.mark.parametrize("seed", range(2))
def test_smooth_surfaces_without_friction(seed, radii):
    """A ball pressed on a ball pushes along the line of their centres, by how far these are apart."""
    rng, points, rotations, _, _ = some_grasp(seed)
    k, normals = len(points), rotations[:, :, 2]
    means = {
        "two balls": (0.7, 0.4),
        "hollow": (-2.5, 0.8),
        "nearly flat hand": (0.5, 1e3),
        "nearly flat object": (1e3, 0.3),
    }
    own, other = (mean * rng.uniform(0.8, 1.2, k) for mean in means[radii])
    stiff, planned = rng.uniform(2, 5, k), rng.uniform(0.5, 2, k)
    com = rng.uniform(-0.3, 0.3, 3)

    def wrench(twist):
        turn = Rotation.from_rotvec(twist[3:]).as_matrix()
        total = np.zeros(6)
        for i in range(k):
            centre = com + twist[:3] + turn @ (points[i] + own[i] * normals[i] - com)
            line = centre - (points[i] - other[i] * normals[i])
            apart = np.linalg.norm(line) * np.sign(own[i] + other[i])
            force = (planned[i] - stiff[i] * (apart - own[i] - other[i])) * line / apart
            total += np.concatenate([force, np.cross(centre - com - twist[:3], force)])
        return total

    K = np.zeros((3 * k, 3 * k))
    K[2::3, 2::3] = np.diag(stiff)
    forces = np.column_stack([np.zeros((k, 2)), planned])
    found = object_stiffness(
        make_contacts(points, rotations, com).G,
        K,
        still(k),
        forces,
        object_curvature=1 / own,
        hand_curvature=1 / other,
    )
    expected = differences(wrench)
    # Of lengths of 1e3 thirteen digits are right after the point, nine after division by the step.
    np.testing.assert_allclose(
        found.matrix, expected, atol=(1e-8 if "flat" in radii else 2e-9) * np.abs(expected).max()
    )


def test_flat_and_pointed_surfaces_are_the_ends_of_round_ones():
    _, points, rotations, springs, forces = some_grasp(4)
    G = make_contacts(points, rotations).G

    def matrix(own, other):
        curvatures = {"object_curvature": own, "hand_curvature": other}
        return object_stiffness(G, blocks(springs), still(4), forces, **curvatures).matrix

    for sharp, end in ((1e-10, 0.0), (1e10, np.inf)):
        np.testing.assert_allclose(matrix(sharp, 2.0), matrix(end, 2.0), atol=1e-8)
        np.testing.assert_allclose(matrix(2.0, sharp), matrix(2.0, end), atol=1e-8)


class Fingers:
    """Fingers of three joints each, of any axes, that end where the contacts are."""

    def __init__(self, rng, ends):
        self.axes = rng.normal(size=(len(ends), 3, 3))
        self.axes /= np.linalg.norm(self.axes, axis=2, keepdims=True)
        self.joints = ends[:, None] + rng.uniform(-1, 1, (len(ends), 3, 3))
        self.ends = ends

    def place(self, q):
        """Rotations (k, 3, 3) of the last links, and where their ends are (k, 3)."""
        turns, ends = [], []
        for i, end in enumerate(self.ends):
            turn = np.eye(3)
            for j in (2, 1, 0):
                own = Rotation.from_rotvec(q[3 * i + j] * self.axes[i, j]).as_matrix()
                end, turn = self.joints[i, j] + own @ (end - self.joints[i, j]), own @ turn
            turns.append(turn)
            ends.append(end)
        return np.array(turns), np.array(ends)

    def jacobians(self, q):
        """Of the ends (k, 6, n), world axes, by differences of fourth order."""
        found = np.zeros((len(self.ends), 6, 3 * len(self.ends)))
        for j in range(found.shape[2]):
            parts = [self.place(q + s * STEP * np.eye(len(q))[j]) for s in (-2, -1, 1, 2)]
            turned, moved = (
                (a - 8 * b + 8 * c - d) / (12 * STEP) for a, b, c, d in (tuple(one[i] for one in parts) for i in (0, 1))
            )
            found[:, :3, j] = moved
            spin = turned @ self.place(q)[0].transpose(0, 2, 1)
            found[:, 3:, j] = np.column_stack([spin[:, 2, 1], spin[:, 0, 2], spin[:, 1, 0]])
        return found


def curvature(energy, size, step=2e-3):
    """Second derivatives (size, size) at the origin, of fourth order."""
    weights = {-2: 1 / 12, -1: -2 / 3, 1: 2 / 3, 2: -1 / 12}
    unit = step * np.eye(size)
    found = np.zeros((size, size))
    for i in range(size):
        for j in range(i + 1):
            pairs = [(a, b, wa * wb) for a, wa in weights.items() for b, wb in weights.items()]
            found[i, j] = found[j, i] = sum(w * energy(a * unit[i] + b * unit[j]) for a, b, w in pairs) / step**2
    return found


@pytest.mark.slow
@pytest.mark.parametrize("kind", slow_except(["axes in the hand", "axes in the object", "balls"], "axes in the object"))
def test_fingers_that_turn_under_their_load(kind):
    """All at once: the second derivatives of the energy of springs, servos and load, without what yields."""
    rng, points, rotations, springs, forces = some_grasp(8)
    k, com, gains = len(points), np.array([0.1, -0.2, 0.05]), rng.uniform(2, 5, 12)
    balls, normals = kind == "balls", rotations[:, :, 2]
    own, other, torsion = rng.uniform(0.3, 0.6, (3, k))
    if balls:
        forces[:, :2], forces[:, 2] = 0.0, np.abs(forces[:, 2])
        springs = np.abs(springs) * np.diag([0, 0, 1.0])
    stretch = np.zeros((k, 3)) if balls else np.linalg.solve(springs, forces[:, :, None])[:, :, 0]
    hands = points + np.einsum("kxc,kc->kx", rotations, stretch)
    at = hands if kind == "axes in the object" else points  # where forces act
    contacts = make_contacts(at, rotations, com)
    fingers = Fingers(rng, at)
    pull = np.einsum("kxc,kc->kx", rotations, forces)
    load = -contacts.G @ forces.ravel()
    load[3:] = 0.0
    torques = np.einsum("kxn,kx->n", fingers.jacobians(np.zeros(12))[:, :3], pull)

    def energy(motion):
        q, twist = motion[:12], motion[12:]
        turn = Rotation.from_rotvec(twist[3:]).as_matrix()
        turns, ends = fingers.place(q)
        held = com + twist[:3] + (points - com) @ turn.T
        reached = ends + np.einsum("kxy,ky->kx", turns, hands - at)
        stored = 0.5 * gains @ q**2 - torques @ q - load[:3] @ twist[:3]
        for i in range(k):
            if balls:
                line = held[i] + own[i] * turn @ normals[i] - reached[i] + other[i] * turns[i] @ normals[i]
                depth = own[i] + other[i] - np.linalg.norm(line)
                stored += forces[i, 2] * depth + 0.5 * springs[i, 2, 2] * depth**2
            else:
                axes = (turn if kind == "axes in the object" else turns[i]) @ rotations[i]
                u = axes.T @ (reached[i] - held[i])
                stored += 0.5 * u @ springs[i] @ u
            between = twist[3:] - Rotation.from_matrix(turns[i]).as_rotvec()
            stored += 0.5 * torsion[i] * (normals[i] @ between) ** 2  # of second order at rest, as is its energy
        return stored

    full = curvature(energy, 18)
    expected = full[12:, 12:] - full[12:, :12] @ np.linalg.solve(full[:12, :12], full[:12, 12:])

    def slope():
        parts = [np.array([fingers.jacobians(s * 1e-3 * e)[:, :3] for e in np.eye(12)]) for s in (-1, 1)]
        found = np.einsum("jkxn,kx->jn", parts[1] - parts[0], pull) / 2e-3
        return found / 2 + found.T / 2

    curvatures = {"axes in the hand": (np.inf, 0.0), "axes in the object": (0.0, np.inf), "balls": (1 / own, 1 / other)}
    found = object_stiffness(
        contacts.G,
        blocks(springs),
        CompliantHand.at(contacts, fingers.jacobians(np.zeros(12)), gains=gains),
        forces,
        object_curvature=curvatures[kind][0],
        hand_curvature=curvatures[kind][1],
        torsional_stiffness=torsion,
        joint_preload=slope(),
    )
    # The moment that balances the rest has no energy; it makes the lower right part alone unsymmetric.
    matrix = found.matrix.copy()
    matrix[3:, 3:] = (matrix[3:, 3:] + matrix[3:, 3:].T) / 2
    np.testing.assert_allclose(matrix, expected, atol=2e-5 * np.abs(expected).max())  # the slope is exact to 1e-6
    assert (found.hand_margin > 0) == (np.linalg.eigvalsh(full[:12, :12])[0] > 0)
    assert found.is_stable() == (np.linalg.eigvalsh(full)[0] > 0)


def test_a_force_at_the_centre_of_mass_leaves_the_stiffness_symmetric():
    rng, points, rotations, springs, forces = some_grasp(5)
    contacts = make_contacts(points, rotations)
    _, _, Vt = np.linalg.svd(contacts.G[3:])
    forces = (Vt[3:].T @ rng.normal(size=len(Vt) - 3)).reshape(-1, 3)  # no moment
    for curvatures in ((np.inf, 0.0), (0.0, np.inf)):
        found = object_stiffness(
            contacts.G, blocks(springs), still(4), forces, object_curvature=curvatures[0], hand_curvature=curvatures[1]
        )
        np.testing.assert_allclose(found.matrix, found.matrix.T, atol=1e-12)


def test_without_preload_it_is_the_elastic_stiffness():
    rng, points, rotations, springs, _ = some_grasp(6)
    contacts = make_contacts(points, rotations)
    hand = CompliantHand(jacobian=rng.normal(size=(12, 5)), gains=rng.uniform(1, 4, 5))
    found = object_stiffness(contacts.G, blocks(springs), hand, np.zeros((4, 3)))
    maps = quasistatic_maps(contacts.G, blocks(springs), hand)
    np.testing.assert_allclose(found.matrix, maps.object_stiffness, atol=1e-11)
    np.testing.assert_allclose(found.elastic, maps.object_stiffness, atol=1e-11)
    assert found.moment_length == maps.moment_length and found.is_stable() and found.margin > 0


ARM, ACROSS, ALONG = 0.03, 900.0, 1500.0


def rod(squeeze, *, across=ACROSS, **options):
    """A rod of length 2 ARM, pressed at both ends."""
    points = ARM * np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    contacts = make_contacts(points, [tangent_frame([1, 0, 0]), tangent_frame([-1, 0, 0])])
    hand = options.pop("hand", still(2))
    K = np.diag([across, across, ALONG] * 2)
    return object_stiffness(contacts.G, K, hand, [[0, 0, squeeze]] * 2, **options)


def test_a_squeezed_rod_tips_over_at_the_arm_times_the_lateral_stiffness():
    """Moments 2 P a theta of the squeeze and 2 k_t a^2 theta of the springs: unstable from P = k_t a on."""
    critical = ACROSS * ARM
    assert rod(0.999 * critical).is_stable() and not rod(1.001 * critical).is_stable()
    tipped = rod(2 * critical)
    assert tipped.margin == pytest.approx((2 * ACROSS * ARM**2 - 4 * critical * ARM) / tipped.moment_length**2)
    assert np.abs(tipped.weakest[[0, 1, 2, 3]]).max() < 1e-9 * np.abs(tipped.weakest).max()  # it turns about y and z


def test_a_soft_hand_tips_over_earlier():
    gain = 400.0  # N/m, in series across the rod at both ends
    J = np.zeros((6, 4))
    J[0, 0] = J[1, 1] = J[3, 2] = J[4, 3] = 1.0
    hand = CompliantHand(jacobian=J, gains=np.full(4, gain))
    critical = ARM / (1 / ACROSS + 1 / gain)
    assert rod(0.999 * critical, hand=hand).is_stable() and not rod(1.001 * critical, hand=hand).is_stable()


def test_round_ends_bear_more_and_a_ball_between_flat_jaws_is_neutral():
    radius = 0.4 * ARM
    critical = ACROSS * ARM**2 / (ARM - radius)
    assert rod(0.999 * critical, object_curvature=1 / radius).is_stable()
    assert not rod(1.001 * critical, object_curvature=1 / radius).is_stable()
    ball = rod(1e6, across=0.0, object_curvature=1 / ARM)
    np.testing.assert_allclose(ball.matrix[3:, 3:], 0.0, atol=1e-6)


def test_pointed_fingers_on_flat_faces_turn_the_object_back():
    """A slab between two points is thicker the more it turns: 2 a / cos(theta)."""
    found = rod(50.0, across=0.0, object_curvature=0.0, hand_curvature=np.inf)
    assert found.matrix[4, 4] == pytest.approx(2 * 50.0 * ARM) and found.matrix[5, 5] == pytest.approx(2 * 50.0 * ARM)


def test_hertz_contacts_tip_over_where_their_stiffness_no_longer_grows_with_the_squeeze():
    """k_t grows with P^(1/3) only: rods tip over at P = (ratio 1.5 K^(2/3) a)^1.5."""
    law, ratio = MarhefkaOrin(), 2 / 3
    critical = (ratio * 1.5 * law.stiffness ** (2 / 3) * ARM) ** 1.5

    def stable(squeeze):
        k_t = contact_stiffness(law, [squeeze], tangential_ratio=ratio)[0, 0]
        return rod(squeeze, across=k_t).is_stable()

    assert stable(0.999 * critical) and not stable(1.001 * critical)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"forces_c": np.ones((3, 3))}, "preload"),
        ({"forces_c": [[0, 0, np.nan]] * 2}, "preload"),
        ({"object_curvature": np.nan}, "object curvature"),
        ({"object_curvature": [1.0, 2.0, 3.0]}, "object curvature"),
        ({"object_curvature": "flat"}, "object curvature"),
        ({"hand_curvature": -np.inf}, "hand curvature"),
        ({"hand_curvature": np.inf}, "touch at a point"),
        ({"object_curvature": 0.0}, "touch at a point"),
        ({"object_curvature": -20.0, "hand_curvature": 10.0}, "touch at a point"),
        ({"grasp_map": np.ones((6, 6))}, "unit axes"),
        ({"grasp_map": np.vstack([np.hstack([np.eye(3)] * 2), np.ones((3, 6))])}, "moments"),
        ({"stiffness": np.eye(9)}, "contact stiffness"),
        ({"hand": None}, "hand"),
        ({"moment_length": -1.0}, "moment length"),
        ({"torsional_stiffness": -1.0}, "torsional stiffness"),
        ({"torsional_stiffness": [1.0, 2.0, 3.0]}, "torsional stiffness"),
        ({"joint_preload": np.zeros((2, 2))}, "joint preload"),
    ],
)
def test_grasps_that_cannot_be_are_refused(change, words):
    points = np.array([[-1.0, 0, 0], [1.0, 0, 0]])
    contacts = make_contacts(points, [tangent_frame([1, 0, 0]), tangent_frame([-1, 0, 0])])
    given = {"grasp_map": contacts.G, "stiffness": np.eye(6), "hand": still(2), "forces_c": [[0, 0, 1.0]] * 2}
    with pytest.raises(pg.PinograspError, match=words):
        object_stiffness(**given | change)
