"""Files and folders that are written whole or not at all: by several processes at once, killed at any moment, on a full
disk.
"""

from __future__ import annotations

import errno
import fcntl
import os
import random
import subprocess
import sys
from pathlib import Path

import pytest
from killing import start_and_kill

from pinograsp.errors import InvalidInput, ResultsNotWritten
from pinograsp.writing import (
    NewFolder,
    add_files,
    folders,
    list_in,
    lock,
    mark,
    safe_name,
    write_file,
    write_folder,
)
from pinograsp.writing.files import listing_of

PARTS = ("a.txt", "b.txt", "c.txt")


def filling(text: str, size: int = 1):
    def fill(path: Path) -> None:
        for name in PARTS:
            (path / name).write_text(text * size)

    return fill


def texts(folder: Path) -> dict[str, str]:
    """What a reader finds: not what is being written, or was when its writer was killed."""
    found = {
        path.relative_to(folder).as_posix(): path
        for path in sorted(folder.rglob("*"))
        if path.is_file() and path.name != "files.txt"
    }
    return {name: path.read_text() for name, path in found.items() if ".pinograsp-" not in name}


def whole(text: str) -> dict[str, str]:
    return dict.fromkeys(PARTS, text)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


# -- what is not ours stays --------------------------------------------------------------------------------------------


def test_only_what_is_listed_is_ever_removed(tmp_path):
    run = write_folder(tmp_path / "run", filling("1"))
    check = write_folder(run / "check", filling("checked"))
    with pytest.raises(
        ResultsNotWritten, match=r"no run wrote \(check/\)"
    ):  # nobody has told that it is a part of the run
        write_folder(run, filling("2"), force=True)
    list_in(run, f"{check}/", run / "trials" / "x" / "log.jsonl")
    (run / "trials" / "x").mkdir(parents=True)
    (run / "trials" / "x" / "log.jsonl").write_text("{}\n")
    for theirs in (
        "check/measured.csv",
        "trials/x/mine.txt",
        "mine/check.json",
        "mine/files.txt",
        "trials/y/log.jsonl",
        "note",
    ):
        path = run / theirs
        path.parent.mkdir(exist_ok=True)
        path.write_text("mine")
        before = texts(run)
        with pytest.raises(ResultsNotWritten, match="no run wrote") as caught:
            write_folder(run, filling("2"), force=True)
        assert theirs in str(caught.value) or f"{path.parent.relative_to(run)}/" in str(caught.value)
        assert texts(run) == before and names(tmp_path) == ["run"]
        path.unlink()
        if path.parent != run and not any(path.parent.iterdir()):
            path.parent.rmdir()
    write_folder(run, filling("2"), force=True)
    assert texts(run) == whole("2") and names(tmp_path) == ["run"]


def test_a_copy_of_a_check_and_links_are_others(tmp_path):
    run = write_folder(tmp_path / "run", filling("1"))
    write_folder(run / "copy", filling("checked"))  # with a list, but not in the run's
    elsewhere = write_folder(tmp_path / "elsewhere", filling("data"))
    list_in(run, f"{run / 'check'}/")
    (run / "check").symlink_to(elsewhere)
    with pytest.raises(ResultsNotWritten, match=r"\(check/, copy/\)"):
        write_folder(run, filling("2"), force=True)
    assert texts(elsewhere) == whole("data")


def test_a_list_of_somebody_elses_is_not_believed(tmp_path):
    (tmp_path / "files.txt").write_text("data.csv\n")
    (tmp_path / "data.csv").write_text("1")
    with pytest.raises(ResultsNotWritten, match="no run wrote"):
        write_folder(tmp_path, filling("2"), force=True)
    assert names(tmp_path) == ["data.csv", "files.txt"]


