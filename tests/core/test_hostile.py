"""The core on hostile inputs: hostile.cpp, compiled with the sanitizers of addresses and undefined behaviour, and plain.

It stops where a number that was read or written lies outside of its array, where memory is taken while problems are
solved, and where what is called solved is not: a balance that does not hold, friction or limits that are exceeded,
bounds above objectives, two methods that contradict each other. Every run has new inputs.
"""

import platform
import secrets
import shutil
import subprocess
from pathlib import Path

import pytest

from pinograsp import core

SOURCE = Path(__file__).with_name("hostile.cpp")
# Unoptimised it compiles in a third of the time; line numbers are enough of the debugger's tables.
SANITIZERS = ["-O0", "-g1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all"]


def compiler() -> str:
    found = next(filter(None, map(shutil.which, ("c++", "g++", "clang++"))), None)
    if found is None:
        pytest.skip("there is no C++ compiler (c++, g++, clang++)")
    return found


def compiled(program: Path, flags: list[str]) -> None:
    always = ["-std=c++17", "-Wall", "-Wextra", "-Wno-psabi", f"-I{core.get_include()}"]
    done = subprocess.run(
        [compiler(), *always, *flags, str(SOURCE), "-o", str(program)], capture_output=True, text=True
    )
    if "-fsanitize=address,undefined" in flags and any(
        name in done.stderr for name in ("lasan", "lubsan", "libclang_rt")
    ):
        pytest.skip("the compiler has no sanitizers")
    assert done.returncode == 0, done.stderr


def wide() -> list[str]:
    """Flags for four lanes, where this processor has them."""
    about = Path("/proc/cpuinfo")
    has = about.exists() and {"avx2", "fma"} <= set(about.read_text().split())
    return ["-mavx2", "-mfma"] if has and platform.machine() in ("x86_64", "AMD64") else []


@pytest.mark.slow
@pytest.mark.parametrize("build", ["sanitized", "plain"])
def test_hostile_inputs(build, tmp_path, often):
    program = tmp_path / "hostile"
    # The plain build has as many lanes as every processor of its kind.
    compiled(program, [*SANITIZERS, *wide()] if build == "sanitized" else ["-O2"])
    seed, count = secrets.randbelow(10**12), often(8_000 if build == "sanitized" else 80_000)
    done = subprocess.run([str(program), str(seed), str(count)], capture_output=True, text=True)
    print(f"{program.name} {seed} {count}\n{done.stdout}")
    assert done.returncode == 0, f"hostile {seed} {count}, {build}:\n{done.stderr}"
    inputs, kinds = done.stdout.splitlines()[0], done.stdout.splitlines()[1:]
    assert inputs.startswith(f"{count} inputs")
    # Not so hostile that nothing converges.
    assert not any(" converged 0," in line for line in kinds), done.stdout
