"""The hands of the catalogue, loaded once in a process, and what their files say of them."""

from __future__ import annotations

import functools

from urdf_oracle import Description

from pinograsp.hands import load_hand
from pinograsp.hands.catalogue import CATALOGUE, file_of
from pinograsp.hands.summary import overview

SOME_HANDS = ("humanoid", "allegro_right", "psyonic_left", "panda", "so101", "baxter_left")  # one of each kind

loaded = functools.cache(load_hand)
listed = functools.cache(overview)


def repaired(joint, followed):
    """The file of the Psyonic hands names mimic joints without the side; everything else is as it says."""
    return followed if not joint.startswith(("Left_", "Right_")) else f"{joint.split('_')[0]}_{followed}"


@functools.cache
def described(file, root):
    return Description(file, root, repaired)


def oracle(name):
    return described(file_of(name), CATALOGUE[name].root)
