"""Forces and torques tick by tick: the optimum of an independent solver, the closest forces, rates, ramps, torques, bad
input.
"""

from __future__ import annotations

import tracemalloc
from dataclasses import replace

import cvxpy as cp
import numpy as np
import pinocchio as pin
import pytest
from conftest import around_cylinder
from marks import slow_except

import pinograsp as pg
from pinograsp.contacts import Contact, ContactSet
from pinograsp.errors import InvalidInput, Status
from pinograsp.forces import Underactuation
from pinograsp.spatial import rotation_rpy, tangent_frame

MODELS = {
    "pyramid": pg.Friction(),
    "cone": pg.Friction(model="cone", safety=1.2),
    "soft": pg.Friction(model="soft", torsion=4e-3),
    "cone, torsion": pg.Friction(model="cone", torsion=4e-3),
    "pyramid, torsion": pg.Friction(torsion=4e-3),
}
LOW, HIGH = 0.1, 8.0


def online_of(plan, **settings):
    """The loop of a plan's grasp, from the posture that it ends in."""
    return pg.OnlineForces(plan.problem, hand=plan.hand, q=plan.motion.q[-1], **settings)


def problem_of(k, seed, friction, balance="wrench"):
    rng = np.random.default_rng(seed)
    body = pg.Cylinder(radius=0.03, height=0.2, mass=0.2)
    contacts = pg.contacts_at(None, body, around_cylinder(rng, k, 0.03))
    return pg.ForceProblem.holding(
        body, contacts, mu=rng.uniform(0.5, 0.9, k), friction=friction, balance=balance, max_depth=5e-3
    ), rng


class Oracle:
    """The same minimisation in CVXPY, and the least that any forces leave unbalanced."""

    def __init__(self, problem, low, high, torques=None):
        k, d, rows, arm = problem.k, problem.friction.d, problem.rows, problem.moment_length
        friction, self.arm, self.rows = problem.friction, arm, rows
        mu = problem.mu / friction.safety
        self.f, self.m, self.load = cp.Variable((k, 3)), cp.Variable(k), cp.Parameter(6)
        limits = [self.f[:, 2] >= low, self.f[:, 2] <= high]
        torsion = friction.torsion / friction.safety
        for i in range(k):
            F, t = self.f[i, 2], self.f[i, :2]
            if friction.model == "soft":
                limits.append(cp.norm(cp.hstack([t / mu[i], self.m[i] / torsion])) <= F)
                continue
            limits.append(cp.norm(t) <= mu[i] * F if friction.model == "cone" else cp.abs(t) <= mu[i] * F / np.sqrt(2))
            limits.append(cp.abs(self.m[i]) <= torsion * F if d == 4 else self.m[i] == 0)
        if torques is not None:
            world = [contact.rotation_oc @ self.f[i] for i, contact in enumerate(problem.contacts)]
            moments = [contact.normal_o * self.m[i] for i, contact in enumerate(problem.contacts)]
            tau = torques.bias + sum(J[:3].T @ f + J[3:].T @ m for J, f, m in zip(torques.jacobian, world, moments))
            limits.append(cp.abs(tau[torques.limited]) <= torques.limit[torques.limited])
            if (under := torques.underactuation) is not None:
                arms = np.array([[np.linalg.norm(row @ J[:3].T) for J in torques.jacobian] for row in under.rows])
                left, borne = under.rows @ tau - under.torques, under.friction * arms @ self.f[:, 2]
                limits += [left[i] <= borne[i] for i in range(len(under.rows)) if under.stops[i] != 1]
                limits += [left[i] >= -borne[i] for i in range(len(under.rows)) if under.stops[i] != -1]
        scale = np.append(np.ones(3), np.full(3, 1 / arm))
        wrench = problem.contacts.G @ cp.reshape(self.f, (3 * k,), order="C") + self.load
        turn = problem.contacts.rotations_oc[:, :, 2].T @ self.m
        off = cp.multiply(scale, wrench + cp.hstack([np.zeros(3), turn]))[:rows]
        spin = self.m * 0 if d == 3 else cp.multiply(self.m, mu / torsion)
        self.closest = cp.Problem(cp.Minimize(cp.norm(off)), limits)
        cost = cp.sum_squares(self.f) + cp.sum_squares(spin)
        self.best = cp.Problem(cp.Minimize(cost), [*limits, off == 0])

    def __call__(self, load):
        self.load.value = load
        tight = {"solver": "CLARABEL", "tol_gap_abs": 1e-11, "tol_gap_rel": 1e-11, "tol_feas": 1e-11}
        missing = self.closest.solve(**tight)
        if missing > 1e-6:
            return missing, None
        self.best.solve(**tight)
        return 0.0, self.f.value


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")  # tighter than what the other solver always reaches
@pytest.mark.parametrize("balance", slow_except(["wrench", "force"], "wrench"))
@pytest.mark.parametrize("name", MODELS)
def test_forces_are_the_optimum_or_the_closest(name, balance):
    held = missed = 0
    for k, seed in ((3, 1), (6, 2)):
        problem, rng = problem_of(k, seed, MODELS[name], balance)
        online, oracle = pg.OnlineForces(problem, normal_forces=(LOW, HIGH)), Oracle(problem, LOW, HIGH)
        for factor in (0.5, 1.0, 10.0, 40.0):
            for _ in range(4):
                load = factor * np.append(rng.normal(size=3), 0.01 * rng.normal(size=3))
                forces, torques, status = online.step(load)
                missing, best = oracle(load)
                left = problem.scaled_norm(online.residual)
                assert torques.size == 0 and np.isfinite(forces).all()
                assert online.residual == pytest.approx(
                    problem.with_load(load).residual(forces, online.moments if problem.friction.d == 4 else None),
                    abs=1e-9,
                )
                gauge = problem.friction.gauge(
                    np.column_stack([forces[:, :2], online.moments])[:, : problem.friction.d - 1]
                    / problem.friction.scale(problem.mu)
                )
                assert (
                    np.all(gauge <= forces[:, 2] + 1e-9)
                    and forces[:, 2].min() >= LOW - 1e-9
                    and forces[:, 2].max() <= HIGH + 1e-9
                )
                if best is None:
                    missed += 1
                    assert status is Status.INFEASIBLE and left == pytest.approx(missing, rel=1e-5)
                else:
                    held += 1
                    assert status is Status.OK and left <= 1e-9 * np.linalg.norm(load)
                    assert forces == pytest.approx(best, abs=2e-5 * np.abs(best).max())
    assert held >= 4 and missed >= 4


