"""What all commands share: interrupts, termination, and standard output that cannot be written."""

from __future__ import annotations

import io
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from places import DESIGNS
from rich.table import Table
from stopping import heeding

from lensdesign import load_design, load_specification
from lensdesign.common.console import print_whole, say
from lensdesign.optimization import check_against

LENSDESIGN = Path(sys.executable).parent / "lensdesign"


def test_a_search_that_is_ended_leaves_what_was_there_or_its_best_lens(tmp_path: Path) -> None:
    """Which of both depends on how far the search has come, and that on the machine.

    `optimization/asked/test_ending.py` has each at a known step.
    """
    specification = tmp_path / "spec.toml"
    text = (DESIGNS / "thinnest_singlet_spec.toml").read_text()
    # A search that does not end by itself within the time of the test, however fast the machine.
    limits = "starts = 10000\nagreeing = 10000\nmax_evaluations = 1000000000\nmax_seconds = 100.0\n"
    slow = f'algorithm = "isres"\n{limits}\n[constraints]'
    specification.write_text(text.replace("[constraints]", slow))
    (tmp_path / "out.toml").write_text("mine")
    search = subprocess.Popen(
        [LENSDESIGN, "optimize", "spec.toml", "-o", "out.toml"],
        cwd=tmp_path,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heeding,
    )
    until = time.monotonic() + 600.0
    while not list(tmp_path.glob(".out.*")) and time.monotonic() < until:
        time.sleep(0.05)
    search.send_signal(signal.SIGINT)
    out, err = search.communicate(timeout=600)
    assert search.returncode == 130, err
    assert "Traceback" not in err
    assert sorted(p.name for p in tmp_path.iterdir()) == ["out.toml", "spec.toml"]
    last = err.splitlines()[-1]
    if (tmp_path / "out.toml").read_text() == "mine":
        assert out == ""
        # The last one is for an interrupt that a compiler has swallowed for the whole period of grace.
        assert last in (
            "interrupted",
            "interrupted before a first lens was found",
            "interrupted; ended without an orderly stop",
        )
    else:
        feasible = check_against(
            load_design(tmp_path / "out.toml"), load_specification(specification)
        ).feasible
        met = "meets" if feasible else "does not meet"
        assert last == f"interrupted; out.toml holds the best lens so far, which {met} the specification"
        assert "an interrupt ended the search of N-BK7" in out
        assert out.endswith("wrote out.toml\n")


