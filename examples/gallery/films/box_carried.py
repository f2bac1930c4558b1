"""
An arm carries a box
====================

A Panda carries a box as fast as grasp and motors allow; the forces follow the motion.
"""

import numpy as np

import pinograsp as pg
from pinograsp.carry import plan_carry
from pinograsp.hands.catalogue import file_of
from pinograsp.spatial import pose_of

joints = [f"panda_joint{i}" for i in range(1, 8)]
begin = [0.3, -0.4, 0.2, -2.0, 0.3, 1.9, 0.5]
middle = [0.8, 0.0, 0.3, -1.6, 0.2, 1.9, 1.2]
end = [1.4, 0.4, -0.2, -1.2, -0.3, 1.5, 0.4]
arm = pg.load_hand(file_of("panda"), posture=dict(zip(joints, begin)))
palm = arm.frame_placements(arm.resting, ["panda_hand"])[0]
box = pg.Box(size=(0.04, 0.04, 0.06), mass=0.2)
box = box.placed(palm @ pose_of((0, 0, 0.1034)))
grasp = pg.plan_grasp_on(arm, box, pg.GraspConditions(mu=0.6))
way = dict(zip(joints, np.transpose([begin, middle, end])))
carried = plan_carry(arm, grasp, way)
print(grasp.status, f"{carried.times[-1]:.2f} s")

carried.film("box_carried.gif", view=(0.3, 1, 0.4), seconds=3)
