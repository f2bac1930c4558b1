"""Carrying by another solver, from a program written row by row; and random paths and grasps."""

from dataclasses import dataclass
from itertools import chain

import ecos
import numpy as np
from panda_path import JOINTS
from scipy import sparse

import pinograsp as pg
from pinograsp.carry import ArmPath
from pinograsp.carry.constraints import ArmLimits, GraspLimits, PathConstraints
from pinograsp.carry.loads import LoadedRobot
from pinograsp.contacts import Contact, ContactSet, Friction
from pinograsp.forces import ForceProblem
from pinograsp.spatial import tangent_frame


def pairs(along_a, along_b, step):
    return np.stack([along_b / 2 - along_a / (2 * step), along_b / 2 + along_a / (2 * step)], axis=2)


def by_ecos(program):
    """The least time by ECOS, None where it finds none: the program written row by row, nothing left out or scaled."""
    N, k, d = program.count, program.k, program.friction.d
    root, time = N * k * d + N + 1, N * k * d + 2 * (N + 1)
    y, total = N * k * d, time + N
    equal, below, cones = [], [], []  # rows with their right-hand sides: A u = b, G u <= h, h - G u in a cone

    def row(*entries):
        found = np.zeros(total)
        for column, value in entries:
            found[column] = value
        return found

    for j in (0, N):
        equal += [(row((y + j, 1.0)), program.given[j]), (row((root + j, 1.0)), np.sqrt(program.given[j]))]
    for i in range(N):
        forces, pair = slice(i * k * d, (i + 1) * k * d), slice(y + i, y + i + 2)
        equal += [(row((forces, a), (pair, -E)), e) for a, E, e in zip(program.A, program.E[i], program.e[i])]
        for r, b, low, high in zip(program.R, program.B[i], program.low[i], program.high[i]):
            below += [(row((forces, r), (pair, b)), high), (row((forces, -r), (pair, -b)), -low)]
        below += [(row((pair, c)), end) for c, end in zip(program.C[i], program.c[i])]
        for c in range(k):
            first, normal = (i * k + c) * d, (i * k + c) * d + d - 1
            below += [(row((normal, -1.0)), -program.least[c]), (row((normal, 1.0)), program.most[c])]
            below += [(row((slice(first, normal), u), (normal, -1.0)), 0.0) for u in program.friction.facets]
            if n := program.friction.round_dimensions:
                cones.append([(row((normal, -1.0)), 0.0), *((row((first + j, -1.0)), 0.0) for j in range(n))])
        # time (root_i + root_i+1) >= 1
        both = slice(root + i, root + i + 2)
        product = [row((both, -1.0), (time + i, -1.0)), row(), row((both, -1.0), (time + i, 1.0))]
        cones.append(list(zip(product, (0.0, 2.0, 0.0))))
    for j in range(N + 1):
        below += [(row((y + j, -1.0)), 0.0), (row((y + j, 1.0)), program.top[j])]
        if np.isnan(program.given[j]):
            cones.append([(row((y + j, -1.0)), 1.0), (row((root + j, -2.0)), 0.0), (row((y + j, -1.0)), -1.0)])
    below = [one for one in below if np.isfinite(one[1])]
    A, b, G, h = (np.array(part) for rows in (equal, [*below, *chain(*cones)]) for part in zip(*rows))
    q = row((slice(time, total), 2 * program.step))
    sizes = {"l": len(below), "q": [len(cone) for cone in cones]}
    found = ecos.solve(q, sparse.csc_matrix(G), h, sizes, sparse.csc_matrix(A), b, verbose=False, max_iters=200)
    return found["info"]["pcost"] if found["info"]["exitFlag"] in (0, 10) else None


FRICTION = (Friction(model="cone"), Friction(model="soft", torsion=5e-3), Friction(model="pyramid", edges=8))


@dataclass(frozen=True)
class RandomCarry:
    """A sphere held by contacts at random places, and a random path of the arm."""

    path: ArmPath
    carried: LoadedRobot
    problem: ForceProblem
    range_n: tuple[np.ndarray, np.ndarray]
    limits: ArmLimits

    def constrain(self, intervals):
        s = np.linspace(0.0, 1.0, intervals + 1)
        loads = self.carried.along(self.path, (s[:-1] + s[1:]) / 2.0, np.array([0.0, 0.0, -9.81]))
        slopes, swift = self.carried.slopes(self.path, s)
        least, most = self.range_n
        grasp = GraspLimits(problem=self.problem, least=least, most=most, spare=np.zeros(len(most)))
        return PathConstraints(
            grasp=grasp, arm=self.limits, loaded=self.carried, middle=loads, slopes=slopes, object_slopes=swift
        )


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
        carried=LoadedRobot(arm, arm, body, arm.resting),
        problem=problem,
        range_n=(np.zeros(k), np.full(k, float(rng.uniform(8.0, 30.0)))),
        limits=ArmLimits(torque=effort, speed=arm.velocity, acceleration=np.full(arm.n, np.inf)),
    )
