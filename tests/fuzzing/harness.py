"""Runs the inputs of a kind in worker processes, and tells what no input may bring about.

A kind is a module with ``make(rng, folder)``, which writes one input into the empty ``folder`` and returns a case, and
``run(case) -> str``, which uses it as a user would and returns a short label. It may also have

- ``prepare()``: called once in every worker, without watching (imports, compiling); without it all public names are imported;
- ``EXIT_CODES``: exit codes with which ``run`` may end, by ``SystemExit``;
- ``LOOPBACK = True``: sockets on this machine are fine;
- ``TIME_LIMIT``: seconds for one of its inputs, instead of the harness's.

Failures are: an exception other than a ``PinograspError``, a traceback printed, a crash of the interpreter, more than
20 s, more than 4 GiB beyond what the imports take, a process started, a socket, and a file opened, listed or changed
elsewhere than in the case's folder, a folder for temporary files and (for reading) the installed Python code. Files
that compiled libraries open by themselves are not seen, but for :data:`SECRET`, which no input may have read."""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import importlib.util
import os
import resource
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import threading
import time
import traceback
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection, Pipe, wait
from pathlib import Path
from typing import ClassVar

import numpy as np

HERE = Path(__file__).resolve().parent
NO_KINDS = ("__init__", "harness", "campaign", "material")
TIME_LIMIT = 20.0  # [s] for one input, without the time in which the machine was busy with others
PREPARE_LIMIT = 600.0  # [s] for a worker to start: compiling may be part of it
MEMORY_LIMIT = 4 * 2**30  # [bytes] of address space beyond that of the imports
SECRET = "../outside/secret.txt"  # a file beside the case's folder, as inputs name it
RECYCLE = 300  # inputs, after which a worker makes room for a new one


@dataclass(frozen=True)
class Result:
    """What became of one input: a ``label``, or what went wrong (``failure``: a short word) and the ``details``."""

    index: int
    label: str
    failure: str = ""
    details: str = ""


def kinds() -> list[Path]:
    """The modules of kinds in this folder."""
    return sorted(path for path in HERE.glob("*.py") if path.stem not in NO_KINDS)


def campaign(
    kind: Path,
    seed: int,
    indices: Iterable[int],
    jobs: int = 2,
    keep: Path | None = None,
    time_limit: float = TIME_LIMIT,
) -> Iterator[Result]:
    """The results of the inputs ``indices``, as they come. Folders of those that fail go to ``keep``."""
    waiting = iter(indices)
    workers: dict[Connection, _Worker] = {}
    with tempfile.TemporaryDirectory(prefix="fuzzing-") as root:
        try:
            while True:
                while len(workers) < jobs and (index := next(waiting, None)) is not None:
                    worker = _Worker(kind, seed, Path(root), time_limit)
                    worker.give(index)
                    workers[worker.link] = worker
                if not workers:
                    return
                ready = wait(list(workers), timeout=0.25)
                for link, worker in list(workers.items()):
                    result = worker.look(link in ready)
                    if result is None:
                        continue
                    if result.failure and keep is not None:
                        _keep(keep, kind, seed, result, worker.folder)
                    shutil.rmtree(worker.folder, ignore_errors=True)
                    following = next(waiting, None) if worker.fresh else None
                    if following is None:
                        worker.end()
                        del workers[link]
                    else:
                        worker.give(following)
                    yield result
        finally:
            for worker in workers.values():
                worker.end()


def _keep(keep: Path, kind: Path, seed: int, result: Result, folder: Path) -> None:
    target = keep / f"{kind.stem}-{seed}-{result.index}"
    shutil.rmtree(target, ignore_errors=True)
    target.mkdir(parents=True)
    if (folder / "case").is_dir():
        shutil.copytree(folder / "case", target / "case", symlinks=True, ignore=_pipes, dirs_exist_ok=True)
    (target / "failure.txt").write_text(f"{result.failure}\n{result.details}\n", encoding="utf-8", errors="replace")


def _pipes(folder: str, names: list[str]) -> list[str]:
    """Those of the names that cannot be copied."""
    return [name for name in names if Path(folder, name).is_fifo()]


