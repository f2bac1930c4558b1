"""Where public descriptions of hands have their joints, at zero: facts of the files that data sets were made with.

A line has a joint's name, a point of its axis [m] and the axis' direction, in the frame that is said.
"""

from __future__ import annotations

import numpy as np

from pinograsp.checks import read_only
from pinograsp.data.alignment import JointAxes


def _axes(text: str) -> JointAxes:
    names = [line.split()[0] for line in text.split("\n") if line]
    numbers = np.array([[float(one) for one in line.split()[1:]] for line in text.split("\n") if line])
    directions = numbers[:, 3:] / np.linalg.norm(numbers[:, 3:], axis=1, keepdims=True)
    return JointAxes(names=tuple(names), origins=read_only(numbers[:, :3]), directions=read_only(directions))


# Shadow hand in the frame of ``robot0:palm``: grasp_generation/mjcf/shadow_hand_wrist_free.xml of PKU-EPIC/DexGraspNet.
SHADOW_OLD = _axes(
    """
robot0:FFJ3        0.033        0    0.095         0        1        0
robot0:FFJ2        0.033        0    0.095         1        0        0
robot0:FFJ1        0.033        0     0.14         1        0        0
robot0:FFJ0        0.033        0    0.165         1        0        0
robot0:MFJ3        0.011        0    0.099         0        1        0
robot0:MFJ2        0.011        0    0.099         1        0        0
robot0:MFJ1        0.011        0    0.144         1        0        0
robot0:MFJ0        0.011        0    0.169         1        0        0
robot0:RFJ3       -0.011        0    0.095         0        1        0
robot0:RFJ2       -0.011        0    0.095         1        0        0
robot0:RFJ1       -0.011        0     0.14         1        0        0
robot0:RFJ0       -0.011        0    0.165         1        0        0
robot0:LFJ4       -0.017        0    0.044   0.57098        0  0.82097
robot0:LFJ3       -0.034        0    0.088         0        1        0
robot0:LFJ2       -0.034        0    0.088         1        0        0
robot0:LFJ1       -0.034        0    0.133         1        0        0
robot0:LFJ0       -0.034        0    0.158         1        0        0
robot0:THJ4        0.034   -0.009    0.029  -0.70682        0 -0.70739
robot0:THJ3        0.034   -0.009    0.029   0.70739        0 -0.70682
robot0:THJ2      0.06086   -0.009  0.05588   0.70739        0 -0.70682
robot0:THJ1      0.06086   -0.009  0.05588         0        1        0
robot0:THJ0      0.08348   -0.009  0.07852         0        1        0
"""
)

# Shadow hand in the frame of ``rh_palm``: shadow_hand/right_sim.urdf of JYChen18/BODex; shadow_hand/right_hand.xml of
# google-deepmind/mujoco_menagerie and shadow_hand_right.urdf of dexsuite/dex-urdf agree within 0.1 mm.
SHADOW = _axes(
    """
rh_FFJ4            0.033        0    0.095         0       -1        0
rh_FFJ3            0.033        0    0.095         1        0        0
rh_FFJ2            0.033        0     0.14         1        0        0
rh_FFJ1            0.033        0    0.165         1        0        0
rh_MFJ4            0.011        0    0.099         0       -1        0
rh_MFJ3            0.011        0    0.099         1        0        0
rh_MFJ2            0.011        0    0.144         1        0        0
rh_MFJ1            0.011        0    0.169         1        0        0
rh_RFJ4           -0.011        0    0.095         0        1        0
rh_RFJ3           -0.011        0    0.095         1        0        0
rh_RFJ2           -0.011        0     0.14         1        0        0
rh_RFJ1           -0.011        0    0.165         1        0        0
rh_LFJ5           -0.033        0  0.02071   0.57358        0  0.81915
rh_LFJ4           -0.033        0   0.0865         0        1        0
rh_LFJ3           -0.033        0   0.0865         1        0        0
rh_LFJ2           -0.033        0   0.1315         1        0        0
rh_LFJ1           -0.033        0   0.1565         1        0        0
rh_THJ5            0.034 -0.00858    0.029  -0.70711        0 -0.70711
rh_THJ4            0.034 -0.00858    0.029   0.70711        0 -0.70711
rh_THJ3          0.06087 -0.00858  0.05587   0.70711        0 -0.70711
rh_THJ2          0.06087 -0.00858  0.05587         0       -1        0
rh_THJ1           0.0835 -0.00858   0.0785         0       -1        0
"""
)

# Shadow hand in the frame of ``root``: graspqp/assets/shadow_hand/shadow_hand.urdf of leggedrobotics/graspqp.
SHADOW_GRASPQP = _axes(
    """
robot0_FFJ0        0.033  0.09421  -0.0273         1        0        0
robot0_FFJ1        0.033  0.06922  -0.0278         1        0        0
robot0_FFJ2        0.033  0.02423 -0.02871         1        0        0
robot0_FFJ3        0.033  0.02423 -0.02871         0  0.02012  -0.9998
robot0_LFJ0       -0.034  0.08722 -0.02744         1        0        0
robot0_LFJ1       -0.034  0.06222 -0.02794         1        0        0
robot0_LFJ2       -0.034  0.01723 -0.02885         1        0        0
robot0_LFJ3       -0.034  0.01723 -0.02885         0  0.02012  -0.9998
robot0_LFJ4       -0.017 -0.02676 -0.02973   0.57097   0.8208  0.01652
robot0_MFJ0        0.011  0.09821 -0.02722         1        0        0
robot0_MFJ1        0.011  0.07322 -0.02772         1        0        0
robot0_MFJ2        0.011  0.02823 -0.02863         1        0        0
robot0_MFJ3        0.011  0.02823 -0.02863         0  0.02012  -0.9998
robot0_RFJ0       -0.011  0.09421  -0.0273         1        0        0
robot0_RFJ1       -0.011  0.06922  -0.0278         1        0        0
robot0_RFJ2       -0.011  0.02423 -0.02871         1        0        0
robot0_RFJ3       -0.011  0.02423 -0.02871         0  0.02012  -0.9998
robot0_THJ0      0.08348  0.00757 -0.02004         0  0.02012  -0.9998
robot0_THJ1      0.06086 -0.01506 -0.02049         0  0.02012  -0.9998
robot0_THJ2      0.06086 -0.01506 -0.02049   0.70739 -0.70668 -0.01422
robot0_THJ3        0.034 -0.04194 -0.02104   0.70739 -0.70668 -0.01422
robot0_THJ4        0.034 -0.04194 -0.02104  -0.70682 -0.70725 -0.01424
robot0_WRJ0            0 -0.07075 -0.03062         1        0        0
robot0_WRJ1            0 -0.10475  -0.0313         0  0.02012  -0.9998
"""
)

