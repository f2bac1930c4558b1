"""How far an object may be from where a hand closes on it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from pinograsp.checks import read_only
from pinograsp.contacts.bulk import BulkScene
from pinograsp.contacts.misplaced import ClosingCommands, Pressing, close_misplaced
from pinograsp.hands.servos import CLOSED
from pinograsp.plan.tolerance import SMALLEST, PoseError, PoseTolerance
from pinograsp.spatial import Array, BoolArray

STEP = 0.01  # [s] of the commands
HOLD = 0.4  # [s] after the joints are held where they are
_STIFFNESS = 500.0, 5e4  # [N/m] of a link's contacts, at least and at most
_LARGER = (1.5, 2.0, 3.0, 4.0)  # times the error that is asked about


def sample_commands(
    times: Array,
    q: Array,
    effort: Array,
    *,
    soft: Array,
    stiff: Array,
    limit: Array,
    begin: float = 0.0,
    free: float | None = None,
    step: float = STEP,
) -> ClosingCommands:
    """Commands (m, n) at ``times`` (m,) [s] from ``begin`` on in equal steps, with a hold after them; what is fixed is
    let go at a time ``free`` [s], None: at the last one.

    ``soft``, ``stiff``, ``limit``: as in :class:`~pinograsp.contacts.misplaced.ClosingCommands`.
    """
    complete = int(np.ceil((times[-1] - begin) / step - 1e-9))
    at = np.minimum(begin + step * np.arange(complete + 2), times[-1])
    sampled, efforts = (
        np.column_stack([np.interp(at, times, column) for column in values.T]) for values in (q, effort)
    )
    rates = np.vstack([np.diff(sampled, axis=0) / step, np.zeros((1, q.shape[1]))])
    settled = complete + round(CLOSED / step)
    return ClosingCommands(
        q=sampled,
        dq=rates,
        effort=efforts,
        step=step,
        soft=soft,
        stiff=stiff,
        limit=limit,
        complete=complete,
        free=complete if free is None else round((free - begin) / step),
        settled=settled,
        steps=settled + round(HOLD / step),
    )


def measure_tolerance(
    scene: BulkScene,
    commands: ClosingCommands,
    pressing: Pressing,
    error: PoseError,
    threads: int | None = 1,
    *,
    quick: bool = False,
    known: PoseTolerance | None = None,
) -> PoseTolerance:
    """Errors of all directions: of the size that is asked about, and larger ones until one is lost, or smaller ones.

    ``quick``: of that size alone. ``known``: what that has found.
    """
    gravity = pressing.gravity_o
    up = -gravity / np.linalg.norm(gravity) if pressing.on_table else None
    displaced, turned = error.spread(up)

    def keep(size: float) -> BoolArray:
        places = _places(scene.body.com_o, size * displaced, size * turned)
        return close_misplaced(scene, commands, pressing, places, threads).kept

    def find_worst(kept: BoolArray) -> Array:
        return np.zeros(3) if kept.all() else displaced[int(kept.argmin())] / error.distance

    if known is None:
        asked = keep(1.0)
        share, worst = float(asked.mean()), find_worst(asked)
    else:
        share, worst = known.kept, known.worst
    reached = float(share == 1.0)
    for size in () if quick else _LARGER if reached else (SMALLEST,):
        kept = keep(size)
        if not kept.all():
            worst = find_worst(kept)
            break
        reached = size
    return PoseTolerance(
        distance=reached * error.distance,
        angle=reached * error.angle,
        kept=share,
        asked_distance=error.distance,
        asked_angle=error.angle,
        count=error.count,
        on_table=pressing.on_table,
        worst=read_only(worst),
    )


def _places(centre: Array, displaced: Array, turned: Array) -> Array:
    """Motions of the world (N, 4, 4) that turn an object about its centre of mass, and displace it."""
    places = np.tile(np.eye(4), (len(displaced), 1, 1))
    for place, by, turn in zip(places, displaced, turned):
        place[:3, :3] = pin.exp3(np.array(turn))
        place[:3, 3] = centre + by - place[:3, :3] @ centre
    return places


def stiffness_of_links(scene: BulkScene, links: Sequence[str], slopes: Array) -> Array:
    """Stiffness (p,) [N/m] of a scene's parts, from that of contacts (k,) of ``links``; others have their mean."""
    planned: dict[str, float] = {}
    for link, slope in zip(links, slopes.tolist()):
        planned[link] = planned.get(link, 0.0) + slope
    mean = float(np.mean(list(planned.values())))
    return np.clip([planned.get(part.link, mean) for part in scene.parts], *_STIFFNESS)
