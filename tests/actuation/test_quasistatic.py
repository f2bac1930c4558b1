"""Quasi-static maps against the block system of the published equations, and the contact stiffness."""

from __future__ import annotations

import numpy as np
import pytest
from conftest import make_contacts

import pinograsp as pg
from pinograsp.actuation import CompliantHand, contact_stiffness, quasistatic_maps
from pinograsp.contacts import MarhefkaOrin
from pinograsp.contacts.quality import grasp_stiffness
from pinograsp.motion import torque_limits

RNG_SEED = 3


def equilibrium(G, K, J, S, kp, *, joints=None, springs=None, load=None, reference=None):
    """The equations of Prattichizzo, Malvezzi and Bicchi (RSS 2010) as they stand, all unknowns at once: (f, x, q, a).

    f = K_c (J q - G^T x); G f + w = 0; tau = J^T f + springs q = K_q (S a - q), or q = S a where joints are rigid;
    S^T tau = K_z (a_ref - a).
    """
    (c, n), m = J.shape, S.shape[1]
    springs = np.zeros(n) if springs is None else springs
    f, x, q, a = np.split(np.arange(c + 6 + n + m), np.cumsum([c, 6, n]))
    left, right = np.zeros((c + 6 + n + m,) * 2), np.zeros(c + 6 + n + m)
    left[np.ix_(f, f)], left[np.ix_(f, q)], left[np.ix_(f, x)] = np.eye(c), -K @ J, K @ G.T
    left[np.ix_(x, f)] = G
    right[x] = np.zeros(6) if load is None else -load
    if joints is None:
        left[np.ix_(q, q)], left[np.ix_(q, a)] = np.eye(n), -S
    else:
        left[np.ix_(q, f)], left[np.ix_(q, q)], left[np.ix_(q, a)] = J.T, np.diag(springs) + joints, -joints @ S
    rigid = np.isinf(kp)  # a = a_ref
    left[np.ix_(a, f)], left[np.ix_(a, q)] = S.T @ J.T, S.T @ np.diag(springs)
    left[a[rigid]] = 0.0
    left[np.ix_(a, a)] = np.diag(np.where(rigid, 1.0, kp))
    right[a] = np.zeros(m) if reference is None else np.where(rigid, 1.0, kp) * reference
    size = np.abs(left).max(axis=1)
    found = np.linalg.solve(left / size[:, None], right / size)
    return tuple(found[part] for part in (f, x, q, a))


def paper_grasp(hand, contacts, final_angles):
    jacobian = torque_limits(hand, contacts, hand.configuration(final_angles), limit=1.0).jacobian
    return contacts, jacobian, np.array([9.873, 6.35, 4.7])


def fingertip_grasp(name):
    """All fingertips of a hand about something between them."""
    hand = pg.load_hand(name)
    q = 0.45 * hand.lower + 0.55 * hand.upper
    tips = hand.frame_placements(q, [finger.tip for finger in hand.fingers])[:, :3, 3]
    middle = tips.mean(axis=0)
    names, links = zip(*((finger.name, finger.links[-1]) for finger in hand.fingers))
    contacts = make_contacts(tips, middle - tips, middle + [0.002, -0.003, 0.001], names, links)
    normal = np.array([3.0, 2.0, 4.0, 6.0, 5.0])[: len(tips)]
    return contacts, torque_limits(hand, contacts, q, limit=1.0).jacobian, normal


@pytest.fixture(scope="module")
def allegro_grasp():
    return fingertip_grasp("allegro_right")


@pytest.fixture(scope="module")
def psyonic_grasp():
    """Five fingers, six motors: the outer joints follow the inner ones."""
    return fingertip_grasp("psyonic_left")


@pytest.fixture(params=["paper", "allegro", "psyonic"])
def grasp(request, hand, contacts, final_angles, allegro_grasp, psyonic_grasp):
    if request.param == "paper":
        return paper_grasp(hand, contacts, final_angles)
    return allegro_grasp if request.param == "allegro" else psyonic_grasp