def any_contacts(rng, k):
    """Contacts in a cloud, facing inwards, anywhere, each other (jaws), or one way."""
    points, kind = rng.normal(size=(k, 3)), rng.integers(4)
    inwards = -points + 0.3 * rng.normal(size=(k, 3))
    anywhere = rng.normal(size=(k, 3))
    jaws = np.sign(rng.normal(size=(k, 1))) * [0.0, 1.0, 0.0] + 1e-3 * rng.normal(size=(k, 3))
    one_way = [0.0, 0.0, 1.0] + 0.1 * rng.normal(size=(k, 3))
    normals = (inwards, anywhere, jaws, one_way)[kind]
    if kind == 2:
        points[:, 1] *= 1e-3
    contacts = [
        Contact(
            finger=f"c{i}",
            link="",
            point_o=point,
            rotation_oc=tangent_frame(normal / np.linalg.norm(normal)),
            length=None,
            distance=0.0,
        )
        for i, (point, normal) in enumerate(zip(0.03 * points, normals))
    ]
    return ContactSet(contacts=tuple(contacts), com_o=np.zeros(3))


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("seed, count", [(1, 30), pytest.param(2, 400, marks=pytest.mark.slow)])
def test_no_forces_leave_less(seed, count, often):
    """Slippery contacts, caps far above the load, grasps of any kind: what is left is the least that any forces leave."""
    rng, missed, unproven = np.random.default_rng(seed), 0, 0
    count = often(count) if count > 30 else count
    for _ in range(count):
        friction, k = MODELS[rng.choice(list(MODELS))], int(rng.integers(2, 6))
        problem = pg.ForceProblem(
            contacts=any_contacts(rng, k),
            load=np.ones(6),
            mu=10 ** rng.uniform(-2, -0.3, k),
            friction=friction,
            balance=rng.choice(["wrench", "force"]),
            max_depth=5e-3,
        )
        low = float(rng.choice([0.0, 0.01, 0.1]))
        high = low + 10 ** rng.uniform(0, 4)
        online, oracle = pg.OnlineForces(problem, normal_forces=(low, high)), Oracle(problem, low, high)
        for _ in range(2):
            load = np.append(rng.normal(size=3), 0.03 * rng.normal(size=3)) * 10 ** rng.uniform(-1, 2)
            forces, _, status = online.step(load)
            missing, _ = oracle(load)
            left, size = problem.scaled_norm(online.residual), max(problem.scaled_norm(load), low)
            assert left <= missing + 2e-6 * max(size, missing), (friction, problem.balance, low, high)
            assert forces[:, 2].min() >= low * (1 - 1e-9) and forces[:, 2].max() <= high * (1 + 1e-9)
            missed += status is Status.INFEASIBLE
            unproven += status is Status.INACCURATE
    assert missed >= count and unproven <= 0.01 * count


