"""Which limits are in the way of forces: two jaws at a ball, whose figures are known in closed form."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.forces import Reserve, TorqueLimits, diagnose
from pinograsp.forces.relaxation import Setup, find_relaxations, forces_exist, relax

MU, MASS = 0.6, 0.4
WEIGHT = 9.81 * MASS
NEEDED = WEIGHT / (2 * MU)  # of each jaw: friction of two contacts carries the weight
WIDE = {"acceleration_range": (1e-6, 1e3), "max_speed": 1e3, "max_depth": 0.1}
SHARP = 0.02  # the figures are a hundredth beyond the least, and have three digits


@pytest.fixture
def jaws(contact_set):
    """Two contacts that face each other on a ball, each pressed by a sliding joint of its own."""

    def make(*, reserve=None, effort=None, **settings):
        contacts = contact_set([(name, "", [s * 0.03, 0, 0], [-s, 0, 0], None) for name, s in (("l", 1), ("r", -1))])
        body = pg.Sphere(radius=0.03, mass=settings.pop("mass", MASS))
        friction = pg.Friction(model="soft", torsion=0.01)
        problem = pg.ForceProblem.holding(
            body, contacts, mu=settings.pop("mu", MU), friction=friction, **{**WIDE, **settings}
        )
        if effort is not None:
            jacobian = np.zeros((2, 6, 2))
            jacobian[0, 0, 0], jacobian[1, 0, 1] = -1.0, 1.0
            limits = TorqueLimits(jacobian=jacobian, bias=np.zeros(2), limit=np.full(2, effort), joints=("l", "r"))
            problem = replace(problem, torques=limits)
        return Setup(problem, reserve)

    return make


def options(setup, works=forces_exist):
    found = {tuple(one.limit for one in option): option for option in find_relaxations(setup, works)}
    for option in found.values():  # every one of them does, and hardly more than needed
        assert works(relax(setup, option))
        for one in option:
            less = replace(one, factor=one.factor * (1 - 1.25 * SHARP))
            others = [other for other in option if other is not one]
            assert not works(relax(setup, [less, *others]))
    return found


@pytest.mark.parametrize("share", [0.03, 0.4, 0.9])
@pytest.mark.parametrize(
    ("limit", "given"),
    [
        ("torque_limit", lambda share: {"effort": share * NEEDED}),
        ("max_normal_force", lambda share: {"max_normal_force": share * NEEDED}),
        ("max_depth", lambda share: {"max_depth": (share * NEEDED / 5e4) ** (1 / 1.5)}),
    ],
)
def test_a_limit_in_the_way_is_named_with_what_would_do(jaws, limit, given, share):
    """The cap on F_n that remains is share W / (2 mu): the limit, 1 / share of the friction, or share of the mass."""
    setup = jaws(**given(share))
    assert not forces_exist(setup)
    found = options(setup)
    power = 1 / 1.5 if limit == "max_depth" else 1.0
    assert found[limit,][0].factor == pytest.approx(share**-power, rel=SHARP)
    assert found["mass",][0].factor == pytest.approx(1 / share, rel=SHARP)
    assert (("mu",) in found) == (MU / share < 10)
    if MU / share < 10:
        assert found["mu",][0].factor == pytest.approx(1 / share, rel=SHARP)
    assert set(found) <= {(limit,), ("mass",), ("mu",)}


def test_only_the_joints_that_are_too_weak_are_named(jaws):
    setup = jaws(effort=1.5 * NEEDED)
    limit = np.array([1.5 * NEEDED, 0.25 * NEEDED])
    weak = replace(setup, problem=replace(setup.problem, torques=replace(setup.problem.torques, limit=limit)))
    (raised,) = next(option for option in find_relaxations(weak, forces_exist) if option[0].limit == "torque_limit")
    assert raised.joints == (1,) and raised.factor == pytest.approx(4.0, rel=SHARP)
    words = raised.words(weak, [True, True])
    assert " r:" in words and f"{raised.factor * limit[1]:.3g}" in words.replace("0 N", " N") and " N m" not in words


def test_limits_that_are_only_together_in_the_way_are_named_together(jaws):
    setup = jaws(effort=0.2 * NEEDED, max_normal_force=0.5 * NEEDED)
    found = options(setup)
    assert ("torque_limit", "max_normal_force") in found and ("torque_limit",) not in found
    effort, cap = found["torque_limit", "max_normal_force"]
    assert effort.factor == pytest.approx(5.0, rel=SHARP) and cap.factor == pytest.approx(2.0, rel=SHARP)
    assert found["mass",][0].factor == pytest.approx(5.0, rel=SHARP)


@pytest.mark.parametrize(
    ("part", "share"), [("disturbance", 30.0), ("normal_force", 20.0), ("friction", 0.99), ("mass", 0.95)]
)
def test_the_part_of_a_reserve_that_asks_for_too_much_is_named(jaws, part, share):
    cap = 3.0 * NEEDED if part != "mass" else 1.5 * NEEDED
    setup = jaws(reserve=replace(Reserve.none(), **{part: share}), max_normal_force=cap)
    name = "reserve_mass" if part == "mass" else part
    found = options(setup)
    assert (name,) in found and ("max_normal_force",) in found
    left = relax(setup, found[name,]).reserve
    # Weights of 1 + share, mu of 1 - share, at least a share of the weight: within three or one and a half times.
    known = {"normal_force": 3.0 * NEEDED / WEIGHT, "friction": 1 - 1 / 3, "mass": 0.5}
    if part in known:
        assert getattr(left, part) == pytest.approx(known[part], rel=SHARP)


def test_what_nothing_helps_has_no_options(contact_set):
    contacts = contact_set([("a", "", [0.0, 0, 0.03], [0, 0, -1], None), ("b", "", [0.01, 0, 0.03], [0, 0, -1], None)])
    ball = pg.Sphere(radius=0.03, mass=MASS)
    problem = pg.ForceProblem.holding(ball, contacts, mu=MU, balance="force", **WIDE)
    assert not [option for option in find_relaxations(Setup(problem, None), forces_exist) if option[0].limit != "mass"]


def test_no_friction_at_all_is_named(jaws):
    setup = jaws(mu=0.0, max_normal_force=2 * NEEDED)
    assert options(setup)["mu",][0].apply(setup).problem.mu == pytest.approx(MU / 2, rel=SHARP)


def test_a_diagnosis_names_the_limit_of_forces_or_torques(jaws):
    for settings, name in (({"effort": 0.5 * NEEDED}, "torque_limit"), ({"max_normal_force": 1.0}, "max_normal_force")):
        told = str(diagnose(jaws(**settings).problem, 0.9))
        assert name in told and "2.000 times" not in told
        assert name not in str(diagnose(jaws(effort=2 * NEEDED).problem, 0.9))


def test_a_message_has_one_norm(jaws):
    """What is left at least is told once: by the proof."""
    found = pg.optimize_forces(jaws(max_normal_force=0.5 * NEEDED).problem, 0.9)
    assert str(found).count(f"{found.infeasibility.margin:.4g} N") == 1
    assert str(found).count(" N ") + str(found).count(" N,") == 1