def agrees(found, expected, tolerance=1e-9):
    assert np.abs(found - expected).max() <= tolerance * np.abs(expected).max()


@pytest.mark.parametrize(
    "kind",
    [
        "a servo at each joint",
        "synergies",
        "soft synergies",
        "soft synergies and springs",
        "soft, some rigid, and springs",
    ],
)
def test_maps_solve_the_published_equations(grasp, kind):
    rng = np.random.default_rng(RNG_SEED)
    contacts, jacobian, normal = grasp
    n = jacobian.shape[2]
    S = np.eye(n) if kind == "a servo at each joint" else rng.normal(size=(n, 7))
    kp = rng.uniform(0.5, 20, S.shape[1])
    if "rigid" in kind:
        kp[::2] = np.inf
    joints = springs = None
    if kind.startswith("soft"):
        root = rng.normal(size=(n, n))
        joints = root @ root.T + 3 * np.eye(n)
    if kind.endswith("springs"):
        springs = rng.uniform(0, 2, n)
    hand = CompliantHand.at(
        contacts,
        jacobian,
        gains=kp,
        transmission=None if kind == "a servo at each joint" else S,
        joint_stiffness=joints,
        springs=springs,
    )
    K = contact_stiffness(MarhefkaOrin(), normal)
    maps = quasistatic_maps(contacts.G, K, hand)
    assert maps.rank == 6
    for j in range(S.shape[1]):
        f, x, q, _ = equilibrium(
            contacts.G, K, hand.jacobian, S, kp, joints=joints, springs=springs, reference=np.eye(S.shape[1])[j]
        )
        agrees(maps.force_by_reference[:, j], f)
        agrees(maps.object_by_reference[:, j], x)
        agrees(maps.joints_by_reference[:, j], q)
        if np.isfinite(kp[j]):
            agrees(maps.force_by_effort[:, j] * kp[j], f)
    for j in range(6):
        f, x, q, _ = equilibrium(contacts.G, K, hand.jacobian, S, kp, joints=joints, springs=springs, load=np.eye(6)[j])
        agrees(maps.force_by_load[:, j], f)
        agrees(maps.object_by_load[:, j], x)
        agrees(maps.joints_by_load[:, j], q)


def test_stiffness_in_series_is_the_inverse_of_the_sum_of_compliances(grasp):
    """K_s = (K_c^-1 + J K_q^-1 J^T + J S K_z^-1 S^T J^T)^-1 (Malvezzi and Prattichizzo, ICRA 2014)."""
    rng = np.random.default_rng(RNG_SEED)
    contacts, jacobian, normal = grasp
    n = jacobian.shape[2]
    S, kp, kq = rng.normal(size=(n, 4)), rng.uniform(1, 9, 4), rng.uniform(1, 9, n)
    hand = CompliantHand.at(contacts, jacobian, gains=kp, transmission=S, joint_stiffness=kq)
    K, J = contact_stiffness(MarhefkaOrin(), normal), hand.jacobian
    K_s = np.linalg.inv(np.linalg.inv(K) + (J / kq) @ J.T + (J @ S / kp) @ S.T @ J.T)
    maps = quasistatic_maps(contacts.G, K, hand)
    agrees(maps.stiffness, K_s)
    agrees(maps.object_stiffness, contacts.G @ K_s @ contacts.G.T)
    pseudo = K_s @ contacts.G.T @ np.linalg.inv(contacts.G @ K_s @ contacts.G.T)
    agrees(maps.force_by_load, -pseudo)
    projected = (np.eye(3 * hand.k) - pseudo @ contacts.G) @ K_s @ J @ S
    agrees(maps.internal @ maps.internal.T @ projected, projected)
    assert maps.internal.shape[1] == np.linalg.matrix_rank(projected, tol=1e-9 * np.abs(projected).max())