def test_files_that_come_while_it_is_written_stay_and_the_answer_is_kept(tmp_path, monkeypatch):
    def with_others(path: Path):
        filling("new")(path)
        (tmp_path / "run").mkdir(exist_ok=True)
        (tmp_path / "run" / "data.csv").write_text("mine")

    for force in (False, True):
        with pytest.raises(ResultsNotWritten, match=r"data\.csv|already exists") as caught:
            write_folder(tmp_path / "run", with_others, force=force)
        assert "the results are in" in str(caught.value)
        assert texts(tmp_path / "run") == {"data.csv": "mine"}
        (tmp_path / "run" / "data.csv").unlink()
    assert texts(tmp_path / "run-2") == texts(tmp_path / "run-3") == whole("new") and names(tmp_path) == [
        "run",
        "run-2",
        "run-3",
    ]
    # In the very last moment, between the look at the folder and the change of places.
    run = write_folder(tmp_path / "other", filling("1"))
    plain = folders._exchange

    def late(one, other):
        if not (run / "late.csv").exists() and not (one / "late.csv").exists():
            (run / "late.csv").write_text("mine")
        plain(one, other)

    monkeypatch.setattr(folders, "_exchange", late)
    with pytest.raises(ResultsNotWritten, match=r"late\.csv.*other-2"):
        write_folder(run, filling("2"), force=True)
    assert texts(run) == whole("1") | {"late.csv": "mine"} and texts(tmp_path / "other-2") == whole("2")


def test_links_are_followed(tmp_path):
    real = write_folder(tmp_path / "disk" / "real", filling("1"))
    (tmp_path / "link").symlink_to(real)
    assert write_folder(tmp_path / "link", filling("2"), force=True) == tmp_path / "link"
    assert (tmp_path / "link").is_symlink() and texts(real) == whole("2")
    (tmp_path / "new").symlink_to(tmp_path / "disk" / "later")
    write_folder(tmp_path / "new", filling("3"))
    assert texts(tmp_path / "disk" / "later") == whole("3")
    (tmp_path / "file").symlink_to(tmp_path / "disk" / "page.html")
    write_file(tmp_path / "file", b"page")
    assert (tmp_path / "file").is_symlink() and (tmp_path / "disk" / "page.html").read_bytes() == b"page"


def test_places_that_nothing_can_take_the_place_of(tmp_path, monkeypatch):
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    for place in (".", tmp_path / "here", ".."):
        with pytest.raises(ResultsNotWritten, match="the one you are in"):
            write_folder(place, filling("1"), force=True)
    with pytest.raises(ResultsNotWritten, match="mount point"):
        write_folder("/", filling("1"), force=True)
    os.mkfifo(tmp_path / "pipe")
    with pytest.raises(ResultsNotWritten, match="expected the path of a file"):
        write_file(tmp_path / "pipe", b"1")
    for write in (lambda path: write_folder(path, filling("1")), lambda path: write_file(path, b"1")):
        with pytest.raises(InvalidInput, match="null character"):
            write(tmp_path / "a\0b")
    for name in ("a" * 300, "ü" * 200, "\ud800"):
        with pytest.raises(ResultsNotWritten, match="cannot write"):
            write_folder(tmp_path / name, filling("1"))
        with pytest.raises(ResultsNotWritten, match="cannot write"):
            write_file(tmp_path / name, b"1")
    with pytest.raises(ResultsNotWritten, match="cannot write"):
        write_folder(Path(*["a" * 200] * 30), filling("1"))
    longest = "n" * 255
    assert texts(write_folder(tmp_path / longest, filling("1"))) == whole("1")
    write_folder(tmp_path / longest, filling("2"), force=True)
    write_file(tmp_path / ("m" * 255), b"1")
    assert names(tmp_path / "here") == [] and len(names(tmp_path)) == 4


def test_names_made_of_texts_are_safe():
    for text in ("", ".", "..", "../../etc", "a/b", "a\0b", "\n", ".hidden", "ü" * 300, "\ud800", "-x", "a b"):
        name = safe_name(text)
        assert 0 < len(os.fsencode(name)) <= 100 and "/" not in name and "\0" not in name and not name.startswith(".")
    assert safe_name("torques_thumb") == "torques_thumb"