class _Worker:
    """A process that runs inputs one after another, as its parent sees it."""

    def __init__(self, kind: Path, seed: int, root: Path, time_limit: float):
        self.root, self.most = root, time_limit
        self.link, far = Pipe()
        self.said = tempfile.TemporaryFile(dir=root)  # noqa: SIM115 - lives as long as the process
        path = os.pathsep.join([str(HERE.parent), *filter(None, [os.environ.get("PYTHONPATH")])])
        # One thread per worker: the time of an input is then the same on any number of cores.
        threads = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")
        self.process = subprocess.Popen(
            [sys.executable, "-m", "fuzzing.harness", str(far.fileno()), str(kind), str(seed)],
            pass_fds=[far.fileno()],
            stdin=subprocess.DEVNULL,
            stdout=self.said,
            stderr=self.said,
            env={**os.environ, "PYTHONPATH": path, "PYTHONFAULTHANDLER": "1", **threads},
        )
        far.close()
        self.done = 0
        self.clock = None  # runs from the moment the worker takes up the input
        self.time_limit = self.most
        self.started = time.monotonic()

    @property
    def fresh(self) -> bool:
        return self.process.poll() is None and self.done < RECYCLE

    def give(self, index: int) -> None:
        self.index, self.case, self.clock = index, "", None
        self.folder = self.root / f"{self.process.pid}-{index}"
        for name in ("case", "temp", "outside"):
            (self.folder / name).mkdir(parents=True)
        (self.folder / "case" / SECRET).write_text("secret")
        self.said.seek(0)
        self.said.truncate()
        with contextlib.suppress(OSError):  # died in between: look() will tell
            self.link.send((index, str(self.folder)))

    def look(self, ready: bool) -> Result | None:
        """The result of the input in hand, if it is there."""
        if ready:
            try:
                what, *rest = self.link.recv()
            except (EOFError, OSError):
                code = self.process.wait()
                return self._result("", "crash", f"the worker ended with code {code}")
            if what == "case":
                self.case, self.clock = rest[0], _Clock(self.process.pid)
                self.time_limit = min(self.most, rest[1])
                return None
            return self._result(*rest)
        if self.clock is not None and self.clock.elapsed() > self.time_limit:
            return self._stopped(f"more than {self.time_limit:g} s")
        if self.clock is None and time.monotonic() - self.started > PREPARE_LIMIT and not self.done:
            return self._stopped(f"not ready after {PREPARE_LIMIT:g} s")
        return None

    def _stopped(self, why: str) -> Result:
        # The stack of the hang: the worker's fault handler prints it on this signal.
        self.process.send_signal(_STACK_SIGNAL)
        time.sleep(0.3)
        self.end()
        return self._result("", "hang", why)

    def _result(self, label: str, failure: str, details: str) -> Result:
        self.done += 1
        self.said.seek(0)
        said = self.said.read().decode(errors="replace")
        if not failure and "Traceback (most recent call last)" in said:
            failure = "traceback"
        if failure:
            details = f"{details}\ncase: {self.case}\n" + (f"printed:\n{said[-8000:]}" if said else "")
        return Result(self.index, label, failure, details)

    def end(self) -> None:
        self.process.kill()
        self.process.wait()
        self.link.close()


class _Clock:
    """Seconds for which a process could have run: those in which a thread of it waited for a free core do not count."""

    def __init__(self, pid: int):
        self.tasks = Path(f"/proc/{pid}/task")
        self.start, self.delays = time.monotonic(), self._delays()

    def _delays(self) -> dict[str, float]:
        delays = {}
        for task in self.tasks.glob("*/schedstat"):
            try:
                delays[task.parent.name] = 1e-9 * int(task.read_text().split()[1])
            except (OSError, IndexError):  # the thread is gone
                continue
        return delays

    def elapsed(self) -> float:
        wall = time.monotonic() - self.start
        if wall < 1.0:
            return wall
        return wall - max((delay - self.delays.get(task, 0.0) for task, delay in self._delays().items()), default=0.0)


# What follows runs in the worker.

if sys.platform != "win32":
    import signal

    _STACK_SIGNAL = signal.SIGUSR1


