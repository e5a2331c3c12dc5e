"""Every command that a page shows is run, in the page's order, in a folder that has the designs.

Commands run in this process, through the entry points of the console scripts: starting a hundred interpreters
would take longer than what they do. `make commands` runs every command exactly as it is written, which takes
hours (DOCUMENTED_COMMANDS=as-written). Without it, the arguments of every command are checked as written, and
what takes minutes has a smaller stand-in (SHORTER, copy_designs), which makes the files that later commands
of the page need. A command that pages share is run once for the same files (Runner). Where a page shows what
a command prints, and the command runs as it stands there, it must print that.
"""

from __future__ import annotations

import lzma
import os
import re
import shlex
import shutil
from hashlib import sha256
from importlib import import_module
from pathlib import Path
from typing import NamedTuple

import pytest
from places import DESIGNS, GOLDEN, ROOT
from quick_verdicts import judge_quickly
from short_studies import copy_designs
from small_pictures import draw_few_dots
from typer.main import get_command

from wavesim.metrics import comparison

AS_WRITTEN = os.environ.get("DOCUMENTED_COMMANDS") == "as-written"
"""Whether every command runs in full, as `make commands` asks."""

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
# What is run in place of a case that takes minutes, or tens of seconds.
SHORTER = {
    # A whole field of the one-eighth twin (minutes): a smaller twin, few iterations, few mountings tried.
    r"0\.(125|03125) -o twin\.toml": "0.02 -o twin.toml",
    r"--patch-mm 0\.(38|09|4|06)\b": "--patch-mm 0.024",
    r"--object usaf": "--object star",
    r" --usaf bright": "",
    # A scale of distances is sought by hundreds of iterations.
    r" --free-space --calibrate": " --free-space",
    r"^(wavesim reconstruct .*)": r"\1 --iterations 2",
    r"^(wavesim colours .*)": r"\1 --iterations 2",
    r"^(wavesim colours .*--film-index .*)": r"\1 --repeats 2",
    r"^(wavesim calibrate .*)": r"\1 --iterations 1 --max-mountings 1",
    r"^(wavesim calibrate (?!.*--parameters).*)": r"\1 --parameters rigid",
    r"^(wavesim plan .*)": r"\1 --max-planes 1 --exposures 1",
    # Engines weighed for a small error take longer than those few iterations.
    r"^(wavesim (?:image|reconstruct|calibrate) (?!.*--(?:error|engine|free-space)).*)": r"\1 --error 0.3",
    # The whole field of the full-size lens (half an hour): of a tiny twin.
    r"designs/paper_singlet.toml( .*)?(?= --engine hierarchical)": r"designs/tiny_twin.toml\1",
    # A bench on which all is wrong: its frames, not the engine that makes them.
    r"--engine hierarchical (.*) -o region$": r"--engine eikonal --error 0.3 \1 -o region",
    # Of a study with four perturbations most of a sheet is derived, and its yield drops.
    r"^(lensdesign drawing .*--tolerances .*)": r"\1 --accept-yield-loss",
    # Nobody runs a cluster here: the whole field of another page in its place.
    r" --engine hierarchical --cluster \S+": " --exposures 1,30,1000 --engine hierarchical",
    # Its fine lines need samples and exposures that the twin has no room for.
    r" --(chart-at-mm|object-pitch-um) \S+": "",
    # Charts of the whole lens (minutes): what a small twin's cheapest runs say, without maps.
    r"^wavesim compare-engines \S+ (-o \S+).*": r"wavesim compare-engines designs/small_twin.toml \1 "
    "--scale 1 --patch-mm 0.004 --max-seconds 0.003 --radius-mm 0.02 --no-planes --no-maps",
    # Hundreds of slices of the whole aperture (10 s): tens.
    r"slices(=| )(200|800)": r"slices\g<1>20",
    r"slices=(20|30)": "slices=5",
    r"^(wavesim resolve-lines designs/(?!paper).*--linewidths-um [\d.]+)\S+ --slices 30": r"\1 --slices 5",
    r"(?= -o resolved\.png)": " --linewidths-um 1.55 --field-heights-mm 0",
    # wpm over the whole aperture (20 s): over a small one.
    r"^wavesim resolve-lines \S+ (.*--engine wpm)": r"wavesim resolve-lines designs/small_twin.toml \1",
    r"^(wavesim check-engine .*--solution stigmatic)": r"\1 --semi-diameter-mm 0.5",
    # Studies of the designs (10 to 60 s): the fewest trials that can show a yield; copy_designs does more.
    r"^(tolerancing run designs/.*?)(?: --trials \d+)?$": r"\1 --workers 1 --trials 16",
    r"(figure_7.*) --trials 16": r"\1 --trials 2",
    r"--trial 137": "--trial 7",
    r"^(tolerancing budget .*)": r"\1 --verify 40",
    # Eight glasses, and two elements (minutes): what the page explores before.
    r"^lensdesign explore designs/as_built_(?:track|pair)_spec.*": "lensdesign explore "
    "designs/as_built_spec.toml --over thickness,as_built_rms -o front",
    r"^(lensdesign explore .*)": r"\1 --lenses 2",
    # Limits from many starts: those that are found by then.
    r"^(lensdesign limits .*)": r"\1 --max-seconds 2",
    # Frames at three wavelengths, half a minute each.
    r"^wavesim image designs/phone_lens.toml (.*)--patch-mm 0.05": r"wavesim image designs/tiny_twin.toml \1"
    "--patch-mm 0.024",
    r"^(tolerancing variance .*--base) 32": r"\1 16",
    r"^(tolerancing rare-failures .*--trials) 300": r"\1 50",
}
# Pages whose commands all run as they are written, within seconds.
QUICK_PAGES = ("coatings.md", "roughness.md")
# Statuses beside 0 that are right: a constraint that is not met, which the pages say; frames that two
# iterations do not explain; a yield that so few trials do not verify.
ALLOWED = {
    "lensdesign check": (0, 1),
    "lensdesign verify": (0, 1),
    "lensdesign optimize": (0, 1),
    "lensdesign explore": (0, 1),
    "lensdesign limits": (0, 1),
    "tolerancing budget": (0, 1),
    "wavesim reconstruct": (0, 1),
    "wavesim colours": (0, 1),
    "wavesim calibrate": (0, 1),
}
# Searches for the designs as they are kept: tests/test_gallery.py runs them, and holds what they find.
OF_THE_GALLERY = re.compile(r"lensdesign optimize designs/(\w+)_spec\.toml -o designs/\1\.toml$")


