"""What the documentation shows: its Python, run; its links; its files. Commands have a test of their own."""

from __future__ import annotations

import re
import runpy
import shutil
import tomllib
from pathlib import Path

import pytest
from places import DESIGNS, ROOT
from quick_verdicts import judge_quickly
from small_pictures import draw_few_dots

from lensdesign.common.toml_files import validate
from lensdesign.lens.lens import Lens
from lensdesign.manufacture.drawing.sheets import DrawingOptions
from lensdesign.optimization.specification.specification import Specification
from tolerancing.study.files import study_from_tables

PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def blocks(page: Path, language: str) -> list[str]:
    """Fenced blocks of one language."""
    return re.findall(
        rf"^```{language}\n(.*?)^```", page.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE
    )


SNIPPETS = [(page, number) for page in PAGES for number in range(len(blocks(page, "python")))]


@pytest.mark.parametrize(("page", "number"), SNIPPETS, ids=[f"{p.name}-{n}" for p, n in SNIPPETS])
def test_python_of_the_pages_runs(
    page: Path,
    number: int,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    script = tmp_path / "tour.py"
    # A page's study takes as long as its trials, of which a few show that the code runs.
    text = re.sub(r"trials=\d+", "trials=10", blocks(page, "python")[number])
    script.write_text(text, encoding="utf-8")
    shutil.copytree(DESIGNS, tmp_path / "designs")
    judge_quickly(monkeypatch)
    draw_few_dots(monkeypatch)
    monkeypatch.chdir(tmp_path)
    runpy.run_path(str(script), run_name="__main__")
    assert capsys.readouterr().out


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_links_lead_somewhere(page: Path) -> None:
    for target in re.findall(r"\]\(([^)#]+)(?:#[^)]*)?\)", page.read_text(encoding="utf-8")):
        assert target.startswith("https://") or (page.parent / target).exists(), target


def test_files_that_pages_show_are_valid(tmp_path: Path) -> None:
    design, *parts = blocks(ROOT / "docs" / "design-files.md", "toml")
    tables = tomllib.loads(design)
    for part in parts:
        validate(Lens, tables | tomllib.loads(part), "docs/design-files.md")
    specification = "\n".join(blocks(ROOT / "docs" / "specifications.md", "toml"))
    validate(Specification, tables | tomllib.loads(specification), "docs/specifications.md")
    study, *parts = blocks(ROOT / "docs" / "tolerancing.md", "toml")
    assert study_from_tables(tomllib.loads(study), "docs/tolerancing.md").trials == 500
    whole = study_from_tables(tomllib.loads("\n".join([study, *parts])), "docs/tolerancing.md")
    assert whole.correlations
    assert whole.compensators
    assert whole.high_fidelity_merits
    (sheet,) = blocks(ROOT / "docs" / "making.md", "toml")
    validate(DrawingOptions, tomllib.loads(sheet), "docs/making.md")


def test_classes_in_the_figure_of_the_forward_model_exist() -> None:
    page = (ROOT / "docs" / "chain.md").read_text(encoding="utf-8")
    named = {
        name for words in re.findall(r'class="class">([^<]+)<', page) for name in words.split(", ")
    } | set(re.findall(r">(\w+Model)<", page))
    assert len(named) > 8
    sources = [path.read_text(encoding="utf-8") for path in (ROOT / "wavesim").rglob("*.py")]
    defined = {name for text in sources for name in re.findall(r"^(?:class|def) (\w+)", text, re.MULTILINE)}
    assert named <= defined