def module_of(kind: Path):
    """The module of a kind, imported under its own name where it is in this folder."""
    if kind.resolve().parent == HERE:
        return importlib.import_module(f"fuzzing.{kind.stem}")
    spec = importlib.util.spec_from_file_location(kind.stem, kind)
    module = sys.modules[kind.stem] = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def _work(descriptor: int, kind: Path, seed: int) -> None:
    import faulthandler

    faulthandler.enable()
    faulthandler.register(_STACK_SIGNAL)
    link = Connection(descriptor)
    module = module_of(kind)
    getattr(module, "prepare", import_public_names)()
    watch = _Watch(getattr(module, "LOOPBACK", False), kind)
    sys.addaudithook(watch)
    taken = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (taken + MEMORY_LIMIT, resource.getrlimit(resource.RLIMIT_AS)[1]))
    while True:
        try:
            index, folder = link.recv()
        except EOFError:
            return
        label, failure, details = _run(module, np.random.default_rng([seed, index]), Path(folder), watch, link)
        sys.stdout.flush()
        sys.stderr.flush()
        link.send(("result", label, failure, details))


def import_public_names() -> None:
    import pinograsp

    for name in pinograsp.__all__:
        getattr(pinograsp, name)


def _run(module, rng, folder: Path, watch: _Watch, link: Connection) -> tuple[str, str, str]:
    from pinograsp.errors import PinograspError

    os.chdir(folder / "case")
    os.environ["TMPDIR"] = tempfile.tempdir = str(folder / "temp")
    try:
        case = module.make(rng, folder / "case")
        link.send(("case", repr(case)[:4000], getattr(module, "TIME_LIMIT", TIME_LIMIT)))
    except BaseException:
        return "", "make failed", traceback.format_exc()
    label = failure = details = ""
    watch.begin(folder)
    error = None
    with _Opened(folder / "case" / SECRET) as opened:
        try:
            label = module.run(case)
        except BaseException as raised:
            error = raised
        finally:
            watch.end()
    if opened.seen:
        watch.seen.append(("file", f"{SECRET}, by a compiled library"))
    if isinstance(error, PinograspError):
        label = type(error).__name__
        if _for_memory(error):  # an honest refusal, but on a larger machine there would have been none
            failure, details = "memory", _shortened("".join(traceback.format_exception(error)))
    elif error is not None:
        if isinstance(error, SystemExit) and (error.code or 0) in getattr(module, "EXIT_CODES", ()):
            label = f"exit {error.code or 0}"
        else:
            failure, details = "foreign exception", _shortened("".join(traceback.format_exception(error)))
    if watch.seen:
        failure, details = watch.seen[0][0], "\n".join([*(what for _, what in watch.seen[:10]), details])
    return label, failure, details


def _for_memory(error: BaseException | None) -> bool:
    """Whether an error stems from one of memory."""
    while error is not None and not isinstance(error, MemoryError):
        error = error.__cause__ or error.__context__
    return error is not None


class _Opened:
    """Notices that a file is opened, by whatever code, while this context lasts."""

    _OPEN = 0x20  # IN_OPEN of inotify(7)

    def __init__(self, path: Path):
        self.path, self.seen = path, False

    def __enter__(self) -> _Opened:
        libc = ctypes.CDLL(None, use_errno=True)
        self.descriptor = libc.inotify_init1(os.O_NONBLOCK | os.O_CLOEXEC)
        if self.descriptor < 0 or libc.inotify_add_watch(self.descriptor, os.fsencode(self.path), self._OPEN) < 0:
            raise OSError(ctypes.get_errno(), f"no watch of {self.path}")
        return self

    def __exit__(self, *error: object) -> None:
        with contextlib.suppress(BlockingIOError):
            self.seen = bool(os.read(self.descriptor, 4096))
        os.close(self.descriptor)


def _shortened(text: str) -> str:
    return text if len(text) < 12000 else f"{text[:6000]}\n...\n{text[-6000:]}"


