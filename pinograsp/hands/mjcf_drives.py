"""Couplings, effort limits, motors and springs of a compiled MJCF: equality constraints, actuators, fixed tendons."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np

from pinograsp.hands.coupling import Coupling, resolve
from pinograsp.hands.drives import ON_DRIVES, Control, Spring
from pinograsp.hands.mjcf_loops import Loop, Rest
from pinograsp.hands.motors import Actuation, Motor

_SAMPLES = 101  # of a curve by which a joint follows another
_NARROW = 0.02  # of the way that a tendon's joints could go: one of so narrow a range couples them
_J, _EQ, _TRN = mujoco.mjtJoint, mujoco.mjtEq, mujoco.mjtTrn
# MuJoCo's arrays hold numbers, which are not equal to members of its enumerations.
_HINGE, _SLIDE = int(_J.mjJNT_HINGE), int(_J.mjJNT_SLIDE)
_NONE, _AFFINE = int(mujoco.mjtBias.mjBIAS_NONE), int(mujoco.mjtBias.mjBIAS_AFFINE)
_FIXED, _STATIC = int(mujoco.mjtGain.mjGAIN_FIXED), int(mujoco.mjtDyn.mjDYN_NONE)
_SITE, _WRAP_JOINT = int(mujoco.mjtObj.mjOBJ_SITE), int(mujoco.mjtWrap.mjWRAP_JOINT)


def find_couplings(
    model: mujoco.MjModel,
    joints: Mapping[str, int],
    bodies: set[int],
    names: Sequence[str],
    notes: list[str],
    problems: list[str],
) -> tuple[dict[str, Coupling], list[Loop], list[str]]:
    """Equality constraints between two joints, and tendons that leave two joints one way to go, as couplings: lines,
    and curves as the lines nearest to them, noted.

    Args:
        model: compiled.
        joints: ids of the hand's joints, by name.
        bodies: ids of the hand's bodies.
        names: of all bodies.
        notes, problems: more are added.

    Returns:
        The couplings, loops that other constraints close, and the constraints that are neither, in words.
    """
    found = _Couplings(model, joints, notes, problems)
    loops: list[Loop] = []
    opened: list[str] = []
    for e in range(model.neq):
        if not model.eq_active0[e]:
            continue
        kind, one, other = _EQ(int(model.eq_type[e])), int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
        if kind == _EQ.mjEQ_JOINT:
            found.add_joints(one, other, model.eq_data[e][:5].tolist())
        elif kind == _EQ.mjEQ_TENDON and other < 0 and found.add_tendon(one, float(model.eq_data[e][0])):
            continue
        elif kind in (_EQ.mjEQ_CONNECT, _EQ.mjEQ_WELD):
            ends, anchors, text = _ends(model, e, names)
            if kind == _EQ.mjEQ_CONNECT and bodies.issuperset(ends):
                loops.append(Loop(links=(names[ends[0]], names[ends[1]]), anchors=anchors, name=text))
            elif not bodies.isdisjoint(ends):
                opened.append(text)
        else:
            opened.append(f"{kind.name.removeprefix('mjEQ_').lower()} {model.equality(e).name}".strip())
    for tendon in range(model.ntendon):
        if model.tendon_limited[tendon]:
            found.narrow(tendon)
    return found.couplings, loops, opened


def _ends(
    model: mujoco.MjModel, e: int, names: Sequence[str]
) -> tuple[tuple[int, int], tuple[np.ndarray, np.ndarray], str]:
    """Bodies of a connection or weld, its points in their frames (3,), and what to call it."""
    ids = int(model.eq_obj1id[e]), int(model.eq_obj2id[e])
    word = "connect" if _EQ(int(model.eq_type[e])) == _EQ.mjEQ_CONNECT else "weld"
    if model.eq_objtype[e] == _SITE:
        bodies = int(model.site_bodyid[ids[0]]), int(model.site_bodyid[ids[1]])
        called = [model.site(i).name or names[body] for i, body in zip(ids, bodies)]
        return bodies, (model.site_pos[ids[0]].copy(), model.site_pos[ids[1]].copy()), f"{word} {' and '.join(called)}"
    anchors = model.eq_data[e][:3].copy(), model.eq_data[e][3:6].copy()
    return ids, anchors, f"{word} {names[ids[0]]} and {names[ids[1]]}"


class _Couplings:
    """Couplings of a hand's joints, as its constraints are read one after the other."""

    def __init__(self, model: mujoco.MjModel, joints: Mapping[str, int], notes: list[str], problems: list[str]):
        self.model, self.notes, self.problems = model, notes, problems
        self.names = {joint: name for name, joint in joints.items()}
        self.driven = {self.names.get(joint) for a in range(model.nactuator) for joint, _ in _arms(model, a)}
        self.couplings: dict[str, Coupling] = {}

    def add_joints(self, one: int, other: int, curve: list[float]) -> None:
        """An equality constraint of one joint and, unless -1, another one that it follows."""
        if one not in self.names:
            return  # elsewhere on the robot
        name, (c0, c1, *rest) = self.names[one], curve
        if other < 0 or (c1 == 0 and not any(rest)):
            self.problems.append(f"joint '{name}' is held still by an equality constraint: remove the joint")
        elif other not in self.names:
            leader = self.model.joint(other).name
            self.problems.append(f"joint '{name}' follows '{leader}', which is no joint of the hand")
        else:
            if any(rest):
                if not self.model.jnt_limited[other]:
                    leader = self.names[other]
                    self.problems.append(
                        f"joint '{name}' follows '{leader}' by a curve: '{leader}' needs a range to fit a line to it"
                    )
                    return
                c0, c1 = self._line(one, other, curve)
            offset = c0 + _rest(self.model, one) - c1 * _rest(self.model, other)
            self._couple(name, Coupling(followed=self.names[other], factor=c1, offset=offset))

    def add_tendon(self, tendon: int, length: float) -> bool:
        """A fixed tendon that keeps a length, counted from the joints' references; False where it does not couple two
        joints of the hand. A motor's joint is followed, whose limits are those that count.
        """
        arms = [(joint, arm) for joint, arm in tendon_arms(self.model, tendon) if arm]
        if len(arms) != 2 or any(joint not in self.names for joint, _ in arms):
            return False
        length += float(self.model.tendon_length0[tendon])
        (one, arm), (other, led) = sorted(
            arms, key=lambda end: self._find_leader(self.names[end[0]]).followed in self.driven
        )
        coupling = Coupling(followed=self.names[other], factor=-led / arm, offset=length / arm)
        self._couple(self.names[one], coupling)
        return True

    def narrow(self, tendon: int) -> None:
        """A tendon of limited length, where two joints could go much farther than it lets them."""
        model = self.model
        arms = tendon_arms(model, tendon)
        low, high = model.tendon_range[tendon].tolist()
        free = [
            abs(arm) * float(np.ptp(model.jnt_range[joint])) if model.jnt_limited[joint] else math.inf
            for joint, arm in arms
        ]
        hand = [self.names[joint] for joint, _ in arms if joint in self.names]
        if len(hand) < 2 or high - low > _NARROW * min(free):
            return
        middle = 0.5 * (low + high) - float(model.tendon_length0[tendon])
        name = model.tendon(tendon).name or "a tendon"
        if self.add_tendon(tendon, middle):
            self.notes.append(f"tendon '{name}' lets {' and '.join(hand)} move only together: taken as coupled")
        else:
            self.notes.append(f"the narrow range of tendon '{name}' over {', '.join(hand)} is left out")

    def _line(self, one: int, other: int, curve: list[float]) -> tuple[float, float]:
        """Offset and factor of the line nearest to a curve by which a joint follows another, over that one's range;
        noted. Both count from the joints' reference positions.
        """
        model = self.model
        low, high = model.jnt_range[other] - _rest(model, other)
        x = np.linspace(low, high, _SAMPLES)
        y = np.polynomial.Polynomial(curve)(x)
        factor, offset = np.polyfit(x, y, 1).tolist()
        off = float(np.abs(factor * x + offset - y).max())
        amount = f"{np.degrees(off):.2g} deg" if model.jnt_type[one] == _HINGE else f"{1e3 * off:.2g} mm"
        self.notes.append(
            f"joint {self.names[one]} follows {self.names[other]} by a curve, taken as the line nearest to it: off by "
            f"at most {amount}"
        )
        return offset, factor

    def _find_leader(self, name: str) -> Coupling:
        own = Coupling(followed=name, factor=1.0, offset=0.0)
        while own.followed in self.couplings:
            own = own.after(self.couplings[own.followed])
        return own

    def _couple(self, joint: str, coupling: Coupling) -> None:
        """Add a coupling between joints that may be coupled already; a problem where it contradicts the others."""
        one, other = self._find_leader(joint), coupling.after(self._find_leader(coupling.followed))
        if one.followed != other.followed:  # the leader of one group follows that of the other
            self.couplings[one.followed] = one.inverse(joint).after(other)
        elif not np.allclose([one.factor, one.offset], [other.factor, other.offset], rtol=1e-9, atol=1e-12):
            self.problems.append(f"equality constraints contradict each other at joint '{joint}'")