class Step(NamedTuple):
    """One thing that a reader of a page does."""

    kind: str  # "run" a command, "save" a TOML block of a named file, "see" what a command said
    text: str


def steps(page: Path) -> list[Step]:
    """What stands on a page in blocks, in its order."""
    text = page.read_text(encoding="utf-8")
    found: list[Step] = []
    at = 0
    for fence in FENCE.finditer(text):
        found += _commands(text[at : fence.start()])
        if fence[1] in ("sh", "console"):
            found += _commands(fence[2])
        elif fence[1] == "toml" and (NAMED.match(fence[2]) or "\ndesign = " in fence[2]):
            found.append(Step("save", fence[2]))
        elif fence[1] == "text":
            found.append(Step("see", fence[2]))
        at = fence.end()
    return found + _commands(text[at:])


def _commands(text: str) -> list[Step]:
    lines = [re.split(r"\s#", line)[0].strip() for line in text.splitlines()]
    return [Step("run", line) for line in lines if COMMAND.match(line)]


def commands_in_text() -> list[str]:
    """Commands in running text and tables, each once, and none that a block has but for its output's name."""
    blocks = {without_output(as_run(step.text)) for page in PAGES for step in steps(page)}
    named = {c for page in PAGES for c in INLINE.findall(page.read_text(encoding="utf-8"))}
    whole = {without_output(as_run(c)): as_run(c) for c in named if "..." not in c and "--help" not in c}
    return sorted(command for bare, command in whole.items() if bare not in blocks)


def without_output(command: str) -> str:
    """The command without the name of what it writes."""
    return re.sub(r" -o \S+", "", command)


def as_run(command: str, page: str = "") -> str:
    """The command with names in place of placeholders, and of a size that a test can do."""
    command = as_written(command)
    for pattern, text in SHORTER.items() if not AS_WRITTEN and page not in QUICK_PAGES else ():
        command = re.sub(pattern, text, command)
    return command


def as_written(command: str) -> str:
    """The command with names in place of placeholders, and nothing else."""
    for pattern, text in PLACEHOLDERS.items():
        command = re.sub(pattern, text, command)
    return command


def cannot_end(command: str) -> bool:
    """Whether a command serves until it is stopped, or needs a cluster; its arguments alone are checked.

    The workbench has tests in a browser.
    """
    return command.startswith("lensdesign studio ") or "--cluster" in command


