"""Grasp phase of a closed finger: the surface of its links, not the points that touched first, goes in as planned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from pinograsp.checks import frozen
from pinograsp.contacts import ContactSet, PenetrationProfile
from pinograsp.contacts.penetration import Penetration
from pinograsp.hands import Finger, HandModel
from pinograsp.motion.contact_ik import ContactPostures
from pinograsp.motion.grasp_ik import FingerMotion, press
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

# Contact points must follow their path to this [m]; a thousandth of a typical penetration.
TRACKED = 1e-6
# Those of closed fingers to this share of their depth: joints that press several can give it to first order only.
_SHARE = 0.01
# Rounds that make up for links that turn as they press, and times at which they are looked at: the turn is smooth.
_ROUNDS, _KNOTS = 8, 5
_WELL = 2e-4  # share of their depth to which surfaces are brought
# Surfaces may miss their depth by this between those times [m]: half a per cent of a force of 5 N.
_SURFACE = 1e-5


def press_surfaces(
    hand: HandModel,
    finger: Finger,
    contacts: ContactSet,
    which: Sequence[int],
    found: ContactPostures,
    body: Body | None,
    profile: PenetrationProfile,
    times: Array,
    deeper: Array,
) -> FingerMotion:
    """The grasp phase of a closed finger whose links' surfaces go in by ``profile``.

    Args:
        hand: the closed hand.
        finger: its finger that moves.
        contacts: all contacts, with the posture of the closed hand.
        which: those of the finger.
        found: the finger's posture and its contact points.
        body: what is held; None: not known, so that the points that touched first go in by ``profile``.
        profile: penetration of all contacts.
        times: samples (m,) [s] from t_I to t_F.
        deeper: how much deeper than ``profile`` all contacts go in the end (k,) [m].
    """
    own = [contacts[i] for i in which]
    first = int(np.argmax(profile.final_depth))  # all contacts take the same course
    more = np.outer(profile.depth(times)[:, first] / profile.final_depth[first], deeper[list(which)])
    knots = np.unique(np.linspace(0, times.size - 1, _KNOTS).astype(int))

    def pressed(deeper: Array) -> FingerMotion:
        spline: Array = CubicSpline(times[knots], deeper)(times)
        start, points = found.angles[0], found.points_l[0]
        return press(
            hand,
            finger,
            own,
            start,
            points,
            profile,
            which,
            times,
            normals_first=True,
            deeper=spline + more,
            posture=contacts.posture,
        )

    asked = np.zeros((knots.size, len(own)))
    best = pressed(asked)
    if body is None or contacts.posture is None:
        return best
    surfaces = Penetration(hand, body, contacts)
    least, off = np.inf, np.zeros(len(own))
    last: tuple[Array, Array] | None = None  # the last change of what is asked, and the depths before it
    slope = np.ones_like(asked)  # by secants: what rolls to another place of its link moves faster or slower there
    for i in range(_ROUNDS):
        motion = pressed(asked) if i else best
        if off_path(motion, profile, which).any():
            break  # a path that cannot be followed is not mended by asking for more
        q, depths = np.array(contacts.posture), np.empty_like(asked)
        for row, knot in enumerate(knots):
            q[finger.dofs] = motion.q[knot]
            depths[row] = surfaces.at(q, which)[0]
        missing = (profile.depth(times)[:, list(which)] + more)[knots] - depths
        if np.abs(missing).max() < least:
            best, least, off = motion, float(np.abs(missing).max()), np.abs(missing).max(axis=0)
        if np.all(np.abs(missing).max(axis=0) < np.maximum(TRACKED, _WELL * profile.final_depth[list(which)])):
            return motion
        if last is not None:
            change, reached = last
            moved = np.abs(change) > TRACKED
            slope[moved] = np.clip((depths - reached)[moved] / change[moved], 0.1, 2.0)
        last = missing / slope, depths
        asked = asked + last[0]
    # A surface that has other places in the way (links with edges) is off by what is left.
    kept = not off_path(best, profile, which).any()
    seen = replace(best, errors=frozen(np.maximum(best.errors, np.where(off > _SURFACE, off, 0.0))))
    return replace(seen, surfaces=bool(kept and off_path(seen, profile, which).any()))


def off_path(motion: FingerMotion, profile: PenetrationProfile, which: Sequence[int]) -> NDArray[np.bool_]:
    """Which contacts (c,) of a closed finger miss their depths by more than is negligible."""
    allowed = np.maximum(TRACKED, _SHARE * profile.final_depth[list(which)])
    return np.asarray(motion.errors.max(axis=0) > allowed)
