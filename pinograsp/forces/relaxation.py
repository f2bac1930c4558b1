"""Which limits are in the way of forces: each is relaxed alone, then several together, until forces are found."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, Literal, get_args

import numpy as np

from pinograsp.contacts.friction import LARGEST_MU
from pinograsp.errors import InvalidInput
from pinograsp.forces.infeasibility import holds
from pinograsp.forces.problem import ForceProblem
from pinograsp.forces.robust.reserve import Reserve
from pinograsp.forces.robust.reserve_search import least_squeeze, widest_range
from pinograsp.forces.solve.program import feasibility
from pinograsp.spatial import Array
from pinograsp.words import format_number

ForceLimit = Literal[
    "torque_limit",
    "max_normal_force",
    "max_depth",
    "max_speed",
    "largest_acceleration",
    "least_acceleration",
    "min_normal_force",
]
ReservePart = Literal[
    "disturbance", "moment_arm", "reserve_mass", "friction", "normal_force", "torque", "softer", "stiffer", "drive"
]
LimitName = ForceLimit | Literal["mu", "mass"] | ReservePart

# Above that of any pair of materials: a grasp that fails with it lacks something other than friction.
LARGEST_FRICTION = 10.0
_SLIPPERY = 1e-3  # least friction coefficient
_MOST = 1e4  # times: a limit so much wider is none
_SHARP = 5e-3  # relative, of the figures
_ROOM = 1.01  # times the least relaxation: postures and impact times move a little with the forces
# Parts of the reserve and the names of the record's fields.
_PARTS: dict[LimitName, str] = {part: part.removeprefix("reserve_") for part in get_args(ReservePart)}
# Those that are relaxed together, in the order in which they are tried.
_KINDS: tuple[tuple[LimitName, ...], ...] = (get_args(ForceLimit), ("mu",), ("mass",), get_args(ReservePart))
_FACTORS = ("softer", "stiffer")  # of which 1 is nothing
_SOME = 4  # joints that are named one by one


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What is to be planned.

    Attributes:
        problem: of the forces; with torque limits where the posture is known.
        reserve: None: the load alone.
        limit: of the joint torques (n,) [N m or N] where the posture is not known yet; None: none.
    """

    problem: ForceProblem
    reserve: Reserve | None
    limit: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Relaxation:
    """One limit, relaxed by a factor.

    Attributes:
        limit: which; parts of the reserve by their names, its mass as ``"reserve_mass"``.
        factor: by which it is relaxed, above 1; infinity: left out.
        joints: indices of those whose torque limits are raised; empty: all.
    """

    limit: LimitName
    factor: float = np.inf
    joints: tuple[int, ...] = ()

    def apply(self, setup: Setup) -> Setup:
        """What is to be planned with this limit relaxed."""
        problem, reserve, f = setup.problem, setup.reserve, self.factor
        changed: dict[str, Any] = {}
        if self.limit in _PARTS and reserve is not None:
            part = _PARTS[self.limit]
            nothing = _nothing(self.limit)
            share = nothing + (_part(setup, self.limit) - nothing) / f
            changed[part] = share
            return replace(setup, reserve=replace(reserve, **changed))
        if self.limit == "torque_limit":
            limit = None if setup.limit is None else self._raise_limits(setup.limit)
            torques = problem.torques
            if torques is not None:
                changed["torques"] = replace(torques, limit=self._raise_limits(torques.limit))
            return replace(setup, problem=replace(problem, **changed), limit=limit)
        if self.limit == "mass":
            changed["load"] = problem.load / f
            if (body := problem.object) is not None:
                inertia = None if body.inertia is None else body.inertia / f
                same: dict[str, Any] = {"mass": body.mass / f, "density": None, "inertia": inertia}
                changed["object"] = replace(body, **same)
        elif self.limit == "mu":
            changed["mu"] = np.minimum(f * _friction(problem), LARGEST_MU)
        elif self.limit == "largest_acceleration":
            low, high = problem.acceleration_range
            changed["acceleration_range"] = (low, high * f)
        elif self.limit == "least_acceleration":
            low, high = problem.acceleration_range
            changed["acceleration_range"] = (low / f, high)
        elif self.limit == "min_normal_force":
            changed["min_normal_force"] = problem.min_normal_force / f if problem.min_normal_force is not None else None
        else:
            changed[self.limit] = getattr(problem, self.limit) * f
        return replace(setup, problem=replace(problem, **changed))

    def _raise_limits(self, limit: Array) -> Array:
        factors = np.full(len(limit), 1.0 if self.joints else self.factor)
        factors[list(self.joints)] = self.factor
        return np.asarray(factors * limit)

    def wider(self, times: float) -> Relaxation:
        """With so many times more room, to a figure of three digits."""
        return replace(self, factor=self.factor * times)

    def round_figure(self, setup: Setup) -> Relaxation:
        """A little wider, so that its figure has three digits."""
        given, less = _figure(setup, self.limit), self.limit in _LOWERED
        if not np.isfinite(self.factor) or given is None or self.limit in _FACTORS:
            return self
        needed = given / self.factor if less else given * self.factor
        digits = 2 - math.floor(math.log10(needed))
        needed = (math.floor if less else math.ceil)(needed * 10.0**digits) / 10.0**digits
        return replace(self, factor=given / needed if less else needed / given) if needed > 0 else self

    def words(self, setup: Setup, slides: Sequence[bool] = ()) -> str:
        """What would do and what is given; ``slides``: which joints are prismatic."""
        if self.limit == "torque_limit":
            return self._torque_words(setup, slides)
        name, what, unit, scale = _WORDS[self.limit]
        given = _figure(setup, self.limit)
        if self.limit in _PARTS:
            nothing = _nothing(self.limit)
            share = nothing + ((given or 0.0) - nothing) / self.factor
            return f"{what}: Reserve({name}={share:.3g}), given {given:.3g}"
        if self.limit == "mass" and setup.problem.object is None:
            return f"load: {1 / self.factor:.3g} times the given one"
        if given is None:
            change = "less" if self.limit in _LOWERED else "as much"
            return f"{what} ({name}): {self.factor:.3g} times {change}"
        needed = given / self.factor if self.limit in _LOWERED else given * self.factor
        given = 0.0 if self.limit == "mu" and not setup.problem.mu.any() else given
        direction = "at most" if self.limit in _LOWERED else "at least"
        wanted, have = (f"{format_number(scale * one, 3)}{unit}" for one in (needed, given))
        return f"{what} ({name}): {direction} {wanted}, given {have}"

    def _torque_words(self, setup: Setup, slides: Sequence[bool]) -> str:
        torques = setup.problem.torques
        limit = setup.limit if torques is None else torques.limit
        if limit is None:
            return "effort limits (torque_limit)"
        names = [f"joint {j + 1}" for j in range(len(limit))] if torques is None else list(torques.joints)
        which = list(self.joints) or np.flatnonzero(np.isfinite(limit)).tolist()
        units = {("N" if slides[j] else "N m") if len(slides) else "N m or N" for j in which}
        unit = " or ".join(sorted(units))
        listed = ", ".join(names[j] for j in which[:_SOME])
        if len(which) > _SOME:
            listed += f" and {len(which) - _SOME} more"
        given = [float(limit[j]) for j in which]
        if max(given) - min(given) <= 1e-9 * max(given):
            needed = (
                f"at least {format_number(given[0] * self.factor, 3)} {unit}, given {format_number(given[0], 3)} {unit}"
            )
        elif len(which) <= _SOME:
            needed = (
                f"at least {', '.join(format_number(one * self.factor, 3) for one in given)} {unit}, given "
                f"{', '.join(format_number(one, 3) for one in given)} {unit}"
            )
        else:
            least, most = (format_number(one, 3) for one in (min(given), max(given)))
            needed = f"at least {self.factor:.3g} times the given {least} to {most}"
        return f"effort limit (torque_limit) of {listed}: {needed}"