def _rest(model: mujoco.MjModel, joint: int) -> float:
    return float(model.qpos0[model.jnt_qposadr[joint]])


def _moves(model: mujoco.MjModel, joint: int) -> bool:
    return model.jnt_type[joint] in (_HINGE, _SLIDE)


def read_rests(model: mujoco.MjModel, joints: Mapping[str, int]) -> dict[str, Rest]:
    """Reference positions and springs of hinges and slides, by name."""
    return {
        name: Rest(
            reference=_rest(model, joint),
            stiffness=max(0.0, float(model.jnt_stiffness[joint])),
            relaxed=float(model.qpos_spring[model.jnt_qposadr[joint]]),
        )
        for name, joint in joints.items()
        if _moves(model, joint)
    }


def find_effort_limits(
    model: mujoco.MjModel, joints: Mapping[str, int], couplings: dict[str, Coupling], notes: list[str]
) -> dict[str, float]:
    """Largest force or torque of the motors [N or N m], by actuated joint; joints without a limit are left out.

    Force ranges, or control ranges of motors that take a force, times gear (and the coefficients of fixed tendons).
    What acts on coupled joints is carried over to the joint that they follow.
    """
    direct, _ = resolve(couplings, dict.fromkeys(joints, "revolute"))
    leader = {name: direct.get(name, Coupling(followed=name, factor=1.0, offset=0.0)) for name in joints}
    names = {joint: name for name, joint in joints.items()}
    limits: dict[str, float] = {}
    endless: set[str] = set()
    shared: list[str] = []
    for a in range(model.nactuator):
        moments: dict[str, float] = {}
        for joint, arm in _arms(model, a):
            if joint in names:
                one = leader[names[joint]]
                moments[one.followed] = moments.get(one.followed, 0.0) + arm * one.factor
        if len(moments) > 1:
            shared.append(f"{_name(model, a)} ({', '.join(moments)})")
            continue
        force = max(map(abs, _forces(model, a)))
        for name, moment in moments.items():
            if force == math.inf:
                endless.add(name)
            else:
                limits[name] = limits.get(name, 0.0) + abs(moment) * force
    if shared:
        notes.append(f"effort limits do not include actuators that pull several joints at once: {', '.join(shared)}")
    limits = {name: limit for name, limit in limits.items() if name not in endless}
    for name, joint in joints.items():
        if model.jnt_actfrclimited[joint]:
            one = leader[name]
            cap = abs(one.factor) * float(np.abs(model.jnt_actfrcrange[joint]).max())
            limits[one.followed] = min(limits.get(one.followed, cap), cap)
    return limits