def test_modes_of_files_stay(tmp_path):
    path = tmp_path / "a"
    umask = os.umask(0o027)
    try:
        write_file(path, b"1")
        assert path.stat().st_mode & 0o777 == 0o640
        folder = write_folder(tmp_path / "run", filling("1"))
        assert folder.stat().st_mode & 0o777 == 0o750 and (folder / "files.txt").stat().st_mode & 0o777 == 0o640
    finally:
        os.umask(umask)
    path.chmod(0o600)
    write_file(path, b"2")
    assert path.stat().st_mode & 0o777 == 0o600 and path.read_bytes() == b"2"


# -- several at once ---------------------------------------------------------------------------------------------------


def test_a_name_belongs_to_one_writer_from_the_start(tmp_path):
    with NewFolder(tmp_path / "new" / "run") as first:
        with pytest.raises(ResultsNotWritten, match="another process is writing"):
            NewFolder(tmp_path / "new" / "run")
        with NewFolder.fresh("run", tmp_path / "new") as second:
            assert second.path == tmp_path / "new" / "run-2"
            second.write(filling("second"))
        first.write(filling("first"))
    assert texts(tmp_path / "new" / "run") == whole("first") and texts(tmp_path / "new" / "run-2") == whole("second")
    with NewFolder(tmp_path / "other" / "run"):
        assert (tmp_path / "other").is_dir()
    assert names(tmp_path) == ["new"]  # nothing was written


def test_a_run_is_not_replaced_under_what_is_being_written_into_it(tmp_path):
    run = write_folder(tmp_path / "run", filling("1"))
    with NewFolder(run / "check") as check:
        with pytest.raises(ResultsNotWritten, match="is writing into"):
            NewFolder(run, force=True)
        list_in(run, f"{check.place}/")
        check.write(filling("checked"))
    with NewFolder(run, force=True) as new:
        with pytest.raises(ResultsNotWritten, match="another process is writing"):
            NewFolder(run / "check-2")
        with pytest.raises(ResultsNotWritten, match="another process is writing"):
            add_files(run, filling("report"))
        new.write(filling("2"))
    assert texts(run) == whole("2")


def test_a_lock_that_somebody_keeps_is_told(tmp_path):
    with lock(mark(tmp_path / "run")):
        with pytest.raises(ResultsNotWritten, match="another process is writing"):
            write_folder(tmp_path / "run", filling("1"))
        with pytest.raises(ResultsNotWritten, match="another process keeps"), lock(mark(tmp_path / "run"), 0.05):
            pass
    assert names(tmp_path) == []


def test_without_locks_and_without_an_exchange_it_works_alone(tmp_path, monkeypatch):
    def none(*_):
        raise OSError(errno.ENOLCK, "no locks")

    monkeypatch.setattr(fcntl, "flock", none)
    monkeypatch.setattr(folders.ctypes, "CDLL", lambda *_, **__: object())
    run = write_folder(tmp_path / "run", filling("1"))
    write_folder(run, filling("2"), force=True)
    assert texts(run) == whole("2") and names(tmp_path) == ["run"]
    with pytest.raises(ResultsNotWritten, match="already exists"):
        write_folder(run, filling("3"))


def test_a_kill_between_two_renames_is_repaired(tmp_path, monkeypatch):
    monkeypatch.setattr(folders.ctypes, "CDLL", lambda *_, **__: object())
    plain = os.rename

    class Killed(BaseException):
        pass

    for steps in (1, 2):
        run, calls = write_folder(tmp_path / str(steps), filling("1")), []

        def rename(one, other, calls=calls, steps=steps):
            if len(calls) >= steps:  # and nothing after it
                raise Killed
            calls.append(one)
            plain(one, other)

        monkeypatch.setattr(os, "rename", rename)
        with pytest.raises(Killed):
            write_folder(run, filling("2"), force=True)
        monkeypatch.setattr(os, "rename", plain)
        with NewFolder(run, force=True):
            assert texts(run) == whole(str(steps))
        assert texts(run) == whole(str(steps))
    assert names(tmp_path) == ["1", "2"]


