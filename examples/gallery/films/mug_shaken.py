"""
A mug is picked up and shaken
=============================

An arm lifts a mug from a table, swings it aside and shakes it.
"""

from dataclasses import fields, replace
from pathlib import Path

import numpy as np

import pinograsp as pg
from pinograsp.carry import plan_carry
from pinograsp.carry.scene import carry_scene
from pinograsp.hands.catalogue import file_of
from pinograsp.pick.scene import pick_scene
from pinograsp.spatial import pose_of
from pinograsp.viz.film import write_film

arm, at = file_of("panda"), pose_of((0, 0, 0.1))
home = {"panda_joint2": -0.5, "panda_joint4": -2.0}
home |= {"panda_joint6": 1.6, "panda_joint7": 0.8}
flange = {"link": "panda_link8", "at": at, "remove": ["panda_hand"]}
robot = pg.attach(arm, "allegro_right", posture=home, **flange)
file = Path(pg.__file__).parent / "cases" / "mug.obj"
mug = pg.Mesh.load(file, scale=1e-3, mass=0.25)
mug = mug.placed(pose_of((0.5, 0.2, -mug.vertices[:, 2].min())))
table = pg.Scene.on_table(at=(0.5, 0.0), size=(0.3, 0.64))
pick = pg.plan_pick(robot, mug, table, pg.GraspConditions(mu=0.7), seed=2)

s = np.linspace(0, 1, 41)[:, None]
shares = np.clip([2 * s, 2 * s - 1], 0, 1)  # of the swing, then of the shaking
swing, shaken = 0.5 - 0.5 * np.cos(np.pi * shares[0]), np.sin(6 * np.pi * shares[1])
offsets = swing * [-0.6, -0.2, 0, 0, 0, 0, 0] + shaken * [0.12, 0, 0, 0.1, 0, 0.2, 0]
way = pick.phases[-1].q[-1, robot.arm] + offsets
names = [robot.joint_names[i] for i in robot.arm]
push = pick.carry.disturbance[0]  # that the squeeze withstands on the way as well [N]
carry = plan_carry(robot, pick.grasp, dict(zip(names, way.T)), disturbance=push)
print(pick.status, f"{pick.duration:.1f} s, {carry.times[-1]:.1f} s")

first, then = pick_scene(pick), carry_scene(carry)
still = first.link_poses[-1:, then.link_poses.shape[1] :]  # the table
poses = np.hstack([then.link_poses, np.repeat(still, len(then.times), axis=0)])
then = replace(then, link_poses=poses, times=first.times[-1] + then.times)
values = [(one.name, getattr(first, one.name)) for one in fields(first)]
moving = [n for n, v in values if isinstance(v, np.ndarray) and len(v) == len(first.q)]
joined = {n: np.concatenate([getattr(first, n), getattr(then, n)]) for n in moving}
both = replace(first, **joined, told=first.told + then.told, touch=0.0, closed=0.0)
write_film(both, "mug_shaken.gif", seconds=8)