class _Watch:
    """An audit hook: notes and refuses processes, sockets, and files outside of the folders allowed while an input
    runs. Copies of the process that the package makes for side work are watched in turn.
    """

    PROCESSES = (
        "os.system",
        "os.exec",
        "os.fork",
        "os.forkpty",
        "os.posix_spawn",
        "os.spawn",
        "pty.spawn",
        "subprocess.Popen",
    )
    SOCKETS = ("socket.connect", "socket.bind", "socket.sendto", "socket.getaddrinfo", "socket.gethostbyname")
    # Event: places of its paths, places of the folders' descriptors that go with them, whether something is changed.
    FILES: ClassVar[dict] = {
        "os.listdir": ((0,), (), False),
        "os.scandir": ((0,), (), False),
        "os.chdir": ((0,), (), False),
        "os.remove": ((0,), (1,), True),
        "os.rmdir": ((0,), (1,), True),
        "os.mkdir": ((0,), (2,), True),
        "os.rename": ((0, 1), (2, 3), True),
        "os.link": ((0, 1), (2, 3), True),
        "os.symlink": ((1,), (2,), True),
        "os.truncate": ((0,), (), True),
        "os.chmod": ((0,), (2,), True),
        "os.chown": ((0,), (3,), True),
        "os.utime": ((0,), (3,), True),
        "shutil.rmtree": ((0,), (1,), True),
    }

    def __init__(self, loopback: bool, kind: Path):
        import pinograsp

        self.loopback = loopback
        installed = [sysconfig.get_path(name) for name in ("stdlib", "platstdlib", "purelib", "platlib", "data")]
        self.readable = [
            os.path.realpath(path)
            for path in (
                *installed,
                *filter(None, sys.path),
                Path(pinograsp.__file__).parent,
                Path(pinograsp.__file__).parent.parent / "urdf",
                HERE,
                kind,
                "~/.cache/matplotlib",
                "~/.config/matplotlib",
                "/usr/lib",
                "/usr/share/fonts",
                "/proc",
                "/sys/devices/system/cpu",
                "/sys/fs/cgroup",
                "/dev/null",
                "/dev/urandom",
                "/etc/localtime",
                "/usr/share/zoneinfo",
            )
            for path in [os.path.expanduser(path)]
        ]
        self.seen: list[tuple[str, str]] = []
        self.writable: list[str] = []
        self.on = False
        self.busy = threading.local()

    def begin(self, folder: Path) -> None:
        self.seen = []
        own = [os.path.realpath(folder / name) for name in ("case", "temp")]
        self.writable = [*own, "/dev/null", os.path.realpath(f"/proc/{os.getpid()}")]
        self.on = True

    def end(self) -> None:
        self.on = False

    def __call__(self, event: str, args: tuple) -> None:
        if not self.on or getattr(self.busy, "now", False):
            return
        self.busy.now = True
        try:
            if event == "open":
                path, _, flags = args
                changes = bool(flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC | os.O_APPEND))
                self._file(event, path, None, changes)
            elif event in self.FILES:
                paths, descriptors, changes = self.FILES[event]
                for k, place in enumerate(paths):
                    self._file(event, args[place], args[descriptors[k]] if descriptors else None, changes)
            elif event in self.PROCESSES:
                if not (event == "os.fork" and _is_own_copy()):
                    self._refuse("process", event, args)
            elif event in self.SOCKETS and not (self.loopback and _is_local(event, args)):
                self._refuse("socket", event, args)
        finally:
            self.busy.now = False

    def _file(self, event: str, path, descriptor, changes: bool) -> None:
        if path is None or isinstance(path, int):
            return
        path = os.fsdecode(path)
        if isinstance(descriptor, int) and descriptor >= 0:
            path = os.path.join(f"/proc/self/fd/{descriptor}", path)
        if "\0" in path:
            return
        full = os.path.realpath(path)
        if _within(full, self.writable) or (_within(full, self.readable) and (not changes or "__pycache__" in full)):
            return
        self._refuse("file", event, (full, "to change it" if changes else "to read it"))

    def _refuse(self, kind: str, event: str, args: tuple) -> None:
        stack = "".join(traceback.format_stack(limit=14)[:-3])
        self.seen.append((kind, f"{event} {args!r:.300}\n{stack}"))
        raise PermissionError(f"not allowed here: {event} {args!r:.300}")


def _within(path: str, folders: list[str]) -> bool:
    return any(path == folder or path.startswith(folder.rstrip("/") + "/") for folder in folders)


def _is_own_copy() -> bool:
    """Whether the package copies its process for side work: this hook goes with it, and what it refuses there fails."""
    from pinograsp import processes

    own = processes.__file__
    return any(frame.filename == own for frame in traceback.extract_stack(limit=20))


def _is_local(event: str, args: tuple) -> bool:
    address = args[1] if event in ("socket.connect", "socket.bind", "socket.sendto") else args[0]
    host = address[0] if isinstance(address, tuple) else address
    host = os.fsdecode(host) if isinstance(host, (str, bytes)) else ""
    return host in ("localhost", "::1") or host.startswith("127.")


if __name__ == "__main__":
    # Imported again under its full name: kinds that import the harness share one.
    from fuzzing import harness

    harness._work(int(sys.argv[1]), Path(sys.argv[2]), int(sys.argv[3]))