# Allegro hand, right, in the frame of ``palm_link`` (``base_link``): allegro_hand_description_right.urdf of
# JYChen18/BODex, tylerlum/get_a_grip and DexGraspNet (branch allegro); allegro_hand_right.urdf of dexsuite/dex-urdf.
ALLEGRO = _axes(
    """
joint_0.0              0   0.0435 -0.00154         0  0.08716  0.99619
joint_1.0              0  0.04493   0.0148         0  0.99619 -0.08716
joint_2.0              0  0.04964  0.06859         0  0.99619 -0.08716
joint_3.0              0  0.05298  0.10684         0  0.99619 -0.08716
joint_4.0              0        0   0.0007         0        0        1
joint_5.0              0        0   0.0171         0        1        0
joint_6.0              0        0   0.0711         0        1        0
joint_7.0              0        0   0.1095         0        1        0
joint_8.0              0  -0.0435 -0.00154         0 -0.08716  0.99619
joint_9.0              0 -0.04493   0.0148         0  0.99619  0.08716
joint_10.0             0 -0.04964  0.06859         0  0.99619  0.08716
joint_11.0             0 -0.05298  0.10684         0  0.99619  0.08716
joint_12.0       -0.0182  0.01933 -0.04599         0 -0.08716 -0.99619
joint_13.0       -0.0132  0.05673 -0.07636         0  0.99619 -0.08716
joint_14.0       -0.0132  0.07436  -0.0779         1        0        0
joint_15.0       -0.0132  0.12557 -0.08238         1        0        0
"""
)

# Allegro hand, right, in the frame of ``allegro``: graspqp/assets/allegro/allegro_hand.urdf of leggedrobotics/graspqp.
ALLEGRO_GRASPQP = _axes(
    """
index_joint_0    0.04636   0.0414  -0.0313   0.08804  0.99612 -0.00005
index_joint_1    0.04636   0.0414  -0.0313   0.99611 -0.08808  0.00014
index_joint_2    0.05112  0.09519  -0.0313   0.99611 -0.08808  0.00014
index_joint_3     0.0545  0.13344  -0.0313   0.99611 -0.08808  0.00014
middle_joint_0   0.00127  0.04374  -0.0313   0.00089        1 -0.00005
middle_joint_1   0.00127  0.04374  -0.0313         1 -0.00094  0.00014
middle_joint_2   0.00132  0.09774  -0.0313         1 -0.00094  0.00014
middle_joint_3   0.00135  0.13614  -0.0313         1 -0.00094  0.00014
ring_joint_0    -0.04383  0.04147  -0.0313  -0.08627  0.99627 -0.00005
ring_joint_1    -0.04383  0.04147  -0.0313   0.99628  0.08622  0.00014
ring_joint_2    -0.04849  0.09527  -0.0313   0.99628  0.08622  0.00014
ring_joint_3     -0.0518  0.13353  -0.0313   0.99628  0.08622  0.00014
thumb_joint_0     0.0181 -0.04675  -0.0495  -0.08795 -0.99613        0
thumb_joint_1     0.0181 -0.04675  -0.0445   0.99612 -0.08799  0.00005
thumb_joint_2    0.07328 -0.05163  -0.0445  -0.00008   0.0001        1
thumb_joint_3    0.12448 -0.05615 -0.04449  -0.00008   0.0001        1
"""
)

# LEAP hand, right, in the frame of ``hand_base_link``: leap_description/urdf/leap_hand_simplified.urdf of
# JYChen18/BODex; leap_hand/right_hand.xml of mujoco_menagerie agrees within 0.1 mm.
LEAP = _axes(
    """
j0                 0.031  0.00856 -0.00652         0        0       -1
j1               -0.0071  0.02306 -0.01872         0        1        0
j2                 0.046  0.02286 -0.01952         0        1        0
j3                0.0821  0.02266 -0.01952         0        1        0
j4                 0.031 -0.03689 -0.00652         0        0       -1
j5               -0.0071 -0.02239 -0.01872         0        1        0
j6                 0.046 -0.02259 -0.01952         0        1        0
j7                0.0821 -0.02279 -0.01952         0        1        0
j8                 0.031 -0.08234 -0.00652         0        0       -1
j9               -0.0071 -0.06784 -0.01872         0        1        0
j10                0.046 -0.06804 -0.01952         0        1        0
j11               0.0821 -0.06824 -0.01952         0        1        0
j12              -0.0694 -0.00124 -0.02162        -1        0        0
j13              -0.0824  0.01306 -0.02162         0        1        0
j14              -0.0824  0.03006 -0.00712         0        0       -1
j15              -0.0824  0.07666 -0.00692         0        0       -1
"""
)