@pytest.mark.parametrize("mu", [0.003, 0.01, 0.1])
@pytest.mark.parametrize("share", [0.1, 0.5, 0.99])
def test_slippery_jaws_do_all_they_can(mu, share):
    """Two fingers that face each other, across the load: at their caps they bear 2 mu F_n of it, however little
    friction there is.
    """
    frames = [tangent_frame([0.0, side, 0.0]) for side in (1.0, -1.0)]
    jaws = [
        Contact(finger=f"jaw {i}", link="", point_o=-0.03 * frame[:, 2], rotation_oc=frame, length=None, distance=0.0)
        for i, frame in enumerate(frames)
    ]
    contacts = ContactSet(contacts=tuple(jaws), com_o=np.zeros(3))
    cap, load = share / (2 * mu), np.array([0.0, 0.0, -1.0, 0.0, 0.0, 0.0])
    problem = pg.ForceProblem(contacts=contacts, load=load, mu=mu, friction=pg.Friction(model="cone"), max_depth=5e-3)
    online = pg.OnlineForces(problem, normal_forces=(0.0, cap))
    forces, _, status = online.step(load)
    assert status is Status.INFEASIBLE and online.residual == pytest.approx((1 - share) * load, abs=1e-6)
    assert forces[:, 2] == pytest.approx([cap, cap], rel=1e-6)


def test_warm_and_cold_agree_and_forces_follow_the_load():
    problem, _ = problem_of(5, 3, MODELS["cone"])
    online, cold = (pg.OnlineForces(problem, normal_forces=(LOW, 20.0)) for _ in range(2))
    before, jumps, most = None, [], 0
    for i in range(2000):
        load = np.array([np.sin(0.01 * i), np.cos(0.007 * i), -1.5, 0.01 * np.sin(0.013 * i), 0.005, 0.0])
        forces, _, status = online.step(load)
        assert status is Status.OK
        most = max(most, online.steps)
        if before is not None:
            jumps.append(np.abs(forces - before).max())
        before = forces.copy()
        if i % 50 == 0:
            cold.reset()
            assert cold.step(load)[0] == pytest.approx(forces, abs=1e-8)
    assert max(jumps) < 0.1  # the load changes by 0.012 N a tick at the most
    assert most <= 12


def test_nothing_is_allocated_in_the_loop():
    problem, _ = problem_of(4, 4, MODELS["cone"])
    online = pg.OnlineForces(problem)
    loads = np.random.default_rng(0).normal(size=(200, 6)) * [1, 1, 1, 0.01, 0.01, 0.01]
    for load in loads:
        online.step(load)
    tracemalloc.start()
    for load in loads:
        online.step(load)
    current, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert current < 4e3 and peak < 2e4


def test_never_a_number_that_is_none():
    """Zero, huge and tiny loads, no friction, contacts without limits or pinned to one force: finite forces, an honest
    status.
    """
    rng = np.random.default_rng(5)
    for name, friction in MODELS.items():
        problem, _ = problem_of(4, 6, friction)
        for mu in (0.0, 1e-9, 0.6, 50.0):
            for limits in ((0.0, 10.0), (0.0, 1e9), (2.0, 2.0), (0.0, 0.0)):
                online = pg.OnlineForces(replace(problem, mu=mu), normal_forces=limits)
                for size in (0.0, 1e-9, 1e-3, 1.0, 1e6):
                    load = size * rng.normal(size=6)
                    forces, _, status = online.step(load)
                    assert np.isfinite(forces).all() and np.isfinite(online.residual).all(), (name, mu, limits, size)
                    # What the forces leave, by arithmetic of another kind.
                    left = problem.with_load(load).residual(forces, online.moments if friction.d == 4 else None)
                    if status is Status.OK:
                        assert problem.scaled_norm(left) <= 1e-10 * max(problem.scaled_norm(load), np.abs(forces).max())


