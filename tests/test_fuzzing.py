"""Hostile inputs: every kind of input by the thousand (slow), and what the harness that runs them notices."""

from __future__ import annotations

import os

import pytest
from fuzzing import harness


@pytest.mark.slow
@pytest.mark.parametrize("kind", harness.kinds(), ids=lambda path: path.stem)
def test_no_input_breaks_the_package(kind, request):
    seed, count = request.config.getoption("--fuzz-seed"), request.config.getoption("--fuzz-count")
    jobs = 1 if "PYTEST_XDIST_WORKER" in os.environ else 2  # in parallel tests every process has one core to itself
    failures = [result for result in harness.campaign(kind, seed, range(count), jobs) if result.failure]
    told = "\n\n".join(f"index {failure.index}: {failure.failure}\n{failure.details}" for failure in failures[:5])
    assert not failures, f"{len(failures)} of {count} inputs of seed {seed} failed:\n{told}"


# One kind whose inputs do, one after another, what each of them says.
DOES = {
    "nothing": ("", "label"),
    "own error": ("raise pinograsp.errors.InvalidInput('no')", "label"),
    "exit": ("raise SystemExit(2)", "label"),
    "own file": ("open('mine', 'w').close(); os.rename('mine', 'yours'); os.remove('yours')", "label"),
    "temporary file": ("tempfile.TemporaryDirectory().cleanup()", "label"),
    "local socket": ("socket.socket().bind(('127.0.0.1', 0))", "label"),
    "foreign exception": ("1 / 0", "foreign exception"),
    "wrong exit": ("raise SystemExit(1)", "foreign exception"),
    "too much memory": ("bytearray(10**11)", "foreign exception"),
    "memory refused": (
        "try:\n        bytearray(5 * 2**30)\n    except MemoryError as error:\n"
        "        raise pinograsp.errors.InvalidInput('no') from error",
        "memory",
    ),
    "traceback": ("threading.Thread(target=lambda: 1 / 0).start(); time.sleep(0.05)", "traceback"),
    "foreign file": ("open('/etc/hostname').read()", "file"),
    "file beside": ("open('../../beside', 'w')", "file"),
    "file by a link": ("os.symlink('/etc/hostname', 'link'); open('link')", "file"),
    "secret by compiled code": (f"ctypes.CDLL(None).open({os.fsencode(harness.SECRET)!r}, 0)", "file"),
    "foreign folder": ("os.listdir('/')", "file"),
    "swallowed": ("try:\n        os.mkdir('/x')\n    except OSError:\n        pass", "file"),
    "process": ("subprocess.run(['true'])", "process"),
    "shell": ("os.system('true')", "process"),
    "fork": ("os.fork()", "process"),
    "copies": (
        "with forked_results(abs, [(1,), (-2,)], 2) as found:\n        assert list(found) == [1, 2]",
        "label",
    ),
    "foreign folder in a copy": (
        "with forked_results(os.listdir, [('/',), ('/',)], 2) as found:\n        list(found)",
        "foreign exception",
    ),
    "socket": ("socket.socket(type=socket.SOCK_DGRAM).connect(('192.0.2.1', 9))", "socket"),
    "abort": ("os.abort()", "crash"),
    "segmentation fault": ("ctypes.string_at(0)", "crash"),
    "exit of the process": ("os._exit(0)", "crash"),
    "sleeps": ("time.sleep(60)", "hang"),
    "spins": ("while True: pass", "hang"),
}


@pytest.fixture(scope="module")
def results(tmp_path_factory):
    folder = tmp_path_factory.mktemp("kinds")
    kind = folder / "does.py"
    functions = "\n".join(f"def does_{k}():\n    {body or 'pass'}\n" for k, (body, _) in enumerate(DOES.values()))
    kind.write_text(
        "import ctypes, os, socket, subprocess, sys, tempfile, threading, time\nimport pinograsp\n"
        "import pinograsp.errors\n"
        "from pinograsp.processes import forked_results\n"
        "LOOPBACK, EXIT_CODES = True, (0, 2)\n"
        "def prepare(): pass\n"
        f"{functions}\n"
        "def make(rng, folder):\n"
        "    (folder / 'input').write_text(str(rng.integers(10**9)))\n"
        "    return int(folder.parent.name.split('-')[1])\n"
        "def run(case):\n    globals()[f'does_{case}']()\n    return 'label'\n"
    )
    found = {r.index: r for r in harness.campaign(kind, 3, range(len(DOES)), keep=folder / "kept", time_limit=2.0)}
    return found, folder


@pytest.mark.parametrize("name", DOES)
def test_the_harness_tells_what_an_input_does(name, results):
    found, folder = results
    index = list(DOES).index(name)
    result, expected = found[index], DOES[name][1]
    assert (result.failure or "label") == expected, result.details
    kept = folder / "kept" / f"does-3-{index}"
    assert kept.exists() == bool(result.failure)
    if result.failure:
        assert result.failure in (kept / "failure.txt").read_text()
        assert (kept / "case" / "input").exists()


def test_an_input_follows_from_seed_and_index(results):
    found, folder = results
    index = list(DOES).index("foreign exception")
    again = folder / "again"
    (result,) = harness.campaign(folder / "does.py", 3, [index], keep=again)
    assert result.failure == found[index].failure
    name = f"does-3-{index}/case/input"
    assert (again / name).read_text() == (folder / "kept" / name).read_text()
