"""Couplings, effort limits, motors and springs of an MJCF file: equality constraints, actuators, fixed tendons."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ElementTree

import numpy as np

from pinograsp.hands.coupling import Coupling, resolve
from pinograsp.hands.drives import ON_DRIVES, Actuation, Control, Motor, Spring
from pinograsp.hands.mjcf_loops import Loop, Rest
from pinograsp.hands.mjcf_source import Source

_SAMPLES = 101  # of a curve by which a joint follows another


def couplings_of(
    source: Source, joints: dict[str, dict[str, str]], bodies: list[str], notes: list[str]
) -> tuple[dict[str, Coupling], list[Loop], list[str]]:
    """Equality constraints between two joints as couplings: lines, and curves as the lines nearest to them,
    noted; problems go to ``source``.

    Args:
        joints: attributes of the hand's joints, by name.
        bodies: of the hand.

    Returns:
        The couplings, loops that other constraints close, and the constraints that are neither, in words.
    """
    refs = {name: _reference(source, joint) for name, joint in joints.items()}
    couplings: dict[str, Coupling] = {}
    loops: list[Loop] = []
    opened: list[str] = []
    for constraint in source.element.findall("equality/*"):
        given = source.attributes(constraint, tag="equality")
        if given.get("active", "true") == "false":
            continue
        one, other = given.get("joint1", ""), given.get("joint2")
        if constraint.tag != "joint":
            ends = [given[key] for key in ("body1", "body2", "site1", "site2", "tendon1", "tendon2") if key in given]
            text = f"{constraint.tag} {' and '.join(ends)}".strip()
            links = given.get("body1", ""), given.get("body2", "")
            if constraint.tag == "connect" and "anchor" in given and all(link in bodies for link in links):
                loops.append(Loop(links=links, anchor=source.numbers(given, "anchor", "0 0 0", 3), name=text))
            elif not any(key.startswith("body") for key in given) or any(end in bodies for end in ends):
                opened.append(text)
            continue
        if one not in joints:
            continue  # elsewhere on the robot
        c0, c1, *rest = [*source.numbers(given, "polycoef", "0 1 0 0 0", 1, 5), 0.0, 0.0][:5]
        if other is None or (c1 == 0 and not any(rest)):
            source.problem(f"joint '{one}' is held still by an equality constraint: remove the joint")
        elif other not in joints:
            source.problem(f"joint '{one}' follows '{other}', which is no joint of the hand")
        else:
            if any(rest):
                c0, c1 = _line(source, one, other, joints, (c0, c1, *rest), notes)
            coupling = Coupling(followed=other, factor=float(c1), offset=float(c0 + refs[one] - c1 * refs[other]))
            if not _couple(couplings, one, coupling):
                source.problem(f"equality constraints contradict each other at joint '{one}'")
    return couplings, loops, opened


def _line(
    source: Source, one: str, other: str, joints: dict[str, dict[str, str]], curve: tuple[float, ...], notes: list[str]
) -> tuple[float, float]:
    """Offset and factor of the line nearest to a curve by which a joint follows another, over that one's range; noted.

    Both count from the joints' reference positions.
    """
    leader, kind = joints[other], joints[other].get("type", "hinge")
    if not source.limited(leader, "limited", "range"):
        source.problem(f"joint '{one}' follows '{other}' by a curve: '{other}' needs a range to fit a line to it")
        return 0.0, 1.0
    unit = np.pi / 180 if kind == "hinge" and source.degrees else 1.0
    low, high = source.numbers(leader, "range", "0 0", 2) * unit - _reference(source, leader)
    x = np.linspace(low, high, _SAMPLES)
    y = np.polynomial.Polynomial(curve)(x)
    factor, offset = np.polyfit(x, y, 1).tolist()
    off = float(np.abs(factor * x + offset - y).max())
    turns = joints[one].get("type", "hinge") == "hinge"
    amount = f"{np.degrees(off):.2g} deg" if turns else f"{1e3 * off:.2g} mm"
    notes.append(f"joint {one} follows {other} by a curve, taken as the line nearest to it: off by at most {amount}")
    return offset, factor


def rests_of(source: Source, joints: dict[str, dict[str, str]]) -> dict[str, Rest]:
    """Reference positions and springs of hinges and slides, by name."""
    found: dict[str, Rest] = {}
    for name, given in joints.items():
        kind = given.get("type", "hinge")
        if kind not in ("hinge", "slide"):
            continue
        unit = np.pi / 180 if kind == "hinge" and source.degrees else 1.0
        (stiffness,), (relaxed,) = source.numbers(given, "stiffness", "0"), source.numbers(given, "springref", "0")
        found[name] = Rest(
            reference=_reference(source, given), stiffness=max(0.0, float(stiffness)), relaxed=float(relaxed) * unit
        )
    return found


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
    tendons = _fixed_tendons(source)
    limits: dict[str, float] = {}
    endless: set[str] = set()
    shared: list[str] = []
    for actuator in source.element.findall("actuator/*"):
        given = source.attributes(actuator)
        moments: dict[str, float] = {}
        for name, arm in _arms(source, given, tendons).items():
            if name in leader:
                one = leader[name]
                moments[one.followed] = moments.get(one.followed, 0.0) + arm * one.factor
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
        notes.append(f"effort limits are without actuators that pull several joints at once: {', '.join(shared)}")
    limits = {name: limit for name, limit in limits.items() if name not in endless}
    for name, joint in joints.items():
        if source.limited(joint, "actuatorfrclimited", "actuatorfrcrange"):
            one = leader[name]
            cap = abs(one.factor) * float(np.abs(source.numbers(joint, "actuatorfrcrange", "0 0", 2)).max())
            limits[one.followed] = min(limits.get(one.followed, cap), cap)
    return limits


def _fixed_tendons(source: Source) -> dict[str, dict[str, float]]:
    """By name of the tendon, the coefficients of its joints."""
    return {
        tendon.get("name", ""): {
            one.get("joint", ""): float(source.numbers(one.attrib, "coef", "1")[0]) for one in tendon.findall("joint")
        }
        for tendon in source.element.findall("tendon/fixed")
    }


def _arms(source: Source, given: dict[str, str], tendons: dict[str, dict[str, float]]) -> dict[str, float]:
    """Torque or force that an actuator makes at each joint, per unit of its own force; {} where it pulls none."""
    driven = given.get("joint") or given.get("jointinparent")
    pulled = {driven: 1.0} if driven else tendons.get(given.get("tendon", ""), {})
    gear = float(source.numbers(given, "gear", "1", 1, 6)[0])
    return {name: gear * coefficient for name, coefficient in pulled.items()}


def actuation_of(source: Source, joints: dict[str, dict[str, str]]) -> Actuation:
    """Motors at the hand's joints, by themselves or by fixed tendons, and springs at these joints.

    Args:
        joints: attributes of the hand's joints, by name.
    """
    found = Actuation()
    tendons = _fixed_tendons(source)
    elsewhere: list[str] = []
    for actuator in source.element.findall("actuator/*"):
        given = source.attributes(actuator)
        arms = _arms(source, given, tendons)
        name = given.get("name") or f"{actuator.tag} {', '.join(arms)}".strip()
        if not arms:
            elsewhere.append(name)
        arms = {joint: arm for joint, arm in arms.items() if joint in joints}
        if not arms:
            continue
        control, stiffness, damping = _control(source, given)
        force = _force(source, given)
        found.motors.append(
            Motor(
                name=name,
                arms=arms,
                control=control or "torque",
                limit=math.inf if force is None else force,
                stiffness=stiffness,
                damping=damping,
                remark="" if control else f"of kind {actuator.tag}, taken as torque motors",
            )
        )
    if elsewhere:
        found.notes.append(
            f"{ON_DRIVES}left out are actuators that pull neither a joint nor a fixed tendon: {', '.join(elsewhere)}"
        )
    found.springs = [spring for name, joint in joints.items() for spring in _springs(source, name, joint)]
    stiff = [tendon for tendon in source.element.findall("tendon/fixed") if _pulls_back(source, tendon, joints)]
    if stiff:
        names = ", ".join(tendon.get("name", "fixed") for tendon in stiff)
        found.notes.append(f"springs along tendons are left out: {names}")
    return found


def _control(source: Source, given: dict[str, str]) -> tuple[Control | None, float | None, float | None]:
    """Control of an actuator, its stiffness and its damping; no control where it is none of ours.

    MuJoCo's force is gain * command + b0 + b1 * length + b2 * velocity, with a constant gain and an affine bias.
    """
    bias = [*source.numbers(given, "biasprm", "0 0 0", 1, 20), 0.0, 0.0][:3]
    source.numbers(given, "gainprm", "1", 1, 20)
    if given.get("gaintype", "fixed") != "fixed" or given.get("biastype", "none") not in ("none", "affine"):
        return None, None, None
    if given.get("biastype", "none") == "none":
        return ("torque" if given.get("dyntype", "none") != "muscle" else None), None, None
    damping = -float(bias[2]) if bias[2] < 0 else None
    return ("position", -float(bias[1]), damping) if bias[1] < 0 else (None, None, damping)


def _springs(source: Source, name: str, joint: dict[str, str]) -> list[Spring]:
    if joint.get("type", "hinge") not in ("hinge", "slide"):
        return []
    stiffness = float(source.numbers(joint, "stiffness", "0", 1, 3)[0])
    turns = joint.get("type", "hinge") == "hinge"
    rest = float(source.numbers(joint, "springref", "0")[0]) * (math.pi / 180 if turns and source.degrees else 1.0)
    return [Spring(joint=name, stiffness=stiffness, rest=rest)] if stiffness > 0 else []


def _pulls_back(source: Source, tendon: ElementTree.Element, joints: dict[str, dict[str, str]]) -> bool:
    """Whether a fixed tendon is a spring between joints of the hand."""
    stiffness = source.numbers(source.attributes(tendon, tag="tendon"), "stiffness", "0", 1, 3)
    return bool(stiffness.any()) and any(one.get("joint") in joints for one in tendon.findall("joint"))


def _force(source: Source, given: dict[str, str]) -> float | None:
    """Largest force of an actuator before its gear; None where nothing limits it."""
    if source.limited(given, "forcelimited", "forcerange"):
        return float(np.abs(source.numbers(given, "forcerange", "0 0", 2)).max())
    takes_force = given.get("biastype", "none") == "none" and given.get("gaintype", "fixed") == "fixed"
    if takes_force and given.get("dyntype", "none") == "none" and source.limited(given, "ctrllimited", "ctrlrange"):
        gain = abs(float(source.numbers(given, "gainprm", "1", 1, 20)[0]))
        return gain * float(np.abs(source.numbers(given, "ctrlrange", "0 0", 2)).max())
    return None
