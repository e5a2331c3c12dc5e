"""The chapter of a report on what the lens is designed for."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from places import DESIGNS

from lensdesign.errors import InputError
from tolerancing import Store, load_study, open_store, run_study
from tolerancing.budgets.loosening import loosen_each
from tolerancing.cli.commands import main
from tolerancing.prediction import predict_study
from tolerancing.report.blocks import percent_text
from tolerancing.report.report import report_data
from tolerancing.report.sections.prediction import prediction_section, read_front

FRONT = """design,glasses,thickness_mm,as_built_rms_waves,on_front
a.toml,N-BK7,8.19,0.1000,1
b.toml,N-BK7,9.70,0.0976,1
c.toml,N-BK7,9.80,0.1002,0
"""


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Iterator[tuple[Store, Path]]:
    folder = tmp_path_factory.mktemp("designed")
    (folder / "paper_singlet.toml").write_bytes((DESIGNS / "paper_singlet.toml").read_bytes())
    text = (DESIGNS / "as_built_tolerances.toml").read_text(encoding="utf-8")
    head = text.replace("pupil_samples = 128", "pupil_samples = 24").replace("trials = 1000", "trials = 8")
    path = folder / "study.toml"
    path.write_text("sensitivity = false\n" + head, encoding="utf-8")
    run_study(load_study(path), folder / "study.db", workers=1)
    (folder / "front.csv").write_text(FRONT, encoding="utf-8")
    with open_store(folder / "study.db") as store:
        yield store, folder


def test_what_drives_the_yield_stands_first(stored: tuple[Store, Path]) -> None:
    store, folder = stored
    data = report_data(store)
    _, *blocks = prediction_section(data, data.summary, read_front(folder))
    tables = [block for block in blocks if hasattr(block, "rows")]
    beside, yields, loosened, points, drivers = tables
    predicted = predict_study(data.lens, data.study)
    assert yields.rows[-1][3].startswith(percent_text(predicted.yield_fraction))
    assert "axis" in yields.rows[0][2] or "(0, 1)" in yields.rows[0][2]
    assert loosened.rows[0][0] in ("lens_tilt_x_deg", "lens_tilt_y_deg")
    assert beside.rows[0][0] == "wavefront"
    assert beside.rows[0][1:4] == beside.rows[0][4:7]
    assert [row[0] for row in points.rows] == ["(0, 0)", "(0, 1)", "(0, 1.4)"]
    assert drivers.rows[0][0] in ("lens_tilt_x_deg", "lens_tilt_y_deg")
    assert len(drivers.rows) == len(loosened.rows) == len(data.study.perturbations)


def test_a_tighter_tolerance_never_makes_fewer_lenses_good(stored: tuple[Store, Path]) -> None:
    """The yield as it is lies between those with a tolerance halved and doubled."""
    data = report_data(stored[0])
    now = predict_study(data.lens, data.study).yield_fraction
    for one in loosen_each(data.lens, data.study):
        assert one.doubled - 0.005 <= now <= one.halved + 0.005
    loosened = {one.perturbation: one for one in loosen_each(data.lens, data.study)}
    assert loosened["lens_tilt_x_deg"].doubled < now - 0.1
    assert loosened["surface_2_radius_mm"].doubled > now - 0.02


def test_the_command_puts_a_start_and_a_front_beside_the_lens(
    stored: tuple[Store, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    store, folder = stored
    words = [
        "report",
        str(store.path),
        "-o",
        str(tmp_path),
        "--beside",
        str(store.path),
        "--front",
        str(folder),
    ]
    monkeypatch.setattr(sys, "argv", ["tolerancing", *words])
    with pytest.raises(SystemExit) as stop:
        main()
    assert not stop.value.code
    page = (tmp_path / "report.html").read_text(encoding="utf-8")
    assert "Predicted from the design" in page
    assert "this lens" in page
    assert (tmp_path / "report.pdf").stat().st_size > 10_000


@pytest.mark.parametrize("text", ["", "design,glasses,on_front\n", FRONT.replace("8.19", "thin")])
def test_what_is_no_front_is_refused(tmp_path: Path, text: str) -> None:
    (tmp_path / "front.csv").write_text(text, encoding="utf-8")
    with pytest.raises(InputError, match=r"front\.csv.*no front"):
        read_front(tmp_path)
    with pytest.raises(InputError, match="is no front"):
        read_front(tmp_path / "nowhere.csv")