def test_rates_and_ramps():
    problem, _ = problem_of(5, 3, MODELS["cone"])
    online = pg.OnlineForces(problem, normal_forces=(0.2, 20.0), max_rate=30.0, ramp=0.2)
    load = np.array([0.0, 0.0, -1.5, 0.0, 0.0, 0.0])
    before = online.step(load)[0].copy()
    for _ in range(5):
        forces, _, _ = online.step(10 * load)  # as if something fell on it
        assert np.abs(forces[:, 2] - before[:, 2]).max() <= 30.0 * 1e-3 + 1e-9
        before = forces.copy()
    assert online.status is Status.INFEASIBLE  # not yet
    for _ in range(600):
        online.step(10 * load)
    assert online.status is Status.OK

    online = pg.OnlineForces(problem, normal_forces=(0.2, 20.0), ramp=0.2)
    before = online.step(load)[0].copy()
    for touches, ends in ((False, 0.0), (True, None)):
        online.engage(1, touches)
        largest = 0.0
        for _ in range(250):
            forces, _, status = online.step(load)
            assert status is Status.OK
            largest = max(largest, np.abs(forces - before).max())
            before = forces.copy()
        # Its limits move by 0.1 N a tick at most; the others take over what it leaves.
        assert largest < 0.5
        assert forces[1, 2] == 0.0 if ends == 0.0 else forces[1, 2] >= 0.2
    online.engage(online.names[1], False)
    online.reset()
    with pytest.raises(InvalidInput, match="expected one of"):
        online.engage("nobody")
    with pytest.raises(InvalidInput, match="<= 4"):
        online.engage(7)


def test_a_contact_fades_from_its_force_and_no_faster_than_the_others_can_follow():
    problem, _ = problem_of(5, 3, MODELS["cone"])
    load = np.array([0.0, 0.0, -1.5, 0.0, 0.0, 0.0])
    # The largest force is far from those that are needed: what fades is the force.
    online = pg.OnlineForces(problem, normal_forces=(0.0, 500.0), ramp=0.1)
    there = float(online.step(load)[0][1, 2])
    online.engage(1, False)
    faded = []
    for _ in range(110):
        forces, _, status = online.step(load)
        assert status is Status.OK
        faded.append(float(forces[1, 2]))
    assert np.all(np.array(faded[:100]) <= there * (1 - np.arange(1, 101) / 100) + 1e-9)
    assert np.abs(np.diff([there, *faded])).max() <= there / 100 + 1e-9 and faded[-1] == 0.0
    # Slower where the rate asks for it: the ramp alone would take 1 ms.
    online = pg.OnlineForces(problem, normal_forces=(0.0, 500.0), ramp=0.002, max_rate=5.0)
    before = online.step(load)[0].copy()
    online.engage(1, False)
    for _ in range(1000):
        forces, _, _ = online.step(load)
        assert np.abs(forces[:, 2] - before[:, 2]).max() <= 5e-3 + 1e-9
        before = forces.copy()
    assert forces[1, 2] == 0.0 and online.status is Status.OK
    # Back from half of the way, without a jump.
    online.engage(1)
    for _ in range(3):
        online.step(load)
    online.engage(1, False)
    online.engage(1)
    assert np.abs(online.step(load)[0][:, 2] - before[:, 2]).max() < 0.05
    # A finger that has slipped off has no force from the next tick on, whatever the rates.
    online.engage(1, False, at_once=True)
    assert online.step(load)[0][1, 2] == 0.0
    online.engage(1, at_once=True)
    with pytest.raises(InvalidInput, match="at_once"):
        online.engage(1, at_once="yes")


@pytest.fixture(scope="module")
def plan():
    return pg.load_case("paper", {"forces.search": "convex", "forces.balance": "wrench"}).plan()


def test_torques_of_the_papers_hand_follow_the_posture(plan):
    online, hand, contacts = online_of(plan), plan.hand, plan.problem.contacts
    rng, data = np.random.default_rng(0), plan.hand.model.createData()
    q0 = plan.motion.q[-1]
    forces, torques, status = online.step(plan.problem.load)
    assert status is Status.OK
    model = hand.model.copy()
    model.gravity.linear = np.array(plan.problem.gravity_o)
    data = model.createData()
    for i in range(5):
        q = q0 + 0.05 * rng.normal(size=hand.n) * (i > 0)
        forces, torques, _ = online.step(plan.problem.load, q=q)
        # RNEA with the forces that the object gives back, where the contacts are.
        pin.forwardKinematics(model, data, q)
        external = pin.StdVec_Force()
        for _j in range(model.njoints):
            external.append(pin.Force.Zero())
        for contact, f in zip(contacts, forces):
            finger = hand.finger(contact.finger)
            joint = finger.joint_ids[finger.links.index(contact.link)]
            back = -contact.rotation_oc @ f
            external[joint] += data.oMi[joint].actInv(pin.Force(back, np.cross(contact.point_o, back)))
        zero = np.zeros(hand.n)
        assert torques == pytest.approx(pin.rnea(model, data, q, zero, zero, external), abs=1e-10)