def test_what_killed_writers_leave_is_swept_and_what_live_ones_have_is_not(tmp_path):
    for name in (".pinograsp-0123456789ab-dead", ".pinograsp-file"):
        (tmp_path / name).mkdir() if "dead" in name else (tmp_path / name).write_text("half")
    (tmp_path / ".pinograsp-0123456789ab-dead" / "half.png").write_text("half")
    (tmp_path / ".pinograspish").write_text("mine")
    retired = write_folder(tmp_path / "x", filling("old"))
    (retired / "mine.csv").write_text(
        "mine"
    )  # killed while an earlier run was being removed, and somebody's file is in it
    retired.rename(tmp_path / ".pinograsp-0123456789ab-whole")
    with NewFolder(tmp_path / "live") as live:
        write_file(tmp_path / "page.html", b"page")
        assert live.staging.is_dir()
        live.write(filling("live"))
    assert names(tmp_path) == [".pinograsp-0123456789ab-whole", ".pinograspish", "live", "page.html"]
    assert names(tmp_path / ".pinograsp-0123456789ab-whole") == ["files.txt", "mine.csv"]
    write_file(tmp_path / "page.html", b"page")
    assert names(tmp_path / ".pinograsp-0123456789ab-whole") == ["files.txt", "mine.csv"]


# -- killed, for real --------------------------------------------------------------------------------------------------

WRITER = """
import sys
from pathlib import Path
from pinograsp.writing import write_folder, write_file, add_files
from pinograsp.errors import InvalidInput, ResultsNotWritten
folder, text, many = Path(sys.argv[1]), sys.argv[2], len(sys.argv) > 3
def fill(path):
    for name in ("a.txt", "b.txt", "c.txt"):
        (path / name).write_text(str(number) * 20000)
print("ready", flush=True)
number = int(text)
while True:
    try:
        write_folder(folder, fill, force=True)
        if many:
            write_file(folder.parent / "page.html", str(number).encode() * 20000)
            add_files(folder, lambda path: (path / "a.txt").write_text(str(number) * 20000))
        print("written", flush=True)
        number += 2
        number %= 10
    except ResultsNotWritten as error:
        print("refused", error, flush=True)
"""


def start(*args, code: str = WRITER, **settings) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-c", code, *map(str, args)], stdout=subprocess.PIPE, text=True, **settings
    )


def killed_often(tmp_path: Path, kills: int, seed: int, writers: int) -> None:
    """Writers that are killed at moments of a seeded schedule, counted from their first word; others go on meanwhile."""
    rng, run = random.Random(seed), tmp_path / "run"
    write_folder(run, filling("0", 20000))
    for _ in range(kills):
        start_and_kill(
            [[WRITER, run, number, *["many"] * (writers == 1)] for number in range(writers)], rng.uniform(0, 0.05)
        )
        found = texts(run)
        assert set(found) == set(PARTS) and {len(text) for text in found.values()} == {20000}
        if writers > 1:
            assert len(set(found.values())) == 1  # of one writer and one moment
    write_folder(run, filling("9", 20000), force=True)
    left = names(tmp_path)
    if "page.html" in left:
        page = (tmp_path / "page.html").read_bytes()
        assert len(page) == 20000 and len(set(page)) == 1
    assert [name for name in left if name != "page.html"] == ["run"] and texts(run) == whole("9" * 20000)


@pytest.mark.slow
@pytest.mark.parametrize("writers", [1, 2])
def test_killed_at_any_moment_an_old_or_a_new_folder_is_there(tmp_path, writers):
    killed_often(tmp_path, 4, 10 + writers, writers)


@pytest.mark.slow
@pytest.mark.parametrize("writers", [1, 2, 4])
def test_killed_hundreds_of_times(tmp_path, writers, often):
    killed_often(tmp_path, often(200), writers, writers)


