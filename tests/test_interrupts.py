"""Ctrl-C in long work: at once, and not lost in a destructor."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading

import pytest

from pinograsp.interrupts import interrupts_kept


class Interrupted:
    """Something that Ctrl-C meets while it is being thrown away."""

    def __del__(self):
        self.last_words()

    def last_words(self):
        signal.raise_signal(signal.SIGINT)


@pytest.fixture
def lost(monkeypatch):
    """Exceptions that went nowhere."""
    found = []
    monkeypatch.setattr(sys, "unraisablehook", found.append)
    return found


def test_without_help_python_loses_it(lost):
    Interrupted()
    assert [one.exc_type for one in lost] == [KeyboardInterrupt]


def test_in_a_destructor_it_waits(lost):
    with interrupts_kept() as interrupt:
        interrupt()
        Interrupted()
        with pytest.raises(KeyboardInterrupt):
            interrupt()
    assert not lost and signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_elsewhere_it_comes_at_once():
    with pytest.raises(KeyboardInterrupt), interrupts_kept():
        signal.raise_signal(signal.SIGINT)
        pytest.fail("not reached")
    assert signal.getsignal(signal.SIGINT) is signal.default_int_handler


def test_handlers_of_others_stay():
    heard = []
    before = signal.signal(signal.SIGINT, lambda *_: heard.append(1))
    try:
        with interrupts_kept() as interrupt:
            signal.raise_signal(signal.SIGINT)
            interrupt()
        assert heard == [1]
    finally:
        signal.signal(signal.SIGINT, before)


def test_outside_the_main_thread_nothing_changes():
    seen = []

    def work():
        with interrupts_kept() as interrupt:
            interrupt()
            seen.append(signal.getsignal(signal.SIGINT))

    thread = threading.Thread(target=work)
    thread.start()
    thread.join()
    assert seen == [signal.default_int_handler]


@pytest.mark.slow
def test_processes_of_parallel_work_do_not_hear_ctrl_c():
    """In a process of its own: the first to start such processes is the one that could get it wrong."""
    script = (
        "import signal\n"
        "from pinograsp.processes import parallel_results\n"
        "asked = [(signal.SIG_BLOCK, ())] * 4\n"
        "with parallel_results(signal.pthread_sigmask, asked, 2, return_as='generator') as blocked:\n"
        "    print(all(signal.SIGINT in one for one in blocked))\n"
    )
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=120)
    assert done.returncode == 0 and done.stdout.strip() == "True", done.stderr
