"""Palm, fingers and fingertips, found from the tree of links and from which of them have geometry."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from pinograsp.errors import HandNotLoaded

MOVING = ("revolute", "prismatic")


@dataclass(frozen=True, slots=True, kw_only=True)
class Joint:
    """A joint of a description: its type (``"revolute"``, ``"prismatic"`` or ``"fixed"``), parent and child link."""

    name: str
    type: str
    parent: str
    child: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A moving joint of a finger, and the links fixed to its child, innermost first."""

    joint: Joint
    fixed: tuple[str, ...] = ()

    @property
    def links(self) -> tuple[str, ...]:
        """The joint's child and what is fixed to it."""
        return (self.joint.child, *self.fixed)


def find_fingers(
    source: str,
    joints: list[Joint],
    links: list[str],
    touches: Callable[[str], bool],
    palm: str | None,
    names: dict[str, str] | None,
) -> tuple[str, dict[str, list[Part]]]:
    """Palm link and, by finger name, the moving joints from palm to fingertip.

    Args:
        source: for errors. joints, links: of the description, one tree.
        touches: whether a link has geometry that can touch something.
        palm: link the fingers start from; None: the first at which moving chains part.
        names: ``{finger name: a link of its outermost part}``; None: every chain that can touch, named after its links.

    Raises:
        HandNotLoaded: unknown links, or no moving chain.
    """
    below = {link: [] for link in links}
    for joint in joints:
        below[joint.parent].append(joint)
    tree = _Tree(below)
    if palm is None:
        palm = tree.palm({joint.child for joint in joints})
    elif palm not in below:
        raise HandNotLoaded(source, f"palm '{palm}' is not a link; links: {', '.join(below)}")
    chains = [chain for joint in below[palm] if tree.moves(joint) for chain in tree.chains(joint, [])]
    if not chains:
        raise HandNotLoaded(source, f"no moving chain starts at palm '{palm}'")
    if names is None:
        # Levers of a linkage and free axles carry no geometry: nothing for an object to touch.
        touching = [chain for chain in chains if any(touches(link) for part in chain for link in part.links)] or chains
        return palm, dict(zip(_names(touching), touching))
    chosen = {}
    for name, link in names.items():
        matching = [chain for chain in chains if any(link in part.links for part in chain)]
        if not matching:
            tips = ", ".join(tip_of(chain) for chain in chains)
            raise HandNotLoaded(source, f"finger '{name}': link '{link}' is on no finger; fingertips: {tips}")
        chosen[name] = matching[0]
    return palm, chosen


def tip_of(chain: list[Part]) -> str:
    """The outermost link fixed beyond the last joint."""
    return chain[-1].links[-1]


class _Tree:
    def __init__(self, below: dict[str, list[Joint]]):
        self.below = below

    def moves(self, joint: Joint) -> bool:
        """Whether the joint moves, or any beyond it."""
        return joint.type in MOVING or any(self.moves(child) for child in self.below[joint.child])

    def parts(self, joint: Joint) -> bool:
        """Whether moving chains part beyond the joint."""
        further = [child for child in self.below[joint.child] if self.moves(child)]
        return len(further) > 1 or any(self.parts(child) for child in further)

    def palm(self, children: set[str]) -> str:
        palm = next(link for link in self.below if link not in children)
        while len(parting := [joint for joint in self.below[palm] if self.moves(joint)]) == 1:
            # A single finger has no parting: its palm is the last link before the first moving joint.
            if parting[0].type in MOVING and not self.parts(parting[0]):
                break
            palm = parting[0].child
        return palm

    def chains(self, joint: Joint, chain: list[Part]):
        """Yield every chain through ``joint`` to a leaf."""
        if joint.type in MOVING:
            chain = [*chain, Part(joint=joint)]
        elif chain:
            chain = [*chain[:-1], Part(joint=chain[-1].joint, fixed=(*chain[-1].fixed, joint.child))]
        further = [child for child in self.below[joint.child] if self.moves(child)]
        if further:
            for child in further:
                yield from self.chains(child, chain)
            return
        # Beyond the last joint only fixed links remain: follow them to the outermost.
        tips = self.below[joint.child]
        while tips and chain:
            last = chain[-1]
            chain = [*chain[:-1], Part(joint=last.joint, fixed=(*last.fixed, tips[-1].child))]
            tips = self.below[tips[-1].child]
        yield chain


def _names(chains: list[list[Part]]) -> list[str]:
    """The common prefix of each finger's links, where that tells the fingers apart; else the fingertip's name."""
    names = []
    for chain in chains:
        links = [part.joint.child for part in chain] + [tip_of(chain)]
        prefix = links[0]
        while not all(link.startswith(prefix) for link in links):
            prefix = prefix[:-1]
        names.append(prefix.rstrip("_-. 0123456789"))
    if len(set(names)) < len(names) or not all(names):
        names = [tip_of(chain) for chain in chains]
    return names
