"""Palm, fingers and fingertips, found from the tree of links and from which of them have geometry."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, get_args

from pinograsp.errors import HandNotLoaded

if TYPE_CHECKING:
    import yourdfpy

Moving: TypeAlias = Literal["revolute", "prismatic"]
MOVING: tuple[Moving, ...] = get_args(Moving)
_LONGEST_FINGER = 7  # moving joints


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A moving joint of a finger, and the links fixed to its child; on the last part the fingertip comes last."""

    joint: yourdfpy.Joint
    fixed: tuple[str, ...] = ()

    @property
    def links(self) -> tuple[str, ...]:
        """The joint's child and what is fixed to it."""
        return (self.joint.child, *self.fixed)


def find_fingers(
    source: str,
    joints: list[yourdfpy.Joint],
    links: list[str],
    touches: Callable[[str], bool],
    fingers_of: Callable[[list[list[Part]]], list[list[Part]]],
    palm: str | None,
    names: dict[str, str] | None,
    called: Callable[[list[list[Part]]], list[str]],
) -> tuple[str, dict[str, list[Part]]]:
    """Palm link and, by finger name, the moving joints from palm to fingertip.

    Args:
        source: for errors.
        joints, links: of the description, one tree.
        touches: whether a link has geometry that can touch something.
        fingers_of: those of chains that can touch that are fingers.
        palm: link the fingers start from; None: the first at which moving chains part.
        names: ``{finger name: a link of its outermost part}``; None: every chain that can touch.
        called: names of chains, where none are given.

    Raises:
        HandNotLoaded: unknown links, or no moving chain.
    """
    tree = _Tree(joints, links)
    if palm is None:
        palm = tree.palm()
    elif palm not in tree.below:
        raise HandNotLoaded(source, f"palm '{palm}' is not a link; links: {', '.join(links)}")
    chains = [chain for joint in tree.below[palm] if tree.moves(joint) for chain in tree.chains(joint)]
    if not chains:
        raise HandNotLoaded(source, f"no moving chain starts at palm '{palm}'")
    if names is None:
        # Levers of a linkage and free axles carry no geometry: nothing for an object to touch.
        touching = [chain for chain in chains if any(touches(link) for part in chain for link in part.links)] or chains
        touching = fingers_of(touching)
        return palm, dict(zip(called(touching), touching))
    chosen: dict[str, list[Part]] = {}
    problems: list[str] = []
    for name, link in names.items():
        # A link near the palm may belong to several chains; on the outermost part it belongs to one.
        matching = [chain for chain in chains if link in chain[-1].links] or [
            chain for chain in chains if any(link in part.links for part in chain)
        ]
        tips = ", ".join(tip_of(chain) for chain in matching or chains)
        if not matching:
            problems.append(f"finger '{name}': link '{link}' is on no finger; fingertips: {tips}")
        elif len(matching) > 1:
            problems.append(f"finger '{name}': link '{link}' is on several fingers; name one of their tips: {tips}")
        else:
            chosen[name] = _with_tip(matching[0], link)
    if problems:
        raise HandNotLoaded(source, problems)
    return palm, chosen


def palms_in(
    joints: list[yourdfpy.Joint], links: list[str], touches: Callable[[str], bool], near: Callable[[str, str], bool]
) -> list[str]:
    """Links of a robot that may be palms: at least two short chains that can touch part there, all tips ``near``.

    Of one inside another the outer counts.
    """
    tree = _Tree(joints, links)
    found: list[str] = []
    waiting = [tree.root]
    while waiting:
        link = waiting.pop()
        chains = [chain for joint in tree.below[link] if tree.moves(joint) for chain in tree.chains(joint)]
        starts = sum(tree.moves(joint) for joint in tree.below[link])
        solid = [chain for chain in chains if any(touches(one) for part in chain for one in part.links)]
        short = max(map(len, chains), default=0) <= _LONGEST_FINGER
        if starts > 1 and len(solid) > 1 and short and all(near(link, tip_of(chain)) for chain in solid):
            found.append(link)
        else:
            waiting += [joint.child for joint in tree.below[link]]
    return found


