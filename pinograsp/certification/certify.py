"""Grasps that others made, judged: contacts, forces, torques, reserve, and the reason where one does not hold."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from pinograsp.certification.commands import Commands
from pinograsp.certification.record import Certificates
from pinograsp.certification.setup import CertifyArguments, Options, prepare
from pinograsp.certification.verdicts import certify_block
from pinograsp.checks import array_of, instance_of, placements_of
from pinograsp.contacts import open_and_closed
from pinograsp.contacts.jaw_closing import close_jaws
from pinograsp.core.threads import share_out
from pinograsp.errors import InvalidInput
from pinograsp.forces import GraspConditions
from pinograsp.hands import HandModel
from pinograsp.objects.body import Body
from pinograsp.spatial import Array

if TYPE_CHECKING:
    from typing_extensions import Unpack

BLOCK = 1024  # postures at once


class Certifier:
    """A hand, an object and the conditions of its grasps, prepared once for any number of postures.

    Arguments and errors are those of :func:`certify`.
    """

    def __init__(
        self,
        hand: HandModel,
        body: Body,
        conditions: GraspConditions,
        **options: Unpack[CertifyArguments],
    ):
        self._setup = prepare(hand, body, conditions, Options(**options))

    def __call__(
        self, postures: ArrayLike, roots: ArrayLike | None = None, commands: Commands | None = None
    ) -> Certificates:
        """The certificates of postures (N, n) with the hand's root at ``roots`` (N, 4, 4), or where the hand is."""
        hand = self._setup.hand
        q = array_of("postures", postures, (None, hand.n))
        if roots is None:
            placed: Array = np.tile(hand.pose, (len(q), 1, 1))
        else:
            placed = placements_of("roots", roots, len(q))
        instance_of("commands", commands, Commands, type(None))
        if commands is not None and (len(commands), commands.q.shape[2]) != q.shape:
            raise InvalidInput(
                f"commands: expected those of {len(q)} grasps by {hand.n} joints, got {len(commands)} by "
                f"{commands.q.shape[2]}"
            )
        return self._certify(q, placed, commands)

    def jaws(self, roots: ArrayLike) -> Certificates:
        """Certify jaws (a hand of one joint) that close with their root at ``roots`` (N, 4, 4).

        They close until they touch, see :func:`~pinograsp.contacts.jaw_closing.close_jaws`. As commanded (``commanded``
        or a protocol), they are commanded to close completely, and press with the effort of their motor.
        """
        placed = array_of("roots", roots, (None, 4, 4))
        placed = placements_of("roots", placed, len(placed))
        setup = self._setup
        q, moved, _ = close_jaws(setup.scene, placed)
        commands = None
        if setup.options.commanded or setup.options.protocol is not None:
            stages = np.array(open_and_closed(setup.hand, setup.body))
            commands = Commands(np.tile(stages, (len(q), 1, 1)), np.repeat(placed[:, None], 2, axis=1))
        return self._certify(q, moved, commands)

    def _certify(self, q: Array, placed: Array, commands: Commands | None = None) -> Certificates:
        setup, starts = self._setup, range(0, max(len(q), 1), BLOCK)
        if len(starts) > 1:  # whole blocks on threads of their own: what is left in Python takes turns
            setup = replace(setup, options=replace(setup.options, threads=1))

        def certify_from(start: int) -> Certificates:
            some = slice(start, start + BLOCK)
            told = None if commands is None else (commands.q[some], commands.roots[some])
            return certify_block(setup, q[some], placed[some], told)

        return Certificates.join(share_out(certify_from, starts, self._setup.options.threads))


def certify(
    hand: HandModel,
    body: Body,
    postures: ArrayLike,
    conditions: GraspConditions,
    *,
    roots: ArrayLike | None = None,
    commands: Commands | None = None,
    **options: Unpack[CertifyArguments],
) -> Certificates:
    """Certify whether grasps hold ``body``, each from its posture: forces, torques, reserve, or the reason; without any
    motion.

    Args:
        hand: the hand.
        body: the object, in its place.
        postures: of the joints (N, n) [rad or m], in the order of ``hand.joint_names``; coupled joints follow.
        conditions: friction, gravity, torque limits and the reserve. A grasp is held if one squeeze holds the weight
            and everything that the reserve adds, see :func:`~pinograsp.forces.bulk.elastic.find_offsets`.
        roots: oMh, the hand's root frame in the world for each posture (N, 4, 4); None: that of the hand.
        commands: commands of the motors for each posture, as in data sets, for the second verdict: whether the grasp
            holds *as commanded*.
        **options: what counts as a contact and as held:

            - ``tolerance``: distance from the surface [m] up to which a link touches, outside or inside (2 mm); deeper
              ones penetrate.
            - ``palm``: whether the palm's contact counts (True).
            - ``patches``: contacts at up to four corners of a flat area (True); else one in its middle.
            - ``exact``: if the quick method finds no squeeze for the reserve, solve the full program, some 10 ms each
              (True); else such grasps are ``RESERVE`` at once.
            - ``drives``: whether to reject forces that the hand's drives cannot produce together (True); ``producible``
              has this in any case.
            - ``protocol``: a published benchmark whose loads replace the weight and the reserve
              (:data:`~pinograsp.certification.PROTOCOLS`), with the conditions of :meth:`Protocol.conditions
              <pinograsp.certification.Protocol.conditions>`.
            - ``commanded``: try grasps without ``commands`` with position references that produce the torques of their
              certified forces (False).
            - ``threads``: of the compiled core, which finds touches and forces; one for each core by default.

    Raises:
        InvalidInput: shapes that do not match, a hand without geometry, or conditions that cannot be used.
        ExtraMissing: the compiled core, or for objects that are not convex coacd (extra ``mesh``).

    Example:
        >>> import numpy as np
        >>> import pinograsp as pg
        >>> hand, ball = pg.load_hand("panda"), pg.Sphere(radius=0.02, mass=0.1)
        >>> down = pg.spatial.rotation_rpy(np.pi, 0, 0)
        >>> roots = [pg.spatial.pose_of([x, 0, 0.1034], down) for x in (0.0, 0.004, 0.03)]
        >>> q, conditions = [[0.02], [0.0197], [0.02]], pg.GraspConditions(mu=0.6)
        >>> found = pg.certify(hand, ball, q, conditions, roots=roots)  # the last one misses
        >>> print(found.held, found.words(2))
        [ True  True False] fewer than two links touch the object (the nearest is 9.2 mm away)

    See Also:
        :func:`~pinograsp.sweep.certify_files` for the files of a data set.
    """
    return Certifier(hand, body, conditions, **options)(postures, roots, commands)