def test_torques_of_coupled_joints():
    hand = pg.load_hand("psyonic_left")
    q = 0.5 * (hand.lower + hand.upper)
    data = hand.model.createData()
    pin.forwardKinematics(hand.model, data, q)
    fingers = hand.fingers[:4]
    tips = {f.name: data.oMi[f.joint_ids[-1]].translation.copy() for f in fingers}
    centre = np.mean(list(tips.values()), axis=0)
    radius = max(np.linalg.norm(p - centre) for p in tips.values())
    body = pg.Sphere(radius=radius, mass=0.1, pose=np.block([[np.eye(3), centre[:, None]], [np.zeros(3), 1.0]]))
    contacts = pg.contacts_at(hand, body, tips, tolerance=1.0)
    problem = pg.ForceProblem.holding(body, contacts, mu=0.8, friction=MODELS["soft"], max_depth=5e-3)
    online = pg.OnlineForces(problem, hand=hand, q=q, normal_forces=(0.0, 30.0))
    forces, torques, _ = online.step(problem.load)
    expected = pg.torque_limits(hand, contacts, q, limit=1.0).torques(
        np.einsum("kij,kj->ki", contacts.rotations_oc, forces), contacts.rotations_oc[:, :, 2] * online.moments[:, None]
    )
    assert np.abs(online.moments).max() > 0 and torques == pytest.approx(expected, abs=1e-10)


def hand_of_many(model):
    """Four contacts on each of three fingers: torque rows of one contact and of several."""
    hand = pg.load_hand("humanoid")
    q = 0.5 * (hand.lower + hand.upper)
    fingers = [finger for finger in hand.fingers if len(finger.links) >= 4][:3]
    origins = {f.name: hand.frame_placements(q, f.links[-4:])[:, :3, 3] for f in fingers}
    points = np.concatenate(list(origins.values()))
    pose = np.eye(4)
    pose[:3, 3] = points.mean(axis=0)
    radius = float(np.linalg.norm((points - pose[:3, 3])[:, :2], axis=1).mean())
    body = pg.Cylinder(radius=radius, height=1.0, mass=0.5, pose=pose)
    contacts = pg.contacts_at(hand, body, origins, links={f.name: list(f.links[-4:]) for f in fingers}, tolerance=1.0)
    return hand, q, pg.ForceProblem.holding(body, contacts, mu=0.8, friction=model, max_depth=5e-3)


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("name", slow_except(MODELS, "cone"))
def test_torque_limits(name):
    """Where the least forces ask too much of a joint: the best that do not, or the closest; limits of some joints only."""
    hand, q, problem = hand_of_many(MODELS[name])
    rng, counts = np.random.default_rng(3), {"free": 0, "held": 0, "missed": 0}
    free = pg.OnlineForces(problem, hand=hand, q=q, normal_forces=(0.02, 30.0))
    load = np.array(problem.load)
    usual = np.abs(free.step(load)[1])
    for share, heavier in ((0.2, 15.0), (0.7, 1.0), (2.0, 1.0)):
        limit = np.maximum(share * usual, 0.01)
        limit[::5] = np.inf
        limited = replace(problem, torques=pg.torque_limits(hand, problem.contacts, q, limit=limit))
        online = pg.OnlineForces(limited, hand=hand, q=q, normal_forces=(0.02, 30.0))
        for _ in range(4):
            other = q + 0.05 * rng.normal(size=hand.n)
            asked = heavier * load * rng.uniform(0.7, 1.3, 6)
            forces, torques, status = online.step(asked, q=other)
            row = pg.torque_limits(hand, problem.contacts, other, limit=limit)
            assert np.all(np.abs(torques) <= limit * (1 + 1e-7)), share
            missing, best = Oracle(problem, 0.02, 30.0, row)(asked)
            left = problem.scaled_norm(online.residual)
            if best is None:
                counts["missed"] += 1
                assert status is Status.INFEASIBLE and left == pytest.approx(missing, rel=1e-4, abs=1e-5)
                continue
            within = np.all(np.abs(free.step(asked, q=other)[1]) <= limit)
            counts["free" if within else "held"] += 1
            assert status is Status.OK and left <= 1e-8 * np.linalg.norm(asked)
            assert forces == pytest.approx(best, abs=1e-4 * np.abs(best).max())
    assert min(counts.values()) >= 2, counts