def joints_before(joints: list[yourdfpy.Joint], palm: str) -> int:
    """How many moving joints come before a palm."""
    above = {joint.child: joint for joint in joints}
    count = 0
    while palm in above:
        count += above[palm].type in MOVING
        palm = above[palm].parent
    return count


def with_followed(joints: list[yourdfpy.Joint], followed: Mapping[str, str], link: str) -> str:
    """The link nearest to ``link``, itself or before it, beyond which are all joints that those beyond it follow."""
    above = {joint.child: joint for joint in joints}
    before: dict[str, set[str]] = {}  # links before a joint that follows or is followed
    for joint in joints:
        if joint.name in followed or joint.name in followed.values():
            parent = joint
            before[joint.name] = {parent.parent}
            while parent.parent in above:
                parent = above[parent.parent]
                before[joint.name].add(parent.parent)
    while link in above and any(link in before[name] and link not in before[other] for name, other in followed.items()):
        link = above[link].parent
    return link


def tip_of(chain: list[Part]) -> str:
    """The link fixed outermost beyond the last joint."""
    return chain[-1].links[-1]


def _with_tip(chain: list[Part], link: str) -> list[Part]:
    """The chain with ``link`` as its tip, where it is fixed beyond the last joint."""
    last = chain[-1]
    if link not in last.fixed:
        return chain
    return [*chain[:-1], Part(joint=last.joint, fixed=(*(other for other in last.fixed if other != link), link))]


class _Tree:
    """Links and joints below them; nothing is recursive, so a chain may have any length."""

    def __init__(self, joints: list[yourdfpy.Joint], links: list[str]):
        self.below: dict[str, list[yourdfpy.Joint]] = {link: [] for link in links}
        for joint in joints:
            self.below[joint.parent].append(joint)
        children = {joint.child for joint in joints}
        self.root = next(link for link in links if link not in children)
        outward = [self.root]
        for link in outward:
            outward += [joint.child for joint in self.below[link]]
        self._moving: set[str] = set()  # links that carry a moving joint, themselves or further out
        self._parting: set[str] = set()  # links at which moving chains part, themselves or further out
        for link in reversed(outward):
            further = [joint for joint in self.below[link] if self.moves(joint)]
            if further:
                self._moving.add(link)
            if len(further) > 1 or any(joint.child in self._parting for joint in further):
                self._parting.add(link)

    def moves(self, joint: yourdfpy.Joint) -> bool:
        """Whether the joint moves, or any beyond it."""
        return joint.type in MOVING or joint.child in self._moving

    def palm(self) -> str:
        palm = self.root
        while len(further := [joint for joint in self.below[palm] if self.moves(joint)]) == 1:
            # A single finger has no parting: its palm is the last link before the first moving joint.
            if further[0].type in MOVING and further[0].child not in self._parting:
                break
            palm = further[0].child
        return palm

    def chains(self, joint: yourdfpy.Joint) -> Iterator[list[Part]]:
        """Yield every chain through ``joint`` to a leaf."""
        waiting: list[tuple[yourdfpy.Joint, list[Part]]] = [(joint, [])]
        while waiting:
            joint, chain = waiting.pop()
            if joint.type in MOVING:
                chain = [*chain, Part(joint=joint, fixed=self.fixed_to(joint.child))]
            further = [child for child in self.below[joint.child] if self.moves(child)]
            waiting += [(child, chain) for child in reversed(further)]
            if not further:
                yield chain

    def fixed_to(self, link: str) -> tuple[str, ...]:
        """Links fixed to ``link``, directly or through others, the tip last: one with that name, else the last leaf."""
        found: list[str] = []
        leaves: list[str] = []
        waiting = [link]
        while waiting:
            one = waiting.pop()
            if one != link:
                found.append(one)
            held = [joint.child for joint in self.below[one] if joint.type not in MOVING]
            waiting += reversed(held)
            if not held and one != link:
                leaves.append(one)
        if not leaves:
            return ()
        tip = next((leaf for leaf in leaves if re.search(r"tip(?![a-z])", leaf.lower())), leaves[-1])
        return (*(one for one in found if one != tip), tip)
