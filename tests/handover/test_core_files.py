"""A grasp for a controller in C++: what is written, and that it gives there what it gives here."""

import json
import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import pinograsp as pg
from pinograsp.core import get_cmake_dir
from pinograsp.errors import InvalidInput
from pinograsp.motion import OnlineForces
from pinograsp.reflex import Felt, Measured

ROOT = Path(__file__).resolve().parents[2]
COMPILER = shutil.which("c++") or shutil.which("g++") or shutil.which("clang++")
LOADS = """
#include <cstdio>
#include "grasp.hpp"
int main() {
    auto loop = grasp::make_loop();
    double load[6];
    for (int t = 0; std::scanf("%lf %lf %lf %lf %lf %lf", load, load + 1, load + 2, load + 3, load + 4, load + 5) == 6; ++t) {
        std::copy(load, load + 6, loop->wrench);
        if (t == 5) loop->engage(0, false);
        if (t == 12) loop->reset();
        std::printf("%d", static_cast<int>(loop->tick()));
        for (int i = 0; i < 3 * grasp::contacts; ++i) std::printf(" %.17g", loop->forces[i]);
        for (int j = 0; j < grasp::joints; ++j) std::printf(" %.17g", loop->torques[j]);
        std::printf("\\n");
    }
}
"""

FELT = """
#include <cstdio>
#include "held.hpp"
int main() {
    auto loop = held::make_loop();
    auto grip = held::make_grip(*loop);
    int kinds, kind;
    for (double now, time, values[64]; std::scanf("%lf %d", &now, &kinds) == 2;) {
        while (kinds-- > 0 && std::scanf("%d %lf", &kind, &time) == 2) {
            const auto which = static_cast<pinograsp::core::Feeling>(kind);
            for (int i = 0; i < grip->size_of(which); ++i)
                if (std::scanf("%lf", values + i) != 1) return 1;
            grip->feel(which, values, time);
        }
        const auto status = grip->tick(now);
        std::printf("%d %d %.17g", static_cast<int>(status), grip->reflexes, grip->mass);
        for (int i = 0; i < 3 * held::contacts; ++i) std::printf(" %.17g", grip->forces[i]);
        for (int j = 0; j < held::joints; ++j) std::printf(" %.17g", grip->torques[j]);
        for (int i = 0; i < held::contacts; ++i) std::printf(" %.17g %.17g", grip->mu_low[i], grip->mu_high[i]);
        std::printf("\\n");
    }
}
"""


@pytest.fixture(scope="module")
def plan():
    return pg.load_case("paper", {"forces.search": "convex", "friction.model": "cone"}).plan()


def test_constants_as_json(plan, tmp_path):
    path = plan.to_core(tmp_path / "grasp.json", max_rate=200.0, ramp=0.1)
    told = json.loads(path.read_text())
    assert told["contact_names"] == list(plan.problem.contacts.names) and told["joint_names"] == list(
        plan.hand.joint_names
    )
    assert np.array(told["points"]) + told["com"] == pytest.approx(plan.problem.contacts.points_o)
    assert np.shape(told["rotations"]) == (3, 3, 3) and told["mu"] == [0.7] * 3
    assert (told["most_rate"], told["ramp"], told["period"], told["moments"]) == (0.2, 0.01, 1e-3, True)
    assert told["load"] == plan.problem.load.tolist() and len(told["jacobian"]) == len(told["gravity"]) == plan.hand.n
    assert json.loads(plan.to_core(path).read_text())["most_rate"] is None


def test_a_header_is_named_after_its_file(plan, tmp_path):
    for name, space in (
        ("grasp", "grasp"),
        ("my mug", "my_mug"),
        ("2 cups", "grasp_2_cups"),
        ("class", "grasp_class"),  # a word of C++
        ("left--hand", "left_hand"),  # two underscores are kept for C++ itself
        ("手", "grasp"),
    ):
        assert f"\nnamespace {space} {{\n" in plan.to_core(tmp_path / f"{name}.hpp").read_text()


def test_what_cannot_be_written(plan, tmp_path):
    with pytest.raises(InvalidInput, match=r"\.hpp or \.json"):
        plan.to_core(tmp_path / "grasp.yaml")
    with pytest.raises(InvalidInput, match="expected one of normal_forces, .*, got 'stiffness'"):
        plan.to_core(tmp_path / "grasp.hpp", stiffness=10.0)
    fine = pg.load_case("paper", {"forces.search": "convex", "friction.edges": 8}).plan()
    with pytest.raises(InvalidInput, match="4 edges"):
        fine.to_core(tmp_path / "grasp.hpp")
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")
def test_the_same_forces_in_a_program_of_ones_own(plan, tmp_path):
    settings = {"max_rate": 500.0, "ramp": 0.01}
    plan.to_core(tmp_path / "grasp.hpp", **settings)
    (tmp_path / "main.cpp").write_text(LOADS)
    command = [COMPILER, "-std=c++17", "-O1", "-Wall", "-Wextra", "-Wno-psabi", "-Werror", f"-I{pg.core.get_include()}"]
    subprocess.run([*command, "main.cpp", "-o", "main"], cwd=tmp_path, check=True, timeout=300)
    loads = plan.problem.load * np.random.default_rng(0).uniform(0.7, 1.2, (20, 6))
    text = "\n".join(" ".join(map(repr, load)) for load in loads.tolist())
    told = subprocess.run([tmp_path / "main"], input=text, capture_output=True, text=True, check=True).stdout
    constants = json.loads(plan.to_core(tmp_path / "grasp.json", **settings).read_text())
    torques = pg.torque_limits(plan.hand, plan.problem.contacts, plan.motion.q[-1], limit=plan.torque_limit)
    here = OnlineForces(replace(plan.problem, torques=torques), hand=plan.hand, q=plan.motion.q[-1], **settings)
    assert constants["joints"] == plan.hand.n
    for t, (load, line) in enumerate(zip(loads, told.splitlines(), strict=True)):
        if t == 5:
            here.engage(0, False)
        if t == 12:
            here.reset()
        forces, efforts, status = here.step(load)
        code, *numbers = map(float, line.split())
        assert (code == 0) == (status is pg.Status.OK)
        assert numbers[:9] == pytest.approx(forces.ravel(), rel=1e-6, abs=1e-7)
        assert numbers[9:] == pytest.approx(efforts, rel=1e-6, abs=1e-8)


