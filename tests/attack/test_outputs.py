"""Places where nothing can be written: refused before work starts, or in a sentence while it writes."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign import InputError
from lensdesign.cli.commands import main as lensdesign_main
from lensdesign.common.atomic_files import UNFINISHED, atomic_path, new_mark
from lensdesign.common.outputs import check_output_file, check_output_folder
from tolerancing.cli.commands import main as tolerancing_main
from wavesim.cli.commands import main as wavesim_main
from wavesim.runtime.result_files import new_results

PAPER, STUDY = str(DESIGNS / "paper_singlet.toml"), str(DESIGNS / "paper_tolerances.toml")
SPEC = str(DESIGNS / "thinnest_singlet_spec.toml")
MAINS = {"lensdesign": lensdesign_main, "wavesim": wavesim_main, "tolerancing": tolerancing_main}
FRAME = "frame_that_is_not_there.tif"

# Inputs that come later would be refused too; that the output is named shows that it was checked first.
WRITERS = [
    f"lensdesign draw {PAPER} -o OUT",
    f"lensdesign scale {PAPER} 0.1 -o OUT",
    f"lensdesign optimize {SPEC} -o OUT",
    f"lensdesign explore {SPEC} --over thickness,spread -o OUT",
    f"lensdesign export {PAPER} OUT",
    f"lensdesign scene {PAPER} -o OUT",
    f"lensdesign drawing {PAPER} -o OUT",
    f"lensdesign drawing {PAPER} -o sheet.pdf --as-drawn OUT",
    f"lensdesign drawing {PAPER} -o sheet.pdf --study-as-drawn OUT",
    f"lensdesign sag {PAPER} --surface 1 -o OUT",
    "lensdesign import lens_that_is_not_there.zmx -o OUT",
    f"lensdesign view {PAPER} -o OUT",
    f"lensdesign testplates {SPEC} --plates plates.txt -o OUT",
    f"wavesim pupil {PAPER} -o OUT",
    f"wavesim resolve-lines {PAPER} -o OUT",
    f"wavesim plan {PAPER} -o OUT",
    f"wavesim compare-engines {PAPER} -o OUT",
    f"wavesim image {PAPER} -o OUT",
    f"wavesim reconstruct {FRAME} --design {PAPER} -o OUT",
    f"wavesim calibrate {FRAME} --design {PAPER} -o OUT",
    "wavesim view result_that_is_not_there -o OUT",
    f"tolerancing start {PAPER} -o OUT",
    f"tolerancing run {STUDY} --store OUT",
    f"tolerancing variance {STUDY} -o OUT",
    "tolerancing show store.db --trial 1 -o OUT",
    "tolerancing report store.db -o OUT",
    "tolerancing export store.db OUT",
    "tolerancing budget store.db --yield 0.5 -o OUT",
]


def refused(command: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> str:
    program, *rest = command.split()
    monkeypatch.setattr("sys.argv", [program, *rest])
    with pytest.raises(SystemExit) as ended:
        MAINS[program]()
    captured = capsys.readouterr()
    assert ended.value.code == 2, captured
    assert captured.out == ""
    assert captured.err.startswith("error: cannot write ")
    assert len(captured.err.splitlines()) == 1
    return captured.err


@pytest.mark.parametrize("command", WRITERS)
def test_every_writer_checks_its_output_first(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("whole")
    assert "file is no folder" in refused(command.replace("OUT", "file/deep/out.png"), monkeypatch, capsys)
    assert "No such file" in refused(command.replace("OUT", "/proc/out.png"), monkeypatch, capsys)
    long = f"{'x' * 300}.png"
    assert "File name too long" in refused(command.replace("OUT", long), monkeypatch, capsys)

    def full(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    monkeypatch.setattr("tempfile.TemporaryFile", full)
    said = refused(command.replace("OUT", "new/out.png"), monkeypatch, capsys)
    assert said.endswith(": Read-only file system\n")
    assert sorted(os.listdir(tmp_path)) == ["file"]
    assert (tmp_path / "file").read_text() == "whole"


def test_a_file_is_no_folder_and_a_folder_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="is a folder"):
        check_output_file(tmp_path)
    (tmp_path / "file").touch()
    with pytest.raises(InputError, match="it is no folder"):
        check_output_folder(tmp_path / "file")
    with pytest.raises(InputError, match="not a regular file"):
        check_output_file("/dev/null")
    for check in (check_output_file, check_output_folder):
        with pytest.raises(InputError, match="null byte"):
            check(f"{tmp_path}/a\0b")
        check(tmp_path / "new" / "deep" / "thing")
    assert os.listdir(tmp_path) == ["file"]
    (tmp_path / "loop").symlink_to(tmp_path / "loop")
    with pytest.raises(InputError, match="refers to itself"):
        check_output_file(tmp_path / "loop")


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_leave_to_write_is_refused(tmp_path: Path) -> None:
    tmp_path.chmod(0o500)
    try:
        with pytest.raises(InputError, match="Permission denied"):
            check_output_file(tmp_path / "out.png")
    finally:
        tmp_path.chmod(0o700)


def test_a_disk_that_becomes_read_only_keeps_its_own_message(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def read_only(*_: object, **__: object) -> None:
        raise OSError(errno.EROFS, "Read-only file system")

    (tmp_path / "out.txt").write_text("before")
    with pytest.raises(InputError, match=r"out\.txt.*Read-only"), atomic_path(  # noqa: PT012
        tmp_path / "out.txt"
    ) as temporary:  # fmt: skip
        temporary.write_text("half")
        monkeypatch.setattr(Path, "unlink", read_only)
        monkeypatch.setattr(os, "replace", read_only)
        read_only()
    assert (tmp_path / "out.txt").read_text() == "before"


def test_results_are_written_all_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "b.txt").mkdir()

    def write() -> None:
        with new_results(tmp_path) as folder:
            (folder / "a.txt").write_text("new")
            (folder / "b.txt").write_text("new")

    with pytest.raises(InputError, match=r"b\.txt.*folder"):
        write()
    assert os.listdir(tmp_path) == ["b.txt"]


FAULTS: dict[str, tuple[Callable[[], OSError], int, str]] = {
    "full": (lambda: OSError(errno.ENOSPC, "No space left on device", "f.png"), 2, "f.png: No space left"),
    "read-only": (lambda: OSError(errno.EROFS, "Read-only file system", "f.png"), 2, "f.png: Read-only"),
    "input/output": (lambda: OSError(errno.EIO, "Input/output error", "f.png"), 2, "f.png: Input/output"),
    "of a library": (lambda: OSError("broken data stream"), 2, "broken data stream"),
    "quota": (lambda: OSError(errno.EDQUOT, "Disk quota exceeded", b"f.png"), 2, "f.png: Disk quota"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_no_writer_expects_still_is_one_sentence(
    name: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    fault, status, said = FAULTS[name]

    def fails(*_: object, **__: object) -> None:
        raise fault()

    monkeypatch.setattr("lensdesign.files.design.load_design", fails)
    monkeypatch.setattr("sys.argv", ["lensdesign", "check", PAPER])
    with pytest.raises(SystemExit) as ended:
        lensdesign_main()
    captured = capsys.readouterr().err
    assert ended.value.code == status
    assert said in captured
    assert len(captured.splitlines()) == 1


def test_memory_that_runs_out_is_one_sentence(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fails(*_: object, **__: object) -> None:
        raise MemoryError("Unable to allocate 12.8 TiB")

    monkeypatch.setattr("lensdesign.files.design.load_design", fails)
    monkeypatch.setattr("sys.argv", ["lensdesign", "check", PAPER])
    with pytest.raises(SystemExit) as ended:
        lensdesign_main()
    assert ended.value.code == 2
    assert "error: not enough memory: Unable to allocate 12.8 TiB" in capsys.readouterr().err


KILLED = """
import os, signal, sys
from pathlib import Path
from lensdesign.common.atomic_files import atomic_path
from wavesim.runtime.result_files import new_results
with new_results(Path(sys.argv[1])) as folder, atomic_path(Path(sys.argv[1]) / "kept.npz") as temporary:
    (folder / "a.txt").write_text("half")
    temporary.write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_run_left_goes_with_the_next_one(tmp_path: Path) -> None:
    for _ in range(2):
        subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], check=False)
    (tmp_path / ".new.0123abcd").mkdir()  # of a version that did not name its process
    own = tmp_path / f".new.{new_mark()}"
    own.mkdir()
    UNFINISHED.add(own)
    (tmp_path / ".new.notes").mkdir()
    other = tmp_path / f".new.{os.getppid()}-0123abcd"
    other.mkdir()
    assert sum(path.name.startswith(".kept.") for path in tmp_path.iterdir()) == 1
    with new_results(tmp_path) as folder, atomic_path(tmp_path / "kept.npz") as temporary:
        (folder / "a.txt").write_text("whole")
        temporary.write_text("whole")
    UNFINISHED.discard(own)
    assert {path.name for path in tmp_path.iterdir()} == {
        "a.txt", "kept.npz", ".new.notes", own.name, other.name
    }  # fmt: skip