@pytest.mark.parametrize("gains", ["servos", "torque control", "rigid", "of all kinds"])
def test_forces_after_a_change_balance_the_load_and_internal_forces_balance_themselves(grasp, gains):
    rng = np.random.default_rng(RNG_SEED)
    contacts, jacobian, normal = grasp
    n = jacobian.shape[2]
    kp = {
        "servos": rng.uniform(1, 9, n),
        "torque control": np.zeros(n),
        "rigid": np.full(n, np.inf),
        "of all kinds": rng.choice([0.0, 5.0, np.inf], n),
    }[gains]
    hand = CompliantHand.at(contacts, jacobian, gains=kp)
    maps = quasistatic_maps(contacts.G, contact_stiffness(MarhefkaOrin(), normal), hand)
    if maps.rank == 6:
        np.testing.assert_allclose(contacts.G @ maps.force_by_load, -np.eye(6), atol=1e-9)
        assert np.abs(contacts.G @ maps.force_by_reference).max() <= 1e-9 * np.abs(maps.force_by_reference).max(
            initial=1
        )
    np.testing.assert_allclose(maps.internal.T @ maps.internal, np.eye(maps.internal.shape[1]), atol=1e-12)
    assert np.abs(contacts.G @ maps.internal).max(initial=0.0) <= 1e-9
    assert not maps.force_by_reference[:, kp == 0].any() or np.abs(maps.force_by_reference[:, kp == 0]).max() < 1e-9
    assert not maps.force_by_effort[:, np.isinf(kp)].any()


def test_rigid_drives_and_torque_control_are_the_ends_of_servos(grasp):
    contacts, jacobian, normal = grasp
    K = contact_stiffness(MarhefkaOrin(), normal)
    n = jacobian.shape[2]

    def maps(kp):
        return quasistatic_maps(
            contacts.G, K, CompliantHand.at(contacts, jacobian, gains=np.full(n, kp), springs=np.ones(n))
        )

    rigid, hard, loose, soft = (maps(kp) for kp in (np.inf, 1e9, 0.0, 1e-9))
    for name in ("stiffness", "force_by_load", "object_by_reference", "force_by_reference", "joints_by_reference"):
        agrees(getattr(hard, name), getattr(rigid, name), 1e-5)
    agrees(soft.stiffness, loose.stiffness, 1e-5)
    agrees(soft.force_by_effort, loose.force_by_effort, 1e-5)


def test_a_tendon_couples_torques_and_a_transmission_motions():
    """Two joints that slide along the normals of one contact each, on an object that is held by what is not looked at."""
    J, R, K, nothing = np.zeros((6, 2)), np.array([[1.0, 3.0]]), 1e3 * np.eye(6), np.zeros((6, 6))
    J[2, 0] = J[5, 1] = 1.0
    push = np.array([0, 0, 1.0, 0, 0, 0])  # against the first contact
    tendon = quasistatic_maps(nothing, K, CompliantHand(jacobian=J, gains=10.0 * R.T @ R)).stiffness @ push
    assert tendon[5] == pytest.approx(3.0 * tendon[2])
    coupled = quasistatic_maps(nothing, K, CompliantHand(jacobian=J, gains=[0.0], transmission=R.T)).stiffness @ push
    assert coupled[2] == pytest.approx(-3.0 * coupled[5])  # no effort, and the joints move by 1 to 3


def test_contact_stiffness_is_that_of_the_quality_measures(contacts):
    law, forces = MarhefkaOrin(), [9.0, 6.0, 4.0]
    found = np.diag(contact_stiffness(law, forces, tangential_ratio=0.8)).reshape(3, 3)
    expected = grasp_stiffness(contacts, law, forces, tangential_ratio=0.8)
    np.testing.assert_allclose(found[:, 2], expected.normal_stiffness, rtol=1e-14)
    np.testing.assert_allclose(found[:, :2], np.column_stack([expected.tangential_stiffness] * 2), rtol=1e-14)


