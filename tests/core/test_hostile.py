"""The C++ tests of the core (``tests/core/CMakeLists.txt``), run by CTest against the CMake package that is installed.

``checks.cpp``: what the records refuse, and answers known by hand. ``hostile.cpp``: random and hostile inputs, plain and
with the sanitizers of addresses and undefined behaviour. It stops where a number that was read or written lies outside
of its array, where memory is taken while problems are solved, and where what is called solved is not: a balance that
does not hold, friction or limits that are exceeded, bounds above objectives, two methods that contradict each other.
``touches.cpp``: random and hostile solids, hands and objects, likewise; whether planes part what is apart, and no way out
is shorter than the one that is found. Every run has new inputs.
"""

import secrets
import shutil
import subprocess
from pathlib import Path

import pytest

from pinograsp import core


def run(*command: object) -> str:
    done = subprocess.run([str(one) for one in command], capture_output=True, text=True)
    assert done.returncode == 0, f"{' '.join(map(str, command))}\n{done.stdout[-20_000:]}\n{done.stderr[-20_000:]}"
    return done.stdout


@pytest.mark.slow
def test_the_core_by_ctest(tmp_path, often):
    if shutil.which("cmake") is None or not any(map(shutil.which, ("c++", "g++", "clang++"))):
        pytest.skip("there is no CMake, or no C++ compiler (c++, g++, clang++)")
    seed, count = secrets.randbelow(10**12), often(80_000)
    settings = f"-Dpinograsp-core_DIR={core.get_cmake_dir()}", f"-DHOSTILE_SEED={seed}", f"-DHOSTILE_COUNT={count}"
    run("cmake", "-S", Path(__file__).parent, "-B", tmp_path, "-DCMAKE_BUILD_TYPE=", *settings)
    run("cmake", "--build", tmp_path, "--parallel")
    told = run("ctest", "--test-dir", tmp_path, "--verbose")
    print(told)
    assert "all checks hold" in told
    assert f" {count} inputs in " in told, f"hostile {seed} {count}"
    assert f"touches of {count} inputs hold" in told, f"touches {seed} {count}"
    # Not so hostile that nothing converges.
    lines = [line for line in told.splitlines() if " converged " in line]
    assert len(lines) >= 5 and not any(" converged 0," in line for line in lines)
