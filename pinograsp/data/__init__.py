"""Grasps of public data sets: files read without executing them, placed on a hand's own description, and written back
with forces.
"""

from pinograsp.data.alignment import Alignment, JointAxes, alignment, joint_axes
from pinograsp.data.conventions import CONVENTIONS, Convention
from pinograsp.data.format import Format
from pinograsp.data.formats import FORMATS
from pinograsp.data.placing import place_hand
from pinograsp.data.reading import read_grasps
from pinograsp.data.rows import GraspRows
from pinograsp.data.writing import join_rows, write_grasps

__all__ = [
    "CONVENTIONS",
    "FORMATS",
    "Alignment",
    "Convention",
    "Format",
    "GraspRows",
    "JointAxes",
    "alignment",
    "join_rows",
    "joint_axes",
    "place_hand",
    "read_grasps",
    "write_grasps",
]