HAND = {"jacobian": np.ones((6, 2)), "gains": [1.0, 1.0]}


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"jacobian": np.ones((5, 2))}, "three rows for each contact"),
        ({"jacobian": np.ones((0, 2))}, "three rows for each contact"),
        ({"jacobian": np.ones((6, 0))}, "one column or more"),
        ({"jacobian": [["a"]]}, "hand Jacobian"),
        ({"gains": [1.0]}, "servo gains: expected 2 values"),
        ({"gains": [1.0, -1.0]}, "servo gains: expected 2 values >= 0"),
        ({"gains": [1.0, np.nan]}, "servo gains"),
        ({"gains": [[1.0, 0.5], [0.0, 1.0]]}, "symmetric"),
        ({"gains": [[1.0, 2.0], [2.0, 1.0]]}, "negative"),
        ({"gains": [[np.inf, 0.0], [0.0, 1.0]]}, "finite"),
        ({"transmission": np.ones((3, 2))}, "transmission S"),
        ({"transmission": np.ones((2, 3))}, "servo gains: expected 3 values"),
        ({"joint_stiffness": [1.0, 0.0]}, "joint stiffness: expected 2 values > 0"),
        ({"joint_stiffness": [[1.0, 1.0], [1.0, 1.0]]}, "singular one"),
        ({"springs": [-1.0, 1.0]}, "springs"),
        ({"springs": [np.inf, 1.0]}, "springs"),
        ({"gains": True}, "servo gains"),
    ],
)
def test_hands_that_cannot_be_are_refused(change, words):
    with pytest.raises(pg.PinograspError, match=words):
        CompliantHand(**HAND | change)


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (lambda hand: quasistatic_maps(np.eye(6), np.eye(3), hand), "contact stiffness"),
        (lambda hand: quasistatic_maps(np.ones((6, 9)), np.eye(6), hand), "grasp map"),
        (lambda hand: quasistatic_maps(np.eye(6), np.full((6, 6), np.nan), hand), "contact stiffness"),
        (lambda hand: quasistatic_maps(np.eye(6), np.triu(np.ones((6, 6))), hand), "symmetric"),
        (lambda hand: quasistatic_maps(np.eye(6), -np.eye(6), hand), "negative"),
        (lambda hand: quasistatic_maps(np.eye(6), np.eye(6), "hand"), "CompliantHand"),
        (lambda hand: quasistatic_maps(np.eye(6), np.eye(6), hand, moment_length=0), "moment length"),
        (lambda hand: contact_stiffness(MarhefkaOrin(), [-1.0]), "normal forces"),
        (lambda hand: contact_stiffness(MarhefkaOrin(exponent=0.5), [1.0]), "exponent >= 1"),
        (lambda hand: contact_stiffness(MarhefkaOrin(), [1.0], tangential_ratio=-1), "tangential"),
        (lambda hand: CompliantHand.at("contacts", np.ones((2, 3, 2)), gains=[1, 1]), "ContactSet"),
    ],
)
def test_grasps_that_cannot_be_are_refused(call, words):
    with pytest.raises(pg.PinograspError, match=words):
        call(CompliantHand(**HAND))


def test_jacobians_of_other_contacts_are_refused(contacts):
    for shape in ((2, 6, 4), (3, 5, 4), (3, 6)):
        with pytest.raises(pg.PinograspError, match="contact Jacobians"):
            CompliantHand.at(contacts, np.ones(shape), gains=np.ones(4))


def test_nothing_stiff_and_nothing_driven_give_no_numbers_that_are_none(contacts):
    hand = CompliantHand(jacobian=np.zeros((9, 2)), gains=[0.0, np.inf])
    for K in (np.zeros((9, 9)), np.eye(9)):
        maps = quasistatic_maps(contacts.G, K, hand)
        assert maps.internal.shape == (9, 0) and maps.rank == (6 if K.any() else 0)
        for name in ("stiffness", "force_by_load", "object_by_load", "force_by_reference", "joints_by_reference"):
            assert np.isfinite(getattr(maps, name)).all()
