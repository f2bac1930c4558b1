"""Coupled joints: chains of followers resolved, their limits merged, and put in the order Pinocchio needs.

A joint that follows another has the position ``factor * q + offset``. Pinocchio numbers joints depth first and needs
the joint that is followed before those that follow it.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from pinograsp.hands.tree import MOVING

if TYPE_CHECKING:
    import yourdfpy

_LARGEST = 1e6  # of multipliers, one over it the least, and of offsets [rad or m]


@dataclass(frozen=True, slots=True, kw_only=True)
class Coupling:
    """Position of a coupled joint: ``factor`` times that of the joint ``followed``, plus ``offset``."""

    followed: str
    factor: float
    offset: float

    def after(self, inner: Coupling) -> Coupling:
        """The coupling to what ``inner`` follows, where this one follows the joint that ``inner`` couples."""
        return Coupling(
            followed=inner.followed, factor=self.factor * inner.factor, offset=self.factor * inner.offset + self.offset
        )

    def inverse(self, coupled: str) -> Coupling:
        """The position of ``followed`` from that of the joint ``coupled``."""
        return Coupling(followed=coupled, factor=1 / self.factor, offset=-self.offset / self.factor)

    def __str__(self) -> str:
        return f"{self.followed}: {self.rule}"

    @property
    def rule(self) -> str:
        """The position, in words."""
        offset = f" {'-' if self.offset < 0 else '+'} {abs(self.offset):g}" if self.offset else ""
        return f"{self.factor:g} times its position{offset}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Limits:
    """Limits of a joint: position [rad or m], effort [N m or N] and velocity [rad/s or m/s] (0: none)."""

    lower: float
    upper: float
    effort: float = 0.0
    velocity: float = 0.0

    def seen_from(self, coupling: Coupling) -> Limits:
        """These limits of a followed joint, as limits of the joint that ``coupling`` couples to it."""
        ends = sorted(coupling.factor * end + coupling.offset for end in (self.lower, self.upper))
        factor = abs(coupling.factor)
        return Limits(lower=ends[0], upper=ends[1], effort=self.effort / factor, velocity=self.velocity * factor)


def resolve(couplings: dict[str, Coupling], types: Mapping[str, str | None]) -> tuple[dict[str, Coupling], list[str]]:
    """Couplings to joints that follow none, and the problems found.

    Args:
        couplings: by coupled joint; they may follow coupled joints.
        types: type of every joint, by name.
    """
    direct: dict[str, Coupling] = {}
    problems: list[str] = []
    for name, coupling in couplings.items():
        seen = [name]
        while coupling.followed in couplings and coupling.followed not in seen:
            seen.append(coupling.followed)
            coupling = coupling.after(couplings[coupling.followed])
        followed = coupling.followed
        if followed in seen:
            way = " and ".join(f"'{one}'" for one in sorted(seen))
            problems.append(f"joint '{name}' mimics itself through {way}: one of them must be free")
        elif types.get(followed) not in MOVING:
            kind = types.get(followed, "unknown")
            problems.append(f"joint '{name}' mimics '{followed}', which is {kind}: let it follow a joint that moves")
        elif not (1 / _LARGEST <= abs(coupling.factor) <= _LARGEST and abs(coupling.offset) <= _LARGEST):
            problems.append(
                f"joint '{name}' mimics '{followed}' with multiplier {coupling.factor:g}: make it fixed, or give it a "
                "multiplier "
                f"between {1 / _LARGEST:g} and {_LARGEST:g} (and an offset of at most {_LARGEST:g}, got "
                f"{coupling.offset:g})"
            )
        else:
            direct[name] = coupling
    return direct, problems


def narrow_limits(limits: dict[str, Limits], couplings: dict[str, Coupling], notes: list[str]) -> dict[str, Limits]:
    """Positions and velocities of the joints that follow none, narrowed by the limits of those that they move."""
    free = {name: one for name, one in limits.items() if name not in couplings}
    for name, coupling in couplings.items():
        if name not in limits or coupling.followed not in free:
            continue
        own, leader = limits[name].seen_from(coupling.inverse(name)), free[coupling.followed]
        low, high = max(leader.lower, own.lower), min(leader.upper, own.upper)
        if high - low < 0.5 * (leader.upper - leader.lower):
            # Limits of coupled joints are often copied without their sign: then they would take half the range or more.
            notes.append(f"limits of {name} do not fit what {coupling.followed} makes it do: ignored")
        elif (low, high) != (leader.lower, leader.upper):
            free[coupling.followed] = leader = replace(leader, lower=low, upper=high)
            notes.append(f"limits of {coupling.followed} narrowed to {low:.4g}..{high:.4g} by {name}")
        if 0 < own.velocity < (leader.velocity or math.inf):
            free[coupling.followed] = replace(leader, velocity=own.velocity)
            notes.append(f"velocity limit of {coupling.followed} narrowed to {own.velocity:.4g} by {name}")
    return free


def in_order(joints: list[yourdfpy.Joint], couplings: dict[str, Coupling]) -> list[str]:
    """Joints of a tree depth first, with followed joints before their followers as far as the tree lets them."""
    below: dict[str, list[yourdfpy.Joint]] = {}
    for joint in joints:
        below.setdefault(joint.parent, []).append(joint)
    children = {joint.child for joint in joints}
    outward = [link for link in below if link not in children]
    for link in outward:
        outward += [joint.child for joint in below.get(link, [])]
    # What lies in each branch, and what its joints follow outside of it.
    inside: dict[str, set[str]] = {}
    for link in reversed(outward):
        for joint in below.get(link, []):
            inside[joint.name] = {joint.name}.union(*(inside[child.name] for child in below.get(joint.child, [])))
    order: list[str] = []
    waiting: list[tuple[str, str | None]] = [(link, None) for link in reversed(outward[:1])]
    while waiting:
        link, name = waiting.pop()
        if name is not None:
            order.append(name)
        branches = _siblings(below.get(link, []), inside, couplings)
        waiting += [(branch.child, branch.name) for branch in reversed(branches)]
    return order


def _siblings(
    branches: list[yourdfpy.Joint], inside: dict[str, set[str]], couplings: dict[str, Coupling]
) -> list[yourdfpy.Joint]:
    """Branches below one link: by name, but after those that hold a joint that one of theirs follows."""
    left = {joint.name: joint for joint in sorted(branches, key=lambda joint: joint.name)}
    ordered: list[yourdfpy.Joint] = []
    while left:

        def waits(name: str) -> bool:
            wanted = {couplings[joint].followed for joint in inside[name] if joint in couplings} - inside[name]
            return any(wanted & inside[other] for other in left if other != name)

        ready = next((name for name in left if not waits(name)), next(iter(left)))
        ordered.append(left.pop(ready))
    return ordered


def led_from_the_front(
    order: list[str], couplings: dict[str, Coupling], limits: dict[str, Limits], notes: list[str]
) -> tuple[dict[str, Coupling], dict[str, Limits]]:
    """The same couplings with the first joint of each coupled group, in ``order``, as the one the others follow."""
    place = {name: i for i, name in enumerate(order)}
    couplings, limits = dict(couplings), dict(limits)
    for leader in sorted({coupling.followed for coupling in couplings.values()}, key=place.__getitem__):
        group = [name for name, coupling in couplings.items() if coupling.followed == leader]
        first = min(group, key=place.__getitem__)
        if place[leader] < place[first]:
            continue
        to_first = couplings.pop(first)
        limits[first] = limits.pop(leader).seen_from(to_first)
        couplings[leader] = to_first.inverse(first)
        for name in group:
            if name != first:
                couplings[name] = couplings[name].after(couplings[leader])
        notes.append(f"joint {first} stands for {leader}, which moves it but comes after it: q, torque are of {first}")
    return couplings, limits