@pytest.mark.filterwarnings("ignore:Solution may be inaccurate")
@pytest.mark.parametrize("name", slow_except(MODELS, "pyramid"))
def test_couplings_of_drives(name):
    """Torques in the ratios of a motor's arms, to what friction bears: the best forces that have them, or the closest."""
    hand, q, problem = hand_of_many(MODELS[name])
    rng, counts = np.random.default_rng(4), {"held": 0, "missed": 0}
    load, limit = np.array(problem.load), np.full(hand.n, np.inf)
    usual = pg.OnlineForces(problem, hand=hand, q=q, normal_forces=(0.02, 30.0)).step(load)[1].copy()
    loaded = np.flatnonzero(np.abs(pg.torque_limits(hand, problem.contacts, q, limit=1.0).jacobian).max(axis=(0, 1)))
    for share, friction, stops in ((0.0, 0.0, None), (0.5, 0.1, None), (300.0, 0.05, None), (2.0, 0.05, (1, -1))):
        limit[loaded[::4]] = 0.7 * np.maximum(np.abs(usual[loaded[::4]]), 0.05) if friction else np.inf
        rows = np.zeros((2, hand.n))
        for row in rows:  # one motor at two joints, which one or several contacts load
            row[rng.choice(loaded, 2, replace=False)] = rng.uniform(0.5, 1.0, 2) * [1, -1]
            row /= np.linalg.norm(row)
        value = rows @ usual + share * 0.01 * rng.normal(size=2)
        under = Underactuation(rows=rows, torques=value, why=("one motor",) * 2, friction=friction, stops=stops)

        def torques_at(posture, limit=limit, under=under):
            found = pg.torque_limits(hand, problem.contacts, posture, limit=limit)
            return replace(found, underactuation=under)

        online = pg.OnlineForces(replace(problem, torques=torques_at(q)), hand=hand, q=q, normal_forces=(0.02, 30.0))
        for _ in range(3):
            other = q + 0.03 * rng.normal(size=hand.n)
            asked = load * rng.uniform(0.8, 1.2, 6)
            forces, torques, status = online.step(asked, q=other)
            missing, best = Oracle(problem, 0.02, 30.0, torques_at(other))(asked)
            left = problem.scaled_norm(online.residual)
            if missing == np.inf:
                continue  # no forces at all have such torques
            if best is None:
                counts["missed"] += 1
                assert status is Status.INFEASIBLE and left == pytest.approx(missing, rel=1e-4, abs=1e-5)
                continue
            counts["held"] += 1
            assert status is Status.OK and left <= 1e-8 * np.linalg.norm(asked)
            assert forces == pytest.approx(best, abs=1e-3 * np.abs(best).max())
            arms = np.linalg.norm(np.einsum("pn,kxn->pkx", rows, torques_at(other).jacobian[:, :3]), axis=2)
            left, borne = rows @ torques - value, friction * arms @ forces[:, 2]
            above, below = under.limited_sides
            off = np.concatenate([(left - borne)[above], (-left - borne)[below]])
            assert off.max() <= 1e-5 * np.linalg.norm(asked)
    assert counts["held"] >= 4, counts


def test_torque_limits_that_gravity_alone_breaks():
    hand, q, problem = hand_of_many(MODELS["cone"])
    torques = pg.torque_limits(hand, problem.contacts, q, limit=1e-6)
    forces, torques, status = pg.OnlineForces(replace(problem, torques=torques), hand=hand, q=q).step(problem.load)
    assert status in (Status.INFEASIBLE, Status.INACCURATE) and np.isfinite(forces).all() and np.isfinite(torques).all()


def test_moved_contacts_and_other_friction():
    problem, _rng = problem_of(4, 8, MODELS["cone"])
    online = pg.OnlineForces(problem, normal_forces=(LOW, HIGH))
    load = np.array([0.3, -0.2, -1.0, 0.003, 0.0, 0.002])
    poses = np.tile(np.eye(4), (4, 1, 1))
    turn = rotation_rpy(0.1, -0.2, 0.3)
    com = problem.contacts.com_o
    for i, contact in enumerate(problem.contacts):
        poses[i, :3, :3], poses[i, :3, 3] = turn @ contact.rotation_oc, com + turn @ (contact.point_o - com)
    plain = online.step(load)[0].copy()
    turned = np.concatenate([turn @ load[:3], turn @ load[3:]])
    assert online.step(turned, poses=poses)[0] == pytest.approx(plain, abs=1e-9)  # all turned alike: nothing new
    slippery = online.step(turned, mu=0.45)[0].copy()
    assert slippery[:, 2].sum() > plain[:, 2].sum()
    other = pg.OnlineForces(replace(problem, mu=0.45), normal_forces=(LOW, HIGH))
    assert other.step(load)[0] == pytest.approx(slippery, abs=1e-9)