_LOWERED = {"least_acceleration", "min_normal_force", "mass", *_PARTS}
_WORDS: dict[LimitName, tuple[str, str, str, float]] = {
    "max_normal_force": ("max_normal_force", "cap on the normal forces", " N", 1.0),
    "max_depth": ("max_depth", "penetration depth, Eq. (13a)", " mm", 1e3),
    "max_speed": ("max_speed", "impact speed, Eq. (13b)", " m/s", 1.0),
    "largest_acceleration": ("acceleration_range, upper", "deceleration, Eq. (13c)", " m/s^2", 1.0),
    "least_acceleration": ("acceleration_range, lower", "least deceleration, Eq. (13c)", " m/s^2", 1.0),
    "min_normal_force": ("min_normal_force", "least normal force", " N", 1.0),
    "mu": ("mu", "friction coefficient", "", 1.0),
    "mass": ("mass", "mass of the object", " kg", 1.0),
    "disturbance": ("disturbance", "disturbance of the reserve", "", 1.0),
    "moment_arm": ("moment_arm", "arm of the reserve's moments", " m", 1.0),
    "reserve_mass": ("mass", "mass of the reserve", "", 1.0),
    "friction": ("friction", "friction of the reserve", "", 1.0),
    "normal_force": ("normal_force", "least normal force of the reserve", "", 1.0),
    "torque": ("torque", "torque of the reserve", "", 1.0),
    "softer": ("softer", "softer contacts of the reserve", "", 1.0),
    "stiffer": ("stiffer", "stiffer contacts of the reserve", "", 1.0),
    "drive": ("drive", "weaker and stronger drives of the reserve", "", 1.0),
}


