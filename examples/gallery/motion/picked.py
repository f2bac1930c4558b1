"""
Picked from a table
===================

A Panda takes a can, carries it over a wall and puts it down.
"""

import pinograsp as pg
from pinograsp.hands.catalogue import file_of
from pinograsp.spatial import pose_of

home = {"panda_joint2": -0.5, "panda_joint4": -2.0}
home |= {"panda_joint6": 1.6, "panda_joint7": 0.8}
robot = pg.attach(
    file_of("panda"), "panda", link="panda_link8", remove=["panda_hand"], posture=home
)
scene = pg.Scene.on_table(at=(0.45, 0.0), size=(0.5, 0.8))
scene = scene.with_box("wall", (0.2, 0.02, 0.2), at=(0.5, 0.0, 0.1))
can = pg.Cylinder(radius=0.03, height=0.12, mass=0.3)
can = can.placed(pose_of((0.5, 0.25, 0.06)))
conditions = pg.GraspConditions(mu=0.6)
pick = pg.plan_pick(robot, can, scene, conditions, place=(0.5, -0.25, 0.06), seed=5)
print(pick.status, f"{pick.duration:.1f} s")

pick.picture("picked.png", view=(1, -0.25, 0.5))
