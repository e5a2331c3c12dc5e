"""Exports: the same rows in both formats, whole or not there, and no formula for a spreadsheet."""

import csv
import math
import sys

import numpy as np
import pandas as pd
import pytest

import tolerancing.store.store as module
from lensdesign import InputError
from tolerancing.store.export import write_steps, write_trials
from tolerancing.store.store import create_store, open_store
from tolerancing.study.files import load_study
from tolerancing.study.results import HighFidelityResults, StepResults, TrialResults

DEAR = """
[[merit]]
name = "fine_contrast"
kind = "line_pair_contrast"
line_width_um = 1.0
at_least = 0.3
predicted_by = "strehl"
"""

TRIALS = 23
FORMULAS = ("=1+1", "+cmd", "-2", "@sum", "\ttab", "plain = text", "")


@pytest.fixture
def store(write_study, full_study, tmp_path):
    path = tmp_path / "a.store"
    create_store(load_study(write_study(full_study + DEAR)), path, {}, TRIALS)
    with open_store(path) as opened:
        opened.add(some_trials(), some_dear(), *some_steps())
        yield opened


def some_trials():
    rng = np.random.default_rng(3)
    scores = rng.normal(size=(TRIALS, 2))
    scores[0], scores[1, 1] = np.nan, np.inf
    messages = [FORMULAS[k % len(FORMULAS)] for k in range(TRIALS)]
    values, extras, seconds = rng.normal(size=(TRIALS, 2)), rng.normal(size=(TRIALS, 1)), rng.random(TRIALS)
    passed = rng.random(TRIALS) > 0.5
    return TrialResults(tuple(range(TRIALS)), values, scores, extras, tuple(messages), passed, seconds)


def some_dear():
    scores, seconds = np.array([[0.5], [np.nan]]), np.array([1.0, 2.0])
    return HighFidelityResults((4, 9), ("worst", "random"), scores, ("", "=lost"), seconds)


def some_steps():
    return [
        StepResults("sweep", 0, {"decenter_y_mm": 0.02}, {"strehl": 0.5, "spread": np.nan}, "", (), 0.1),
        StepResults("slices", 3, {"compensation": "oblique", "slices": 30.0}, {"c": 0.9}, "-x", (), 0.2),
    ]


def exactly(cell):
    """A number as Python reads it; readers of tables may be off by a bit."""
    return float(cell) if cell else math.nan


def test_both_formats_hold_all_rows_bit_by_bit(store, tmp_path, monkeypatch):
    monkeypatch.setattr(module, "ROWS_AT_ONCE", 5)
    write_trials(store, tmp_path / "t.csv")
    write_trials(store, tmp_path / "t.parquet")
    binary = pd.read_parquet(tmp_path / "t.parquet")
    text = pd.read_csv(
        tmp_path / "t.csv", converters={c: exactly for c in binary if binary[c].dtype == float}
    )
    assert list(text) == list(binary)
    trials, dear = some_trials(), some_dear()
    names = [c for c in binary if binary[c].dtype == float]
    assert all(np.array_equal(text[c], binary[c], equal_nan=True) for c in names)
    for table in (text, binary):
        assert table["trial"].tolist() == list(range(TRIALS))
        for k, name in enumerate(("lens_decenter_y_mm", "shop_radius_mm")):
            assert np.array_equal(table[name], trials.values[:, k])
        assert np.array_equal(table["strehl"], trials.scores[:, 1], equal_nan=True)
        assert np.array_equal(table["strehl_uncompensated"], trials.extras[:, 0])
        assert table["passed"].astype(bool).tolist() == trials.passed.tolist()
        assert table["chosen"].dropna().to_dict() == {4: "worst", 9: "random"}
        assert table["fine_contrast"].dropna().to_dict() == {4: dear.scores[0, 0]}
    assert binary["message"].tolist() == list(trials.messages)


def test_a_missing_score_is_empty_or_null(store, tmp_path):
    import pyarrow.parquet as pq

    write_trials(store, tmp_path / "t.csv")
    write_trials(store, tmp_path / "t.parquet")
    with (tmp_path / "t.csv").open(newline="") as file:
        first, second, *_ = csv.DictReader(file)
    assert first["strehl"] == ""
    assert second["strehl"] == "inf"
    column = pq.read_table(tmp_path / "t.parquet")["strehl"]
    assert column.null_count == 1
    assert math.isinf(column[1].as_py())