def _friction(problem: ForceProblem) -> Array:
    """The friction coefficients (k,) to start from, above 0."""
    return problem.mu if problem.mu.any() else np.full(problem.k, _SLIPPERY)


def _nothing(limit: LimitName) -> float:
    """The part of a reserve that is none."""
    return 1.0 if limit in _FACTORS else 0.0


def _part(setup: Setup, limit: LimitName) -> float:
    """A part of the reserve; of moments their arm, where there are any."""
    reserve, body = setup.reserve, setup.problem.object
    if reserve is None:
        return _nothing(limit)
    if limit == "moment_arm":
        return reserve.arm(body) if reserve.disturbance and body is not None else 0.0
    return float(getattr(reserve, _PARTS[limit]))


def _figure(setup: Setup, limit: LimitName) -> float | None:
    """The given limit as one number; None where it is none, or another one for each contact."""
    problem = setup.problem
    values: Any
    if limit in _PARTS:
        values = _part(setup, limit)
    elif limit == "torque_limit":
        return None
    elif limit == "mass":
        values = None if problem.object is None else problem.object.mass
    elif limit in ("least_acceleration", "largest_acceleration"):
        values = problem.acceleration_range[limit == "largest_acceleration"]
    elif limit == "mu":
        values = _friction(problem)
    else:
        values = getattr(problem, limit)
    if values is None:
        return None
    low, high = float(np.min(values)), float(np.max(values))
    return high if high - low <= 1e-12 * max(high, 1.0) else None


def _there(setup: Setup, limit: LimitName) -> bool:
    """Whether there is such a limit."""
    problem = setup.problem
    if limit in _PARTS:
        return _part(setup, limit) > _nothing(limit)
    if limit == "torque_limit":
        known = setup.limit if problem.torques is None else problem.torques.limit
        return known is not None and bool(np.isfinite(known).any())
    if limit == "mu":
        return bool(problem.mu.max() < LARGEST_FRICTION)
    if limit == "mass":
        return bool(np.any(problem.load))
    if limit == "min_normal_force":
        return problem.min_normal_force is not None and bool(np.any(problem.min_normal_force))
    return getattr(problem, limit, 0.0) is not None


def forces_exist(setup: Setup, rows: Array | None = None) -> bool:
    """Whether forces are found within all that any impact time allows; ``rows``: as for :func:`least_squeeze`."""
    problem, reserve = setup.problem, setup.reserve
    try:
        if reserve is None:
            return holds(feasibility(problem, *widest_range(problem)))
        return least_squeeze(problem, reserve, rows=rows) is not None
    except InvalidInput:  # a least force above the largest
        return False


def find_relaxations(
    setup: Setup, works: Callable[[Setup], bool], *, sharp: float = _SHARP, kinds: int = 4
) -> Iterator[tuple[Relaxation, ...]]:
    """What would do, option by option: a limit relaxed alone, or several together where none of their kind does alone.

    Each option is as little as ``works`` accepts, to a share of ``sharp``; its figures are rounded to the side that
    works. Limits come first, then friction, mass, and the parts of the reserve.

    Args:
        setup: for which ``works`` is false.
        works: whether forces are found; true of all that is relaxed further where it is true.
        sharp: of the figures, relative.
        kinds: 1: limits of forces and torques alone; 4: all.
    """
    known: list[tuple[LimitName, ...]] = [tuple(one for one in kind if _there(setup, one)) for kind in _KINDS[:kinds]]
    least, any_found = _Least(setup, works, sharp), False
    for kind in known:
        alone: list[LimitName] = [limit for limit in kind if works(_all(setup, [limit]))]
        for limit in alone:
            yield least.of([limit])
        any_found |= bool(alone)
        if not alone and len(kind) > 1 and (few := least.find_needed(kind)):
            yield least.of(few)
            any_found = True
    if not any_found and (few := least.find_needed([limit for kind in reversed(known) for limit in kind])):
        yield least.of(few)