def tendon_arms(model: mujoco.MjModel, tendon: int) -> list[tuple[int, float]]:
    """Joints of a fixed tendon and their coefficients; none of a spatial one."""
    first = int(model.tendon_adr[tendon])
    wraps = range(first, first + int(model.tendon_num[tendon]))
    return [(int(model.wrap_objid[w]), float(model.wrap_prm[w])) for w in wraps if model.wrap_type[w] == _WRAP_JOINT]


def _name(model: mujoco.MjModel, a: int) -> str:
    joints = ", ".join(model.joint(joint).name for joint, _ in _arms(model, a))
    return model.actuator(a).name or f"motor {joints or a}"


def _arms(model: mujoco.MjModel, a: int) -> list[tuple[int, float]]:
    """Joints that an actuator pulls, and the torque or force at each per unit of its own force; [] of other ones."""
    kind, target = _TRN(int(model.actuator_trntype[a])), int(model.actuator_trnid[a, 0])
    gear = float(model.actuator_gear[a, 0])
    if kind in (_TRN.mjTRN_JOINT, _TRN.mjTRN_JOINTINPARENT):
        return [(target, gear)] if _moves(model, target) else []
    if kind == _TRN.mjTRN_TENDON:
        return [(joint, gear * arm) for joint, arm in tendon_arms(model, target)]
    return []