def test_no_text_in_csv_is_a_formula(store, tmp_path):
    write_trials(store, tmp_path / "t.csv")
    write_steps(store, tmp_path / "s.csv")
    cells = []
    for name in ("t.csv", "s.csv"):
        with (tmp_path / name).open(newline="") as file:
            for row in csv.DictReader(file):
                cells += [row["message"], row.get("high_fidelity_message") or ""]
    assert {"'=1+1", "'+cmd", "'-2", "'@sum", "'\ttab", "plain = text", "'=lost", "'-x"} <= set(cells)
    assert not any(cell.startswith(("=", "+", "-", "@", "\t")) for cell in cells)


def test_steps_have_a_row_for_each_merit(store, tmp_path):
    write_steps(store, tmp_path / "s.csv")
    write_steps(store, tmp_path / "s.parquet")
    for table in (pd.read_csv(tmp_path / "s.csv"), pd.read_parquet(tmp_path / "s.parquet")):
        assert list(table) == [
            "series", "step", "compensation", "slices", "decenter_y_mm", "merit", "score", "message",
            "seconds",
        ]  # fmt: skip
        assert table["merit"].tolist() == ["c", "strehl", "spread"]
        assert table["slices"].tolist()[0] == 30.0
        assert np.isnan(table["slices"][1])
        assert table["decenter_y_mm"].tolist()[1:] == [0.02, 0.02]
        assert np.isnan(table["score"][2])


def test_an_empty_store_has_columns_alone(write_study, full_study, tmp_path):
    create_store(load_study(write_study(full_study)), tmp_path / "empty", {}, 4)
    with open_store(tmp_path / "empty") as empty:
        write_trials(empty, tmp_path / "t.csv")
        write_trials(empty, tmp_path / "t.parquet")
        write_steps(empty, tmp_path / "s.csv")
    assert len(pd.read_csv(tmp_path / "t.csv")) == len(pd.read_parquet(tmp_path / "t.parquet")) == 0
    assert "strehl" in pd.read_csv(tmp_path / "t.csv")
    assert "score" in pd.read_csv(tmp_path / "s.csv")


def test_other_endings_are_refused(store, tmp_path):
    with pytest.raises(InputError, match=r"\.csv and \.parquet"):
        write_trials(store, tmp_path / "t.xlsx")


def test_the_store_itself_is_not_overwritten(store, tmp_path):
    (tmp_path / "link.csv").symlink_to(store.path)
    with pytest.raises(InputError, match="the store itself"):
        write_trials(store, tmp_path / "link.csv")
    assert len(store.trials()) == TRIALS


def test_missing_pyarrow_is_told_and_nothing_is_written(store, tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(InputError, match="extra parquet"):
        write_trials(store, tmp_path / "t.parquet")
    assert not list(tmp_path.glob("*.parquet"))


def test_a_file_that_was_there_stays_when_an_export_breaks_off(store, tmp_path, monkeypatch):
    (tmp_path / "t.csv").write_text("mine")

    def broken(query):
        yield [(None,) * 40]
        raise KeyboardInterrupt

    monkeypatch.setattr(store, "blocks", broken)
    with pytest.raises(KeyboardInterrupt):
        write_trials(store, tmp_path / "t.csv")
    assert (tmp_path / "t.csv").read_text() == "mine"
    assert sorted(p.name for p in tmp_path.glob("*.csv")) == ["t.csv"]


@pytest.mark.parametrize("name", ["t.csv", "t.parquet"])
@pytest.mark.parametrize(
    "change",
    [
        "UPDATE trial SET strehl = '=HYPERLINK(1)' WHERE trial = 2",
        "UPDATE high_fidelity SET seconds = '=1' WHERE trial = 4",
    ],
)
def test_text_among_numbers_is_no_export(store, tmp_path, name, change):
    store._connection.execute(change)
    with pytest.raises(InputError, match=r"damaged: (strehl|high_fidelity_seconds) = '=.*': .*number"):
        write_trials(store, tmp_path / name)
    assert not (tmp_path / name).exists()


def test_no_heading_is_a_formula(store, tmp_path):
    store._connection.execute("""UPDATE step SET coordinates = '{"=HYPERLINK(1)": 1.0, "@x": "=2"}'""")
    write_steps(store, tmp_path / "s.csv")
    with (tmp_path / "s.csv").open(newline="") as file:
        heading, *rows = csv.reader(file)
    assert "'=HYPERLINK(1)" in heading
    assert "'@x" in heading
    cells = [cell for row in (heading, *rows) for cell in row]
    assert not [cell for cell in cells if cell.startswith(("=", "@", "+"))]