class Done(NamedTuple):
    """What a command did."""

    status: int
    out: str
    err: str
    written: dict[Path, bytes]  # by the place in the working folder


class Runner:
    """Runs commands as their console scripts do, each once for the same files."""

    def __init__(self) -> None:
        self.before: dict[tuple[str, str], Done] = {}

    def run(self, command: str, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]) -> Done:
        """Run a command in the working folder, or write there what it wrote when it was run."""
        key = command, self._digest(command)
        if key not in self.before:
            there = self._files()
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
    """A working folder with the designs, and an interferogram.

    Unless all commands run in full, comparisons take every second setting of engines, and reconstructions
    judge quickly.
    """
    (tmp_path / "front.dat").write_bytes(lzma.decompress((GOLDEN / "interferogram/flat.dat.xz").read_bytes()))
    if AS_WRITTEN:
        shutil.copytree(DESIGNS, tmp_path / "designs")
        shutil.copytree(GOLDEN / "through_focus", tmp_path / "through_focus")
    else:
        copy_designs(tmp_path)
        draw_few_dots(monkeypatch)
        judge_quickly(monkeypatch)
        every = comparison.variants
        monkeypatch.setattr(comparison, "variants", lambda scene: every(scene)[::2])
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("COLUMNS", "100")
    return tmp_path


@pytest.mark.parametrize("page", [p for p in PAGES if steps(p)], ids=lambda p: p.name)
def test_commands_of_the_page_run(
    page: Path,
    folder: Path,
    runner: Runner,
    monkeypatch: pytest.MonkeyPatch,
    capfd: pytest.CaptureFixture[str],
) -> None:
    said, compared = "", True
    for step in steps(page):
        if step.kind == "save":
            named = NAMED.match(step.text)
            (folder / (named[1] if named else "study.toml")).write_text(step.text, encoding="utf-8")
        elif step.kind == "see":
            missing = unsaid(step.text, said) if said and compared else None
            assert missing is None, f"{page.name} shows, and no command before it said: {missing}"
            said, compared = "", True
        else:
            command = as_run(step.text, page.name)
            if OF_THE_GALLERY.match(command) or cannot_end(command):
                continue
            done = runner.run(command, monkeypatch, capfd)
            assert done.status in allowed(command), f"{command}\n{done.err}"
            said, compared = said + done.out, compared and command == step.text


def test_commands_in_the_text_run(
    folder: Path, runner: Runner, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    found = commands_in_text()
    assert len(found) > 5
    for command in (one for one in found if not cannot_end(one)):
        done = runner.run(command, monkeypatch, capfd)
        assert done.status in allowed(command), f"{command}\n{done.err}"


def test_the_arguments_of_all_commands_are_valid_as_written() -> None:
    """Each command of a page exists and takes its options, whether it runs in full or not."""
    blocks = {as_written(step.text) for page in PAGES for step in steps(page) if step.kind == "run"}
    assert len(blocks) > 150
    # Settings are read with the arguments, from a file that a command before has written.
    for command in sorted(one for one in blocks if "--settings" not in one):
        assert_there_is(shlex.split(command))


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
        assert (ROOT / f"{words[2].replace('.', '/')}.py").is_file()
    elif words[0] == "make":
        assert re.search(rf"^{words[1]}:", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    else:
        group = get_command(import_module(f"{words[0]}.cli.commands").app)
        group.commands[words[1]].make_context(words[1], words[2:])


def allowed(command: str) -> tuple[int, ...]:
    """Statuses with which a command may end."""
    return ALLOWED.get(" ".join(command.split()[:2]), (0,))


def unsaid(shown: str, said: str) -> str | None:
    """The first line that a page shows and the commands did not say; numbers may differ by 2 %."""
    lines = [_words(line) for line in said.splitlines()]
    for line in shown.splitlines():
        if line.strip() != "..." and not any(_same(_words(line), other) for other in lines):
            return line
    return None


def _words(line: str) -> list[str]:
    return re.sub(r"[│┃]", " ", line).split()


def _same(shown: list[str], said: list[str]) -> bool:
    return len(shown) <= len(said) and all(map(_alike, shown, said))


def _alike(shown: str, said: str) -> bool:
    try:
        return float(shown.strip("(),;%")) == pytest.approx(float(said.strip("(),;%")), rel=0.02, abs=0.02)
    except ValueError:
        return shown == said
