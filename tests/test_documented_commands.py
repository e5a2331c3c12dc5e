"""Every command that a page shows is run exactly as it is written, in the page's order, beside the designs.

Commands run in this process, through the entry points of the console scripts: starting a hundred interpreters
would take longer than what they do. `make commands` (DOCUMENTED_COMMANDS=all) also runs those that take about
half a minute or more (LONG), and those that read their results; otherwise only their arguments are checked. A
command that pages share is run once for the same files (Runner). What a page shows of a command's output, the
command must print. Where no page shows it, verdicts are found without trials of causes and without the score
test; `make commands` runs both everywhere.
"""

from __future__ import annotations

import lzma
import os
import re
import shlex
import shutil
from hashlib import sha256
from importlib import import_module
from itertools import pairwise
from pathlib import Path
from typing import NamedTuple

import pytest
from places import DESIGNS, GOLDEN, ROOT
from quick_verdicts import judge_quickly
from small_pictures import draw_few_dots
from typer.main import get_command

from benchmarks.long_commands import COMMANDS

ALL = os.environ.get("DOCUMENTED_COMMANDS") == "all"
"""Whether commands that take long run, too, as `make commands` asks."""

PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
COMMAND = re.compile(r"^(?:lensdesign|wavesim|tolerancing) [a-z][a-z-]* .+")
INLINE = re.compile(r"`((?:lensdesign|wavesim|tolerancing) [a-z][a-z-]* [^`]+)`")
NAMED = re.compile(r"# (\w+\.toml)\n")
FENCE = re.compile(r"^```(\w*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)

# What a page writes in place of a name, and the name with which it is run. The order matters.
PLACEHOLDERS = {
    r"\bDESIGN\b": "designs/paper_singlet.toml",
    r"\bDIR\b": "folder",
    r"\bTWIN\b": "twin.toml",
    r"\bFILE(\.\w+)": r"file\1",
    r"\bFILE\b": "file.stl",
}
# Commands that take about half a minute or more: only `make commands` runs them, and what reads their
# results.
LONG = (
    r"--engine hierarchical",  # the whole field of the full-size lens
    r"^wavesim compare-engines ",  # every setting of every engine on a chart
    r"^wavesim plan designs/paper_singlet",  # plans for small twins run
    r"^wavesim (check-engine --engine wpm --solution stigmatic|resolve-lines .*--engine wpm)",
    r"^wavesim resolve-lines .* --field-heights-mm 0,1\.4 .*slices=200",
    r"^wavesim image designs/phone_lens\.toml",  # at three wavelengths
    r"^tolerancing budget ",  # verified by trials
    r"^tolerancing run designs/paper_(figure_7|reconstruction_study)\.toml",
    r"^lensdesign (explore|limits) designs/as_built_",
)
# Commands that end with status 1, as their pages say: the paper's lens exceeds its spread limit.
NOT_MET = re.compile(r"lensdesign check (designs/(paper|measured)_singlet|coated|rough)\.toml$")
# Searches for the designs as they are kept: tests/test_gallery.py runs them, and holds what they find.
OF_THE_GALLERY = re.compile(r"lensdesign optimize designs/(\w+)_spec\.toml -o designs/\1\.toml$")


class Step(NamedTuple):
    """One thing that a reader of a page does."""

    kind: str  # "run" a command, "save" a TOML block of a named file, "see" what a command said
    text: str
    block: int = 0  # of its page; text between fences is one, too


def steps(page: Path) -> list[Step]:
    """What stands on a page in blocks, in its order."""
    text = page.read_text(encoding="utf-8")
    found: list[Step] = []
    at = 0
    for number, fence in enumerate(FENCE.finditer(text)):
        found += _commands(text[at : fence.start()], 2 * number)
        if fence[1] in ("sh", "console"):
            found += _commands(fence[2], 2 * number + 1)
        elif fence[1] == "toml" and (NAMED.match(fence[2]) or "\ndesign = " in fence[2]):
            found.append(Step("save", fence[2]))
        elif fence[1] == "text":
            found.append(Step("see", fence[2]))
        at = fence.end()
    return found + _commands(text[at:], -1)


def _commands(text: str, block: int) -> list[Step]:
    lines = [re.split(r"\s#", line)[0].strip() for line in text.splitlines()]
    return [Step("run", line, block) for line in lines if COMMAND.match(line)]


def shown(page: list[Step]) -> set[int]:
    """Blocks of commands after which the page shows what they print."""
    blocks: set[int] = set()
    last: int | None = None
    for step in page:
        if step.kind == "run":
            last = step.block
        elif step.kind == "see" and last is not None:
            blocks.add(last)
    return blocks


def commands_in_text() -> list[str]:
    """Commands in running text and tables, each once, and none that a block has but for its output's name."""
    blocks = {without_output(as_run(step.text)) for page in PAGES for step in steps(page)}
    named = {" ".join(c.split()) for page in PAGES for c in INLINE.findall(page.read_text(encoding="utf-8"))}
    whole = {without_output(as_run(c)): as_run(c) for c in named if "..." not in c and "--help" not in c}
    return sorted(command for bare, command in whole.items() if bare not in blocks)


def without_output(command: str) -> str:
    """The command without the name of what it writes."""
    return re.sub(r" -o \S+", "", command)


def as_run(command: str) -> str:
    """The command with names in place of placeholders."""
    for pattern, text in PLACEHOLDERS.items():
        command = re.sub(pattern, text, command)
    return command


def cannot_end(command: str) -> bool:
    """Whether a command serves until it is stopped, or needs a cluster; its arguments alone are checked.

    The workbench has tests in a browser.
    """
    return command.startswith("lensdesign studio ") or "--cluster" in command


def is_left_out(command: str, missing: set[str]) -> bool:
    """Whether a command is not run: it takes long, or needs one of the missing files.

    What it would have written is then missing, too.
    """
    words = shlex.split(command)
    left_out = not ALL and any(re.search(pattern, command) for pattern in LONG)
    left_out |= bool(missing & {word.partition("/")[0] for word in words})
    if left_out:
        missing |= {path for option, path in pairwise(words) if option in ("-o", "--store")}
    return left_out


class Done(NamedTuple):
    """What a command did."""

    status: int
    out: str
    err: str
    written: dict[Path, bytes]  # by the place in the working folder


class Runner:
    """Runs commands as their console scripts do, each once for the same files."""

    def __init__(self) -> None:
        self.before: dict[tuple[str, str, bool], Done] = {}

    def run(self, command: str, capfd: pytest.CaptureFixture[str], *, is_shown: bool = False) -> Done:
        """Run a command in the working folder, or write there what it wrote when it was run."""
        key = command, self._digest(command), is_shown
        if key not in self.before:
            there = self._files()
            with pytest.MonkeyPatch.context() as monkeypatch:
                if not is_shown and not ALL:
                    judge_quickly(monkeypatch)
                status = self._status(shlex.split(command), monkeypatch)
            changed = [path for path, state in self._files().items() if there.get(path) != state]
            said = capfd.readouterr()
            self.before[key] = Done(status, said.out, said.err, {path: path.read_bytes() for path in changed})
            return self.before[key]
        done = self.before[key]
        for path, content in done.written.items():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return done

    def _status(self, words: list[str], monkeypatch: pytest.MonkeyPatch) -> int:
        monkeypatch.setattr("sys.argv", words)
        try:
            import_module(f"{words[0]}.cli").main()
        except SystemExit as end:
            return int(end.code or 0)
        return 0

    def _files(self) -> dict[Path, tuple[int, int]]:
        found = [path for path in Path().rglob("*") if path.is_file()]
        return {path: (path.stat().st_mtime_ns, path.stat().st_size) for path in found}

    def _digest(self, command: str) -> str:
        """Of the designs, and of what else the command reads and what lies beside it."""
        words = shlex.split(without_output(command))
        tops = {word.partition("/")[0] for word in words} | {"designs"}
        paths = [path for path in sorted(self._files()) if path.parts[0] in tops]
        return sha256(b"".join(str(p).encode() + sha256(p.read_bytes()).digest() for p in paths)).hexdigest()


@pytest.fixture(scope="module")
def runner() -> Runner:
    """What remembers the commands of all pages."""
    return Runner()


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with the designs, an interferogram and planes through focus. Pictures are small."""
    (tmp_path / "front.dat").write_bytes(lzma.decompress((GOLDEN / "interferogram/flat.dat.xz").read_bytes()))
    shutil.copytree(DESIGNS, tmp_path / "designs")
    shutil.copytree(GOLDEN / "through_focus", tmp_path / "through_focus")
    if not ALL:
        draw_few_dots(monkeypatch)
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    return tmp_path


@pytest.mark.parametrize("page", [p for p in PAGES if steps(p)], ids=lambda p: p.name)
def test_commands_of_the_page_run(
    page: Path,
    folder: Path,
    runner: Runner,
    capfd: pytest.CaptureFixture[str],
) -> None:
    printed, all_ran, missing = "", True, set[str]()
    shown_blocks = shown(steps(page))
    for step in steps(page):
        if step.kind == "save":
            named = NAMED.match(step.text)
            (folder / (named[1] if named else "study.toml")).write_text(step.text, encoding="utf-8")
        elif step.kind == "see":
            line = unsaid(step.text, printed) if printed and all_ran else None
            assert line is None, f"{page.name} shows, and no command before it printed: {line}"
            printed, all_ran = "", True
        else:
            command = as_run(step.text)
            if OF_THE_GALLERY.match(command) or cannot_end(command):
                continue
            if is_left_out(command, missing):
                all_ran = False
                continue
            done = runner.run(command, capfd, is_shown=step.block in shown_blocks)
            assert done.status == bool(NOT_MET.match(command)), f"{command}\n{done.err}"
            printed += done.out


def test_commands_in_the_text_run(folder: Path, runner: Runner, capfd: pytest.CaptureFixture[str]) -> None:
    found = commands_in_text()
    assert len(found) > 5
    for command in (one for one in found if not cannot_end(one) and not is_left_out(one, set())):
        done = runner.run(command, capfd)
        assert done.status == bool(NOT_MET.match(command)), f"{command}\n{done.err}"


def test_the_arguments_of_all_commands_are_valid() -> None:
    """Each command of a page exists and takes its options, whether it is run or not."""
    blocks = {as_run(step.text) for page in PAGES for step in steps(page) if step.kind == "run"}
    assert len(blocks) > 150
    # Settings are read with the arguments, from a file that a command before has written.
    for command in sorted(one for one in blocks if "--settings" not in one):
        assert_there_is(shlex.split(command))


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_whose_time_is_measured_exist(name: str) -> None:
    assert_there_is(shlex.split(COMMANDS[name].text))


ROWS = re.findall(
    r"^\| (?!-|what)([^|]+) \|[^|]+\| ([^|]+) \|$",
    (ROOT / "docs/measured.md").read_text(encoding="utf-8"),
    re.MULTILINE,
)
FIGURES = dict(ROWS)


@pytest.mark.parametrize("figure", FIGURES)
def test_everything_measured_has_a_command(figure: str) -> None:
    cell_text = FIGURES[figure]
    if cell_text == "same":
        cell_text = [cell for _, cell in ROWS[: list(FIGURES).index(figure)] if cell != "same"][-1]
    link = re.fullmatch(r"\[\w+ commands?\]\(([\w-]+\.md)#([\w-]+)\)", cell_text)
    if link:
        page = (ROOT / "docs" / link[1]).read_text(encoding="utf-8")
        sections = {
            text.partition("\n")[0].strip().lower().replace(" ", "-"): text
            for text in re.split(r"^#+ ", page, flags=re.MULTILINE)[1:]
        }
        commands = [line for line in sections[link[2]].splitlines() if COMMAND.match(line)]
    else:
        assert re.fullmatch(r"`[^`]+`", cell_text), cell_text
        commands = [cell_text.strip("`")]
    assert commands
    for command in commands:
        assert_there_is(shlex.split(command))


def assert_there_is(words: list[str]) -> None:
    """That a command exists, and takes its options; nothing is run."""
    if words[:2] == ["python", "-m"]:
        module = ROOT / words[2].replace(".", "/")
        assert module.with_suffix(".py").is_file() or (module / "__main__.py").is_file()
    elif words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    else:
        group = get_command(import_module(f"{words[0]}.cli.commands").app)
        group.commands[words[1]].make_context(words[1], words[2:])


def unsaid(shown: str, printed: str) -> str | None:
    """The first line that a page shows and the commands did not print; "..." stands for what is not shown.

    Numbers may differ by half a per cent, or by one in their last digit, as processors round differently.
    """
    lines = [_words(line) for line in printed.splitlines()]
    for line in shown.splitlines():
        words = _words(line.removesuffix("..."))
        if words and not any(_same(words, other) for other in lines):
            return line
    return None


def _words(line: str) -> list[str]:
    return re.sub(r"[│┃]", " ", line).split()


def _same(shown: list[str], printed: list[str]) -> bool:
    return len(shown) <= len(printed) and all(map(_alike, shown, printed))


def _alike(shown: str, printed: str) -> bool:
    number = shown.strip("(),;%")
    try:
        values = float(number), float(printed.strip("(),;%"))
    except ValueError:
        return shown == printed
    digits = len(re.sub(r"e.*", "", number).partition(".")[2])
    return values[0] == pytest.approx(values[1], rel=0.005, abs=1.01 * 10.0**-digits)
