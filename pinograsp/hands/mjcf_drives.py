"""Couplings and effort limits of an MJCF file: equality constraints between joints, actuators, fixed tendons."""

from __future__ import annotations

import numpy as np

from pinograsp.hands.coupling import Coupling, resolve
from pinograsp.hands.mjcf_source import Source


def couplings_of(
    source: Source, joints: dict[str, dict[str, str]], bodies: list[str], notes: list[str]
) -> dict[str, Coupling]:
    """Equality constraints between two joints as couplings, where they are linear; problems go to ``source``.

    Args:
        joints: attributes of the hand's joints, by name.
        bodies: of the hand.
    """
    refs = {name: _reference(source, joint) for name, joint in joints.items()}
    couplings: dict[str, Coupling] = {}
    opened: list[str] = []
    for constraint in source.element.findall("equality/*"):
        given = source.attributes(constraint, tag="equality")
        if given.get("active", "true") == "false":
            continue
        one, other = given.get("joint1", ""), given.get("joint2")
        if constraint.tag != "joint":
            ends = [given[key] for key in ("body1", "body2", "site1", "site2", "tendon1", "tendon2") if key in given]
            if not any(key.startswith("body") for key in given) or any(end in bodies for end in ends):
                opened.append(f"{constraint.tag} {' and '.join(ends)}".strip())
            continue
        if one not in joints:
            continue  # elsewhere on the robot
        c0, c1, *rest = [*source.numbers(given, "polycoef", "0 1 0 0 0", 1, 5), 0.0, 0.0][:5]
        if other is None or (c1 == 0 and not any(rest)):
            source.problem(f"joint '{one}' is held still by an equality constraint: remove the joint")
        elif any(rest):
            source.problem(f"joint '{one}' follows '{other}' by a curve, polycoef '{given['polycoef']}': not linear")
        elif other not in joints:
            source.problem(f"joint '{one}' follows '{other}', which is no joint of the hand")
        else:
            coupling = Coupling(followed=other, factor=float(c1), offset=float(c0 + refs[one] - c1 * refs[other]))
            if not _couple(couplings, one, coupling):
                source.problem(f"equality constraints contradict each other at joint '{one}'")
    if opened:
        notes.append(f"constraints are left out, loops that they close move as if open: {', '.join(opened)}")
    return couplings


def _couple(couplings: dict[str, Coupling], joint: str, coupling: Coupling) -> bool:
    """Add a coupling between joints that may be coupled already; False where it contradicts the others."""

    def led(name: str) -> Coupling:
        own = Coupling(followed=name, factor=1.0, offset=0.0)
        while own.followed in couplings:
            own = own.after(couplings[own.followed])
        return own

    one, other = led(joint), coupling.after(led(coupling.followed))
    if one.followed != other.followed:  # the leader of one group follows that of the other
        couplings[one.followed] = one.inverse(joint).after(other)
        return True
    return bool(np.allclose([one.factor, one.offset], [other.factor, other.offset], rtol=1e-9, atol=1e-12))


def _reference(source: Source, joint: dict[str, str]) -> float:
    turns = joint.get("type", "hinge") == "hinge"
    return float(source.numbers(joint, "ref", "0")[0]) * (np.pi / 180 if turns and source.degrees else 1.0)


def effort_limits(
    source: Source, joints: dict[str, dict[str, str]], couplings: dict[str, Coupling], notes: list[str]
) -> dict[str, float]:
    """Largest force or torque of the motors [N or N m], by actuated joint; joints without a limit are left out.

    Force ranges, or control ranges of motors that take a force, times gear (and the coefficients of fixed tendons).
    What acts on coupled joints is carried over to the joint that they follow.
    """
    direct, _ = resolve(couplings, dict.fromkeys(joints, "revolute"))
    leader = {name: direct.get(name, Coupling(followed=name, factor=1.0, offset=0.0)) for name in joints}
    tendons = {
        tendon.get("name", ""): {
            one.get("joint", ""): float(source.numbers(one.attrib, "coef", "1")[0]) for one in tendon.findall("joint")
        }
        for tendon in source.element.findall("tendon/fixed")
    }
    limits: dict[str, float] = {}
    endless: set[str] = set()
    shared: list[str] = []
    for actuator in source.element.findall("actuator/*"):
        given = source.attributes(actuator)
        driven = given.get("joint") or given.get("jointinparent")
        pulled = {driven: 1.0} if driven else tendons.get(given.get("tendon", ""), {})
        gear = float(source.numbers(given, "gear", "1", 1, 6)[0])
        moments: dict[str, float] = {}
        for name, coefficient in pulled.items():
            if name in leader:
                one = leader[name]
                moments[one.followed] = moments.get(one.followed, 0.0) + gear * coefficient * one.factor
        if len(moments) > 1:
            shared.append(f"{given.get('name', actuator.tag)} ({', '.join(moments)})")
            continue
        for name, moment in moments.items():
            force = _force(source, given)
            if force is None:
                endless.add(name)
            else:
                limits[name] = limits.get(name, 0.0) + abs(moment) * force
    if shared:
        notes.append(f"actuators that pull several joints at once limit none of them: {', '.join(shared)}")
    limits = {name: limit for name, limit in limits.items() if name not in endless}
    for name, joint in joints.items():
        if source.limited(joint, "actuatorfrclimited", "actuatorfrcrange"):
            one = leader[name]
            cap = abs(one.factor) * float(np.abs(source.numbers(joint, "actuatorfrcrange", "0 0", 2)).max())
            limits[one.followed] = min(limits.get(one.followed, cap), cap)
    return limits


def _force(source: Source, given: dict[str, str]) -> float | None:
    """Largest force of an actuator before its gear; None where nothing limits it."""
    if source.limited(given, "forcelimited", "forcerange"):
        return float(np.abs(source.numbers(given, "forcerange", "0 0", 2)).max())
    takes_force = given.get("biastype", "none") == "none" and given.get("gaintype", "fixed") == "fixed"
    if takes_force and given.get("dyntype", "none") == "none" and source.limited(given, "ctrllimited", "ctrlrange"):
        gain = abs(float(source.numbers(given, "gainprm", "1", 1, 20)[0]))
        return gain * float(np.abs(source.numbers(given, "ctrlrange", "0 0", 2)).max())
    return None