@pytest.mark.parametrize(
    "bad",
    [
        {"wrench": [0, 0, np.nan, 0, 0, 0]},
        {"wrench": np.full(6, np.inf)},
        {"wrench": np.zeros(5)},
        {"mu": -0.1},
        {"mu": [0.5, np.nan, 0.5]},
        {"mu": [0.5]},
        {"poses": np.full((3, 4, 4), np.nan)},
        {"poses": np.eye(4)},
        {"q": np.zeros(3)},
        {"q": np.full(9, np.nan)},
    ],
)
def test_bad_input_changes_nothing(plan, bad):
    online = online_of(plan)
    load = plan.problem.load
    forces, torques = (value.copy() for value in online.step(load)[:2])
    if "q" in bad and np.size(bad["q"]) == 9:
        bad = {"q": np.full(plan.hand.n, np.nan)}
    with pytest.raises(InvalidInput):
        online.step(bad.get("wrench", load), **{name: value for name, value in bad.items() if name != "wrench"})
    assert np.array_equal(online.forces, forces) and np.array_equal(online.torques, torques)
    again, after, status = online.step(load)
    assert (
        status is Status.OK and again == pytest.approx(forces, abs=1e-9) and after == pytest.approx(torques, abs=1e-9)
    )


@pytest.mark.parametrize(
    "laid_out",
    [
        lambda a: np.repeat(a[..., None], 3, axis=-1)[..., 1],  # a column of a table
        lambda a: a.astype(">f8"),
        lambda a: a.astype(np.float32),
        np.asfortranarray,
        lambda a: a.tolist(),
    ],
    ids=["strided", "big-endian", "float32", "fortran", "list"],
)
def test_arrays_may_be_laid_out_in_any_way(plan, laid_out):
    load, contacts = plan.problem.load, plan.problem.contacts
    poses = np.tile(np.eye(4), (plan.problem.k, 1, 1))
    poses[:, :3, :3], poses[:, :3, 3] = contacts.rotations_oc, contacts.points_o
    given = {"load": load, "q": plan.motion.q[-1], "poses": poses, "mu": plan.problem.mu}
    once = {name: laid_out(value) for name, value in given.items()}
    for only in ({"load"}, set(given)):
        expected, found = (
            online_of(plan).step(**{name: value for name, value in one.items() if name in only})
            for one in (given, once)
        )
        assert found[2] is expected[2] is Status.OK
        assert np.asarray(found[0]) == pytest.approx(np.asarray(expected[0]), abs=1e-4)
        assert found[1] == pytest.approx(expected[1], abs=1e-4)
    solver = pg.ForceSolver(plan.problem, plan.solution.impact_time)
    assert solver.solve(laid_out(load)).normal_forces == pytest.approx(solver.solve(load).normal_forces, abs=1e-4)
    assert plan.problem.with_load(laid_out(load)).load == pytest.approx(load, rel=1e-6)


def test_bad_input_can_keep_the_last_command(plan):
    """A NaN of a sensor does not stop the loop: the last forces, torques and positions stay, and the status says so."""
    online = online_of(plan, invalid="keep", stiffness=10.0)
    load, nan = plan.problem.load, np.full(plan.hand.n, np.nan)
    kept = [value.copy() for value in (*online.step(load)[:2], online.positions)]
    for bad in ({"load": nan[:6]}, {"load": load, "q": nan}, {"load": load, "mu": -1.0}, {"load": "none"}):
        forces, torques, status = online.step(**bad)
        assert status is Status.INVALID_INPUT and online.status is status
        assert all(np.array_equal(a, b) for a, b in zip((forces, torques, online.positions), kept))
    assert online.step(load)[2] is Status.OK
    with pytest.raises(InvalidInput, match="expected"):
        online_of(plan, invalid="ignore")


def test_positions_are_where_servos_give_the_torques(plan):
    kp = np.linspace(1.0, 50.0, plan.hand.n)
    online, q = online_of(plan, stiffness=kp), np.array(plan.motion.q[-1])
    _, torques, _ = online.step(plan.problem.load, q=q)
    assert kp * (online.positions - q) == pytest.approx(torques, abs=1e-12)
    q += 0.1  # the caller's own array
    online.step(plan.problem.load)
    assert kp * (online.positions - plan.motion.q[-1]) == pytest.approx(online.torques, abs=1e-12)
    assert not online_of(plan).positions.size
    for bad in (0.0, -1.0, np.nan, kp[:2], "stiff"):
        with pytest.raises(InvalidInput, match="stiffness"):
            online_of(plan, stiffness=bad)
    with pytest.raises(InvalidInput, match="hand"):
        pg.OnlineForces(plan.problem, stiffness=1.0)


