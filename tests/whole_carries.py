"""Carrying as one program, all unknowns at once: an oracle that eliminates nothing; and random paths and grasps."""

from dataclasses import dataclass

import clarabel
import numpy as np
from panda_path import JOINTS
from scipy import sparse

import pinograsp as pg
from pinograsp.carry import ArmPath
from pinograsp.carry.loads import Carried
from pinograsp.carry.programs import ArmLimits, Programs
from pinograsp.contacts import Contact, ContactSet, Friction
from pinograsp.forces import ForceProblem
from pinograsp.spatial import tangent_frame


def pairs(along_a, along_b, step):
    return np.stack([along_b / 2 - along_a / (2 * step), along_b / 2 + along_a / (2 * step)], axis=2)


def by_clarabel(program):
    """The least time, from all forces, squared speeds, their roots and the times of the intervals as unknowns."""
    N, k, d = program.count, program.k, program.friction.d
    nodes, size = N + 1, N * k * d
    y, root, time = size, size + nodes, size + 2 * nodes
    total = time + N
    blocks, ends, cones = [], [], []

    def add(rows, right, cone):
        blocks.append(sparse.coo_matrix(rows) if not sparse.issparse(rows) else rows)
        ends.append(np.asarray(right, dtype=float))
        cones.append(cone)

    def of(entries, count):
        r, c, v = (np.array(part) for part in zip(*entries))
        return sparse.coo_matrix((v, (r, c)), shape=(count, total))

    def linear(M, pair, i, sign=1.0):
        rows = np.zeros((len(M), total))
        rows[:, i * k * d : (i + 1) * k * d] = M
        rows[:, y + i : y + i + 2] = sign * pair
        return rows

    for j in (0, N):
        add(of([(0, y + j, 1.0)], 1), [program.given[j]], clarabel.ZeroConeT(1))
        # By itself: a root of the solver's tolerance is no longer small.
        add(of([(0, root + j, 1.0)], 1), [np.sqrt(program.given[j])], clarabel.ZeroConeT(1))
    for i in range(N):
        add(linear(program.A, program.E[i], i, -1.0), program.e[i], clarabel.ZeroConeT(6))
        for sign, end in ((1.0, program.high[i]), (-1.0, -program.low[i])):
            if len(program.R):
                rows = sign * linear(program.R, program.B[i], i)
                add(rows, end, clarabel.NonnegativeConeT(len(program.R)))
        rows = np.zeros((program.C.shape[1], total))
        rows[:, y + i : y + i + 2] = program.C[i]
        add(rows, program.c[i], clarabel.NonnegativeConeT(len(rows)))
        for c in range(k):
            first = (i * k + c) * d
            add(of([(0, first + d - 1, -1.0)], 1), [-program.least[c]], clarabel.NonnegativeConeT(1))
            add(of([(0, first + d - 1, 1.0)], 1), [program.most[c]], clarabel.NonnegativeConeT(1))
            if n := program.friction.round_dimensions:
                cone = of([(0, first + d - 1, -1.0), *((1 + j, first + j, -1.0) for j in range(n))], n + 1)
                add(cone, np.zeros(n + 1), clarabel.SecondOrderConeT(n + 1))
            if len(facets := program.friction.facets):
                rows = np.zeros((len(facets), total))
                rows[:, first : first + d - 1], rows[:, first + d - 1] = facets, -1.0
                add(rows, np.zeros(len(facets)), clarabel.NonnegativeConeT(len(facets)))
        # time (root_i + root_i+1) >= 1
        both = [(0, root + i), (0, root + i + 1)]
        cone = [(r, c, -1.0) for r, c in both] + [(2, c, -1.0) for _, c in both]
        add(of([*cone, (0, time + i, -1.0), (2, time + i, 1.0)], 3), [0, 2, 0], clarabel.SecondOrderConeT(3))
    for j in range(nodes):
        add(of([(0, y + j, -1.0)], 1), [0.0], clarabel.NonnegativeConeT(1))
        add(of([(0, y + j, 1.0)], 1), [program.top[j]], clarabel.NonnegativeConeT(1))
        if np.isnan(program.given[j]):
            cone = [(0, y + j, -1.0), (1, root + j, -2.0), (2, y + j, -1.0)]
            add(of(cone, 3), [1, 0, -1], clarabel.SecondOrderConeT(3))
    q = np.zeros(total)
    q[time:] = 2 * program.step
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.tol_gap_abs = settings.tol_gap_rel = settings.tol_feas = 1e-9
    A = sparse.csc_matrix(sparse.vstack(blocks))
    found = clarabel.DefaultSolver(
        sparse.csc_matrix((total, total)), q, A, np.concatenate(ends), cones, settings
    ).solve()
    return str(found.status), found.obj_val