def _widest(setup: Setup, limit: LimitName) -> Relaxation:
    """As far as a limit is relaxed at all."""
    if limit == "mu":
        return Relaxation(limit="mu", factor=LARGEST_FRICTION / float(_friction(setup.problem).max()))
    no_limit = limit in _PARTS or limit == "torque_limit"
    return Relaxation(limit=limit, factor=np.inf if no_limit else _MOST)


def _all(setup: Setup, limits: Iterable[LimitName]) -> Setup:
    """With all of these as wide as they are relaxed at all."""
    for limit in limits:
        setup = _widest(setup, limit).apply(setup)
    return setup


def relax(setup: Setup, relaxations: Iterable[Relaxation]) -> Setup:
    """With all of these."""
    for one in relaxations:
        setup = one.apply(setup)
    return setup


class _Least:
    """The least relaxations of a set-up."""

    def __init__(self, setup: Setup, works: Callable[[Setup], bool], sharp: float):
        self.setup, self.works, self.sharp = setup, works, sharp

    def find_needed(self, limits: Sequence[LimitName]) -> list[LimitName]:
        """Those of the limits that have to be relaxed together: none of them can be left out. Empty: all do not do."""
        if not self.works(_all(self.setup, limits)):
            return []
        few = list(limits)
        for limit in limits:
            others: list[LimitName] = [one for one in few if one != limit]
            if self.works(_all(self.setup, others)):
                few = others
        return few

    def of(self, limits: Sequence[LimitName]) -> tuple[Relaxation, ...]:
        """As little as does, of one after the other: those before as little as does, those after as far as can be."""
        done: list[Relaxation] = []
        for i, limit in enumerate(limits):
            beside = _all(relax(self.setup, done), limits[i + 1 :])
            done.append(self.least(limit, beside))
        return tuple(done)

    def least(self, limit: LimitName, beside: Setup) -> Relaxation:
        """The least relaxation of a limit, to a figure of three digits; ``beside``: with all others."""

        def does(factor: float, joints: tuple[int, ...] = ()) -> bool:
            return self.works(Relaxation(limit=limit, factor=factor, joints=joints).apply(beside))

        most = _widest(self.setup, limit).factor
        low, high = 1.0, 2.0
        while high < min(most, _MOST) and not does(high):
            low, high = high, high**2
        if high >= min(most, _MOST):
            high = min(most, _MOST)
            if high < most and not does(high):
                return Relaxation(limit=limit)  # nothing of it is left
        while high > low * (1 + self.sharp):
            middle = math.sqrt(low * high)
            low, high = (low, middle) if does(middle) else (middle, high)
        found = Relaxation(limit=limit, factor=min(high * _ROOM, max(most, high)))
        return self._few_joints(found, does) if limit == "torque_limit" else found.round_figure(self.setup)

    def _few_joints(self, found: Relaxation, does: Callable[[float, tuple[int, ...]], bool]) -> Relaxation:
        """The same for those joints alone whose limits have to be raised."""
        torques, limit = self.setup.problem.torques, self.setup.limit
        known = limit if torques is None else torques.limit
        if known is None:
            return found
        joints = np.flatnonzero(np.isfinite(known)).tolist()
        blocks = [joints[:]]
        while blocks:  # left out half by half: mostly one or two of many are in the way
            block = blocks.pop()
            others = tuple(one for one in joints if one not in block)
            if others and does(found.factor, others):
                joints = list(others)
            elif len(block) > 1:
                half = len(block) // 2
                blocks += [block[half:], block[:half]]
        digits = 2 - math.floor(math.log10(found.factor))
        return replace(found, joints=tuple(joints), factor=math.ceil(found.factor * 10**digits) / 10**digits)


def describe_relaxations(
    options: Sequence[tuple[Relaxation, ...]], setup: Setup, slides: Sequence[bool] = (), how: Sequence[str] = ()
) -> tuple[str, ...]:
    """A lead and a line per option, all of which were tried; ``how``: what is to be said of each. Empty: no options."""
    if not options:
        return ()
    lines = ["; and ".join(one.words(setup, slides) for one in option) for option in options]
    lead = "tried, and one of these lines would suffice" if len(options) > 1 else "tried, and would suffice"
    lead += ", all of it together:" if any(len(option) > 1 for option in options) else ":"
    return (lead, *(f"  {line}{more}" for line, more in zip(lines, how or [""] * len(lines))))