def test_a_refused_tick_changes_nothing_at_all(plan):
    """Neither what came with it and could be used: friction, frames, posture; nor the ramps."""
    online, other = (online_of(plan, ramp=0.01) for _ in range(2))
    load, k, q = plan.problem.load, plan.problem.k, plan.motion.q[-1]
    poses = np.tile(np.eye(4), (k, 1, 1))
    for one in (online, other):
        one.step(load)
        one.engage(0, False)
    fine = {"mu": 0.2, "poses": poses, "q": q + 0.1}
    for bad in (
        {"wrench": np.full(6, 1e13)},
        {"wrench": [1, 2, 3, 4, 5, np.nan]},
        {"wrench": "load"},
        {"mu": -1.0},
        {"mu": 1e9},
        {"mu": "ice"},
        {"poses": poses[:2]},
        {"poses": 1e9 * poses},
        {"q": q[:3]},
        {"q": np.full(len(q), 1e300)},
        {"q": ["a"] * len(q)},
    ):
        with pytest.raises(InvalidInput):
            online.step(bad.pop("wrench", load), **fine | bad)
        for one, two in zip(online.step(load), other.step(load)):
            assert np.array_equal(one, two), bad


def test_loads_that_grow_over_the_plans_are_held():
    """The range of F_n is what the depth and the caps allow, not what the plan's impact time does; as in the README."""
    paper = pg.load_case(
        "paper", {"forces.search": "convex", "forces.balance": "wrench", "friction.model": "cone"}
    ).plan()
    online = online_of(paper, max_rate=200.0, ramp=0.1)
    for share in np.linspace(1.0, 1.2, 50):
        forces, _, status = online.step(share * paper.problem.load, q=paper.motion.q[-1])
        assert status is Status.OK, share
    assert (
        paper.forces.normal_forces.max()
        < forces[:, 2].max()
        < paper.problem.compliance.normal_force(paper.problem.max_depth)
    )
    capped = pg.OnlineForces(replace(paper.problem, max_normal_force=6.0), hand=paper.hand, q=paper.motion.q[-1])
    forces, _, status = capped.step(paper.problem.load)
    assert status is Status.INFEASIBLE and forces[:, 2].max() <= 6.0 + 1e-9


def test_limits_that_are_set_between_ticks_are_kept(plan):
    paper = pg.load_case("paper", {"forces.search": "convex", "friction.model": "cone"}).plan()
    online = online_of(paper)
    load, q, planned = paper.problem.load, paper.motion.q[-1], paper.forces.normal_forces
    online.largest = 3 * planned
    online.least = 1.5 * planned
    forces, _, _ = online.step(load, q=q)
    assert np.all(forces[:, 2] > 1.5 * planned - 1e-9)
    assert np.array_equal(online.constants()["least"], online.least)
    for name, bad in (
        ("least", 4 * planned),
        ("least", -1.0),
        ("largest", planned),
        ("largest", np.nan),
        ("least", [1.0]),
    ):
        with pytest.raises(InvalidInput):
            setattr(online, name, bad)
    np.testing.assert_allclose(online.least, 1.5 * planned)


def test_unusable_settings_are_refused(plan):
    problem, _ = problem_of(3, 1, MODELS["cone"])
    for wrong, message in (
        ({"normal_forces": (2.0, 1.0)}, "least <= largest"),
        ({"normal_forces": 3.0}, "expected .least, largest."),
        ({"period": 0.0}, "period"),
        ({"max_rate": -1.0}, "rate"),
        ({"q": np.zeros(3)}, "posture of the hand"),
        ({"hand": plan.hand}, "without one"),
    ):
        with pytest.raises(InvalidInput, match=message):
            pg.OnlineForces(problem, **wrong)
    with pytest.raises(InvalidInput, match="4 edges"):
        pg.OnlineForces(replace(problem, friction=pg.Friction(edges=8)))
    with pytest.raises(InvalidInput, match="ForceProblem"):
        pg.OnlineForces(plan)
    with pytest.raises(InvalidInput, match="torque limits"):
        pg.OnlineForces(
            replace(
                plan.problem, torques=pg.torque_limits(plan.hand, plan.problem.contacts, plan.motion.q[-1], limit=9.0)
            )
        )