FRICTION = (Friction(model="cone"), Friction(model="soft", torsion=5e-3), Friction(model="pyramid", edges=8))


@dataclass(frozen=True)
class RandomCarry:
    """A sphere held by contacts at random places, and a random path of the arm."""

    path: ArmPath
    carried: Carried
    problem: ForceProblem
    range_n: tuple[np.ndarray, np.ndarray]
    limits: ArmLimits

    def programs(self, intervals):
        s = np.linspace(0.0, 1.0, intervals + 1)
        loads = self.carried.along(self.path, (s[:-1] + s[1:]) / 2.0, np.array([0.0, 0.0, -9.81]))
        slopes = self.carried.slopes(self.path, s)
        return Programs(self.problem, self.range_n, self.carried, self.limits, loads, slopes)


def random_path(arm, rng):
    """Waypoints well within the limits of the joints, a spline through which stays within them."""
    moving = [arm.joint_names.index(joint) for joint in JOINTS]
    middle, half = (arm.upper + arm.lower)[moving] / 2, (arm.upper - arm.lower)[moving] / 2
    while True:
        count = rng.integers(3, 6)
        way = middle + half * rng.uniform(-0.5, 0.5, (count, len(moving)))
        path = ArmPath.through(dict(zip(JOINTS, way.T)))
        q = path.at(np.linspace(0, 1, 200)).q
        if (np.abs(q - middle) <= half).all():
            return path


def random_carry(arm, seed, k=None, friction=None):
    """What a seed draws."""
    rng = np.random.default_rng(seed)
    k = int(rng.integers(3, 8)) if k is None else k
    friction = FRICTION[rng.integers(len(FRICTION))] if friction is None else friction
    pose = arm.frame_placements(arm.resting, [arm.palm])[0].copy()
    pose[:3, 3] += 0.1 * pose[:3, 2]
    body = pg.Sphere(radius=0.03, mass=float(rng.uniform(0.1, 0.5))).placed(pose)
    angles = np.linspace(0, 2 * np.pi, k, endpoint=False) + rng.uniform(-0.3, 0.3, k)
    outward = np.column_stack([np.cos(angles), np.sin(angles), rng.uniform(-0.3, 0.3, k)])
    outward = outward / np.linalg.norm(outward, axis=1, keepdims=True) @ pose[:3, :3].T
    contacts = [
        Contact(
            finger=f"finger {i}",
            link="",
            point_o=pose[:3, 3] + 0.03 * n,
            rotation_oc=tangent_frame(-n),
            length=None,
            distance=0.0,
        )
        for i, n in enumerate(outward)
    ]
    problem = ForceProblem(
        contacts=ContactSet(contacts=tuple(contacts), com_o=pose[:3, 3]),
        load=[0, 0, -9.81 * body.mass, 0, 0, 0],
        mu=float(rng.uniform(0.4, 0.9)),
        friction=friction,
        object=body,
        max_depth=5e-3,
    )
    effort = np.where(arm.effort > 0, arm.effort, np.inf)
    return RandomCarry(
        path=random_path(arm, rng),
        carried=Carried(arm, arm, body, arm.resting),
        problem=problem,
        range_n=(np.zeros(k), np.full(k, float(rng.uniform(8.0, 30.0)))),
        limits=ArmLimits(torque=effort, speed=arm.velocity, acceleration=np.full(arm.n, np.inf)),
    )