RACER = """
import sys, time
from pathlib import Path
from pinograsp.writing import NewFolder
from pinograsp.errors import InvalidInput, ResultsNotWritten
folder, number, fresh = Path(sys.argv[1]), sys.argv[2], sys.argv[3] == "fresh"
print("ready", flush=True)
sys.stdin.read(1)
try:
    with NewFolder.fresh(folder.name, folder.parent) if fresh else NewFolder(folder) as new:
        time.sleep(0.1)
        print(new.write(lambda path: (path / "a.txt").write_text(number)), flush=True)
except ResultsNotWritten as error:
    print("refused:", error, flush=True)
"""


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["same", "fresh"])
def test_of_many_at_once_none_loses_its_answer_silently(tmp_path, kind):
    place = tmp_path / "new" / "run"
    racers = [start(place, number, kind, code=RACER, stdin=subprocess.PIPE) for number in range(4)]
    for racer in racers:
        assert racer.stdout.readline() == "ready\n"
    for racer in racers:
        racer.stdin.write("x")
        racer.stdin.flush()
    told = [racer.communicate(timeout=60)[0].strip() for racer in racers]
    kept = {number: line for number, line in enumerate(told) if not line.startswith("refused: ")}
    assert all((Path(line) / "a.txt").read_text() == str(number) for number, line in kept.items()), told
    assert len(set(kept.values())) == len(kept) == (1 if kind == "same" else 4), told
    assert names(tmp_path / "new") == sorted(Path(line).name for line in kept.values())


# -- a full disk -------------------------------------------------------------------------------------------------------


def test_on_a_full_disk_the_earlier_folder_stays(small_disk):
    small_disk = small_disk(256)
    run = write_folder(small_disk / "run", filling("1", 1000))
    page = write_file(small_disk / "page.html", b"1" * 1000)
    for write in (
        lambda: write_folder(run, filling("2", 100_000), force=True),
        lambda: write_folder(small_disk / "deep" / "new", filling("2", 100_000)),
        lambda: write_file(page, b"2" * 300_000),
        lambda: add_files(run, filling("2", 100_000)),
    ):
        with pytest.raises(ResultsNotWritten, match="No space left"):
            write()
        assert texts(run) == whole("1" * 1000) and page.read_bytes() == b"1" * 1000
        assert names(small_disk) == ["page.html", "run"] and names(run) == [*PARTS, "files.txt"]
    write_folder(run, filling("3", 1000), force=True)
    assert texts(run) == whole("3" * 1000)


LIMITED = """
import resource, sys
from pathlib import Path
from pinograsp.writing import write_folder, write_file, add_files
from pinograsp.errors import InvalidInput, ResultsNotWritten
resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))
run = Path(sys.argv[1])
fill = lambda path: (path / "a.txt").write_text("2" * 5000)
for write in (lambda: write_folder(run, fill, force=True), lambda: write_file(run / "a.txt", b"2" * 5000), lambda: add_files(run, fill)):
    try:
        write()
    except ResultsNotWritten as error:
        print("told", error)
"""


def test_where_a_file_grows_too_large_the_earlier_folder_stays(tmp_path):
    run = write_folder(tmp_path / "run", filling("1"))
    done = subprocess.run([sys.executable, "-c", LIMITED, str(run)], capture_output=True, text=True, timeout=60)
    assert done.stdout.count("told cannot write") == 3, done.stderr
    assert texts(run) == whole("1") and names(tmp_path) == ["run"] and names(run) == [*PARTS, "files.txt"]


def test_files_that_are_added_are_listed(tmp_path):
    run = write_folder(tmp_path / "run", filling("1"))
    add_files(run, lambda path: (path / "report.md").write_text("r"))
    assert listing_of(run) == {*PARTS, "report.md"}
    write_file(run / "view.html", b"v")
    list_in(run, run / "view.html", tmp_path / "elsewhere.html")
    assert listing_of(run) == {*PARTS, "report.md", "view.html"}
    list_in(tmp_path, run / "view.html")  # no list there, and none is begun
    assert not (tmp_path / "files.txt").exists()
    write_folder(run, filling("2"), force=True)
    assert texts(run) == whole("2")
    assert (run / "files.txt").read_text().splitlines()[1:] == list(PARTS)