@pytest.mark.parametrize("arguments", [["glass", "N-", "--search"], ["glass", "N-BK7", "--json"], ["--help"]])
def test_a_reader_that_goes_away_is_no_error(arguments: list[str]) -> None:
    command = subprocess.Popen([LENSDESIGN, *arguments], stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert command.stdout is not None
    command.stdout.close()
    assert command.communicate(timeout=600)[1] == b""


@pytest.mark.skipif(not Path("/dev/full").is_char_device(), reason="needs /dev/full")
@pytest.mark.parametrize("arguments", [["glass", "N-BK7"], ["check", str(DESIGNS / "paper_singlet.toml")]])
def test_full_standard_output_is_one_message(arguments: list[str]) -> None:
    with open("/dev/full", "w") as full:
        done = subprocess.run([LENSDESIGN, *arguments], stdout=full, stderr=subprocess.PIPE, timeout=600)
    assert done.returncode == 2
    assert done.stderr == b"error: cannot write to standard output: No space left on device\n"


def test_a_command_does_not_look_for_garbage_once_more_at_its_end() -> None:
    code = (
        "import atexit, gc, typer\n"
        "from lensdesign.common.console import run_app\n"
        "atexit.register(lambda: print(gc.get_freeze_count() > 0))  # the first to register is the last\n"
        "app = typer.Typer()\n"
        "app.command()(lambda: None)\n"
        "run_app(app)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "True\n"


NAMES = ("surface_1_figure_3_um", "light_amplitude_10 [waves]", ":car:", "x" * 150)


@pytest.mark.parametrize("is_terminal", [False, True])
@pytest.mark.parametrize("columns", [None, "20", "80"])
def test_a_table_loses_no_character(
    monkeypatch: pytest.MonkeyPatch, is_terminal: bool, columns: str | None
) -> None:
    written = io.StringIO()
    monkeypatch.setattr(written, "isatty", lambda: is_terminal, raising=False)
    monkeypatch.setattr("sys.stdout", written)
    monkeypatch.delenv("COLUMNS", raising=False)
    if columns is not None:
        monkeypatch.setenv("COLUMNS", columns)
    table = Table("parameter", "found", "standard deviation", title="[bold] title", box=None)
    for column in table.columns[1:]:
        column.no_wrap = True
    for name in NAMES:
        table.add_row(name, "123456.78901", f"0.12, goes with {', '.join(NAMES)}")
    print_whole(table)
    text = written.getvalue()
    assert "…" not in text
    assert text.count("123456.78901") == len(NAMES)
    assert sum(letter == "x" for letter in text) >= 5 * 150
    if not is_terminal and columns is None:
        assert "[bold] title" in text
        for name in NAMES:
            row = next(line for line in text.splitlines() if line.strip().startswith(name))
            assert row.rstrip().endswith(", ".join(NAMES))


@pytest.mark.parametrize(
    ("no_color", "is_terminal", "coloured"), [("", True, True), ("1", True, False), ("", False, False)]
)
def test_lines_begin_in_colour_on_a_terminal_only(
    no_color: str, is_terminal: bool, coloured: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return is_terminal

    shown = Terminal()
    monkeypatch.setenv("NO_COLOR", no_color)
    monkeypatch.setattr("sys.stderr", shown)
    say("error:", "no light", to_errors=True)
    text = shown.getvalue()
    assert text.endswith(" no light\n")
    assert ("\x1b[31m" in text) is coloured
    assert (text == "error: no light\n") is not coloured


@pytest.mark.parametrize("encoding", ["ascii", "cp1252", "utf-8"])
def test_characters_that_the_output_lacks_are_spelled_out(encoding: str) -> None:
    done = subprocess.run(
        [LENSDESIGN, "check", DESIGNS / "paper_singlet.toml"],
        capture_output=True,
        env=os.environ | {"PYTHONIOENCODING": encoding},
        timeout=600,
    )
    assert done.returncode == 1, done.stderr
    shown = done.stdout.decode("utf-8" if encoding == "ascii" else encoding)
    assert f"{'<=' if encoding == 'cp1252' else '≤'} 4.7682°" in shown
    assert "?" not in shown


def test_a_message_has_an_end(capsys: pytest.CaptureFixture[str]) -> None:
    """However many lines an exception has, and however long they are."""
    from lensdesign.common.console import MOST_CHARACTERS, fail

    for message in ("x" * 100_000, "\n".join(["y" * 1000] * 500), "\n".join("z" * 10_000)):
        with pytest.raises(SystemExit) as stop:
            fail(message)
        assert stop.value.code == 2
        shown = capsys.readouterr().err
        assert 100 < len(shown) <= MOST_CHARACTERS + 200
        assert len(shown.splitlines()) <= 62


def test_more_new_folders_in_each_other_than_python_can_make_are_refused(tmp_path: Path) -> None:
    from lensdesign import InputError
    from lensdesign.common.outputs import check_output_file, check_output_folder

    deep = tmp_path.joinpath(*["a"] * 1500)
    for check in (check_output_file, check_output_folder):
        with pytest.raises(InputError, match="100 folders"):
            check(deep)
        check(tmp_path.joinpath(*["a"] * 50))


def test_a_name_that_is_not_utf_8_is_one_message_before_the_work(tmp_path: Path) -> None:
    """Of a command whose results state their settings, and of one that writes the name into a study."""
    odd = tmp_path / os.fsdecode(b"caf\xe9.toml")
    odd.write_bytes((DESIGNS / "feasible_singlet.toml").read_bytes())
    for words in (
        ["lensdesign", "draw", odd, "-o", tmp_path / "pictures"],
        ["tolerancing", "start", odd, "-o", tmp_path / "study.toml"],
    ):
        command = [sys.executable, "-m", f"{words[0]}.cli", *words[1:]]
        done = subprocess.run(command, capture_output=True, text=True)
        assert (done.returncode, len(done.stderr.splitlines())) == (2, 1), done.stderr
        assert "caf\\xe9.toml: its name is not UTF-8" in done.stderr
    assert list(tmp_path.iterdir()) == [odd]
