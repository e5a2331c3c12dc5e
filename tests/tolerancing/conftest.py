"""Small studies of a singlet."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import pytest
from programs import Command, run_program
from tests_studies import DESIGN, FULL_STUDY, RAY_STUDY

from lensdesign import Lens, scaled
from tolerancing.run.run import run_study
from tolerancing.store.store import Store, open_store
from tolerancing.study.files import load_study


@pytest.fixture
def command(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> Command:
    """Runs `tolerancing`: exit status, standard output and standard error."""
    return partial(run_program, monkeypatch, capsys, "tolerancing")


@pytest.fixture
def write_study(tmp_path: Path) -> Callable[..., Path]:
    """Write a study and its design to a folder of the test's own; returns the study's path."""

    def write(text: str = RAY_STUDY, design: str = DESIGN) -> Path:
        (tmp_path / "design.toml").write_text(design, encoding="utf-8")
        path = tmp_path / "study.toml"
        path.write_text(text, encoding="utf-8")
        return path

    return write


@pytest.fixture
def ray_study() -> str:
    """Text of a study of rays alone: two perturbations, one merit."""
    return RAY_STUDY


@pytest.fixture
def full_study() -> str:
    """Text of a study with a merit of rays, one of the pupil, and a sweep with a picture."""
    return FULL_STUDY


@pytest.fixture(scope="module")
def small_store(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Store]:
    """A store of six trials of the study with all kinds of merits, whose files are gone."""
    folder = tmp_path_factory.mktemp("single")
    (folder / "design.toml").write_text(DESIGN)
    (folder / "study.toml").write_text(FULL_STUDY)
    run_study(load_study(folder / "study.toml"), folder / "a.db", workers=1, trials=6)
    # What the store says must not depend on the files that it was made from.
    (folder / "design.toml").unlink()
    (folder / "study.toml").unlink()
    with open_store(folder / "a.db") as opened:
        yield opened


@pytest.fixture(scope="session")
def twin(paper_lens: Lens) -> Lens:
    """The paper's lens at a 48th of its size."""
    return scaled(paper_lens, 1 / 48)