def test_a_grip_is_written_with_its_loop(plan, tmp_path):
    grip = plan.grip_controller(latency=0.02, max_rate=100.0)
    text = plan.to_core(tmp_path / "held.hpp", grip=grip).read_text()
    assert "<pinograsp/core/grip.hpp>" in text and "setup.latency = 0.02;" in text and "setup.tells_load = " in text
    told = json.loads(plan.to_core(tmp_path / "held.json", grip=grip).read_text())
    assert told["latency"] == 0.02 and told["loop"]["most_rate"] == pytest.approx(0.1)
    assert told["loop"]["posture"] == plan.motion.q[-1].tolist()
    with pytest.raises(InvalidInput, match="expected no settings beside a grip, which has its own, got ramp"):
        plan.to_core(tmp_path / "held.hpp", grip=grip, ramp=0.1)
    with pytest.raises(InvalidInput, match="expected a GripController"):
        plan.to_core(tmp_path / "held.hpp", grip=True)
    other = replace(plan, motion=replace(plan.motion, forces_o=2.0 * plan.motion.forces_o))
    with pytest.raises(InvalidInput, match="grip of this plan"):
        other.to_core(tmp_path / "held.hpp", grip=grip)


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None, reason="no C++ compiler")
def test_the_same_squeeze_in_a_program_of_ones_own(plan, tmp_path, ticks=3000):
    here = plan.grip_controller(latency=0.02, max_normal_force=40.0)
    plan.to_core(tmp_path / "held.hpp", grip=here)
    (tmp_path / "main.cpp").write_text(FELT)
    command = [COMPILER, "-std=c++17", "-O1", "-Wall", "-Wextra", "-Wno-psabi", "-Werror", f"-I{pg.core.get_include()}"]
    subprocess.run([*command, "main.cpp", "-o", "main"], cwd=tmp_path, check=True, timeout=300)
    rng, planned, lines, own = np.random.default_rng(0), here.forces.copy(), [], []
    for t in range(ticks):
        now, felt = 1e-3 * t, {}
        if t % 700 < 600:  # then nothing is measured for a while
            felt["forces"] = planned * (1 + 0.1 * rng.standard_normal(planned.shape)) * (1.5 if t > 1200 else 1.0)
            felt["slips"] = np.full(len(planned), float(400 < t % 1000 < 440))
        if t % 3 == 0:
            felt["torques"] = plan.motion.holding_torques * rng.uniform(0.8, 1.2)
        line = f"{now!r} {len(felt)}"
        for name, values in felt.items():
            numbers = " ".join(map(repr, np.ravel(values).tolist()))
            line += f" {('forces', 'normal_forces', 'slips', 'torques').index(name)} {now - 0.01!r} {numbers}"
        lines.append(line)
        here.step(Felt(now, **{name: Measured(values, now - 0.01) for name, values in felt.items()}))
        bounds = np.stack([here.mu_low, here.mu_high], axis=1)
        state = [here.reflexes, here.object_mass, *here.forces.ravel(), *here.torques, *bounds.ravel()]
        own.append([here.status is pg.Status.OK, *state])
    text = "\n".join(lines)
    told = subprocess.run([tmp_path / "main"], input=text, capture_output=True, text=True, check=True).stdout
    there = np.array([line.split() for line in told.splitlines()], dtype=float)
    there[:, 0] = there[:, 0] == 0
    assert here.reflexes >= 3 and np.isfinite(here.mu_high).all()
    np.testing.assert_allclose(there, np.array(own), rtol=1e-12, atol=1e-12)


@pytest.mark.slow
@pytest.mark.skipif(COMPILER is None or shutil.which("cmake") is None, reason="no C++ compiler or CMake")
def test_the_example_holds(plan, tmp_path):
    plan.to_core(tmp_path / "grasp.hpp", max_rate=200.0, ramp=0.1)
    settings = [f"-DGRASP_DIR={tmp_path}", f"-Dpinograsp-core_DIR={get_cmake_dir()}"]
    subprocess.run(["cmake", "-S", ROOT / "examples" / "cpp", "-B", "build", *settings], cwd=tmp_path, check=True)
    subprocess.run(["cmake", "--build", "build"], cwd=tmp_path, check=True, timeout=300)
    told = subprocess.run([tmp_path / "build" / "hold", "1"], capture_output=True, text=True, check=True).stdout
    lines = told.splitlines()
    assert len(lines) == 9 and "held" in lines[0] and "closest" in lines[5] and "held in " in lines[-1]
    assert all(float(line.split("off by")[1].split()[0]) < 1e-8 for line in lines[:8] if " held " in line)