def read_actuation(model: mujoco.MjModel, joints: Mapping[str, int]) -> Actuation:
    """Motors at the hand's joints, by themselves or by fixed tendons, and springs at these joints."""
    found, names = Actuation(), {joint: name for name, joint in joints.items()}
    elsewhere: list[str] = []
    for a in range(model.nactuator):
        arms = _arms(model, a)
        name = _name(model, a)
        if not arms:
            elsewhere.append(name)
        own = {names[joint]: arm for joint, arm in arms if joint in names}
        if not own:
            continue
        control, stiffness, damping = _control(model, a)
        least, most = _forces(model, a)
        found.motors.append(
            Motor(
                name=name,
                arms=own,
                control=control or "torque",
                limit=max(abs(least), abs(most)),
                efforts=None if least == -most else (least, most),
                stiffness=stiffness,
                damping=damping,
                remark="" if control else f"of a kind that is {_kind(model, a)}, taken as torque motors",
            )
        )
    if elsewhere:
        found.notes.append(
            f"{ON_DRIVES}left out are actuators that pull neither a joint nor a fixed tendon: {', '.join(elsewhere)}"
        )
    found.springs = [
        Spring(joint=name, stiffness=rest.stiffness, rest=rest.relaxed)
        for name, rest in read_rests(model, joints).items()
        if rest.stiffness > 0
    ]
    stiff = [
        model.tendon(t).name or "fixed"
        for t in range(model.ntendon)
        if model.tendon_stiffness[t] and any(joint in names for joint, _ in tendon_arms(model, t))
    ]
    if stiff:
        found.notes.append(f"springs along tendons are left out: {', '.join(stiff)}")
    return found


def _kind(model: mujoco.MjModel, a: int) -> str:
    gain, bias = mujoco.mjtGain(int(model.actuator_gaintype[a])), mujoco.mjtBias(int(model.actuator_biastype[a]))
    words = [one.name.split("_", 1)[1].lower() for one in (gain, bias)]
    return f"neither a torque motor nor a position servo (gain {words[0]}, bias {words[1]})"


def _control(model: mujoco.MjModel, a: int) -> tuple[Control | None, float | None, float | None]:
    """Control of an actuator, its stiffness and its damping; no control where it is none of ours.

    MuJoCo's force is gain * command + b0 + b1 * length + b2 * velocity, with a constant gain and an affine bias.
    """
    bias, kind = model.actuator_biasprm[a], int(model.actuator_biastype[a])
    if model.actuator_gaintype[a] != _FIXED or kind not in (_NONE, _AFFINE):
        return None, None, None
    if kind == _NONE:
        return "torque", None, None
    damping = -float(bias[2]) if bias[2] < 0 else None
    return ("position", -float(bias[1]), damping) if bias[1] < 0 else (None, None, damping)


def _forces(model: mujoco.MjModel, a: int) -> tuple[float, float]:
    """Least and largest force of an actuator before its gear; infinite where nothing limits it."""
    if model.actuator_forcelimited[a]:
        low, high = model.actuator_forcerange[a].tolist()
        return low, high
    takes_force = model.actuator_biastype[a] == _NONE and model.actuator_gaintype[a] == _FIXED
    plain = model.actuator_dyntype[a] == _STATIC
    u = int(model.actuator_ctrladr[a])
    if takes_force and plain and model.actuator_ctrlnum[a] == 1 and model.actuator_ctrllimited[u]:
        ends = float(model.actuator_gainprm[a, 0]) * model.actuator_ctrlrange[u]
        return float(ends.min()), float(ends.max())
    return -math.inf, math.inf
