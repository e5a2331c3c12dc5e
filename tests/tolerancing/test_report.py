"""Reports: one page that needs nothing else, and tables that match the store."""

import csv
import re
from html.parser import HTMLParser

import pytest

from lensdesign import InputError
from tolerancing.report import write_report
from tolerancing.run import run_study
from tolerancing.store import open_store
from tolerancing.study import load_study


def read(path):
    """Rows of a CSV file, as text."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


class Page(HTMLParser):
    """Collects whatever a browser would load, and the text."""

    def __init__(self, text):
        super().__init__()
        self.loaded, self.headings, self.tags, self._heading = [], [], [], False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self._heading = tag in ("h1", "h2")
        self.loaded += [value for name, value in attrs if name in ("src", "href", "srcset", "data", "poster")]

    def handle_data(self, data):
        if self._heading and data.strip():
            self.headings.append(data.strip())
            self._heading = False


@pytest.fixture
def report(write_study, full_study, tmp_path):
    """A report of a finished run whose title tries to break out of the page."""
    loaded = load_study(write_study(full_study.replace("a study", "<script>alert(1)</script> & co")))
    run_study(loaded, tmp_path / "store", workers=1)
    with open_store(tmp_path / "store") as store:
        yield write_report(store, tmp_path / "out"), store


def test_page_is_self_contained_and_tables_match_the_store(report):
    files, store = report
    text = files.html.read_text(encoding="utf-8")
    page = Page(text)
    assert len(page.loaded) == 5
    assert all(source.startswith("data:image/") for source in page.loaded)
    assert not {"script", "link", "iframe", "object"} & set(page.tags)
    assert not re.search(r"https?:|@import|url\(", text)
    assert "&lt;script&gt;alert(1)" in text
    assert "Yield by merit" in page.headings
    assert "Sweep: lens decenter y (mm)" in page.headings
    assert "is not finished" not in text
    assert sorted(p.name for p in files.html.parent.iterdir()) == ["report.html", "sweeps.csv", "trials.csv"]

    results = store.trials()
    assert f"Yield: {results.passed.sum()} of 40 trials" in text
    trials = read(files.trials_csv)
    assert [int(row["trial"]) for row in trials] == list(range(40))
    for columns, array in (
        (["lens_decenter_y_mm", "shop_radius_mm"], results.values),
        (["largest_spread_deg", "strehl"], results.scores),
    ):
        assert [[float(row[column]) for column in columns] for row in trials] == array.tolist()
    assert [row["passed"] == "1" for row in trials] == results.passed.tolist()

    expected = [
        ("lens", "decenter_y_mm", s.sweep, s.step, s.value, merit, score)
        for s in store.steps()
        for merit, score in s.scores.items()
    ]
    keys = {
        "target": str,
        "parameter": str,
        "sweep": str,
        "step": int,
        "value": float,
        "merit": str,
        "score": float,
    }
    assert [tuple(kind(row[key]) for key, kind in keys.items()) for row in read(files.sweeps_csv)] == expected


def test_report_of_an_unfinished_run_says_how_far_it_is(write_study, ray_study, tmp_path):
    def stop(done, total):
        raise KeyboardInterrupt

    loaded = load_study(write_study(ray_study.replace("trials = 40", "trials = 300")))
    with pytest.raises(KeyboardInterrupt):
        run_study(loaded, tmp_path / "store", workers=1, report=stop)
    with open_store(tmp_path / "store") as store:
        text = write_report(store, tmp_path / "out").html.read_text(encoding="utf-8")
    assert "not finished: the store holds 256 of 300 trials" in text


def test_report_without_a_single_trial_is_still_a_report(write_study, full_study, tmp_path):
    from tolerancing.store import create_store

    create_store(tmp_path / "store", load_study(write_study(full_study)), {"strehl": 1.0}, 40)
    with open_store(tmp_path / "store") as store:
        text = write_report(store, tmp_path / "out").html.read_text(encoding="utf-8")
    assert "0 of 40 trials and 0 of 3 sweep steps" in text
    assert "Worst trials" not in text


def test_failed_trials_stand_in_the_report(write_study, ray_study, tmp_path):
    text = ray_study.replace("sigma = 0.01\nlimit = 0.02", "sigma = 9.0\nlimit = 30.0")
    loaded = load_study(write_study(text))
    run_study(loaded, tmp_path / "store", workers=1)
    with open_store(tmp_path / "store") as store:
        failed = store.trials().status.count("failed")
        page = write_report(store, tmp_path / "out").html.read_text(encoding="utf-8")
    assert 0 < failed < 40
    assert f"{failed} could not be scored and count as bad" in page
    assert "Why trials could not be scored" in page


def test_unwritable_folder_is_an_input_error(write_study, ray_study, tmp_path):
    run_study(load_study(write_study(ray_study)), tmp_path / "store", workers=1, trials=2)
    (tmp_path / "file").write_text("")
    with open_store(tmp_path / "store") as store, pytest.raises(InputError, match="cannot write"):
        write_report(store, tmp_path / "file" / "out")


def test_the_store_is_never_overwritten_by_its_report(report, tmp_path):
    _, store = report
    path = tmp_path / "again" / "trials.csv"
    path.parent.mkdir()
    path.write_bytes(store.path.read_bytes())
    with open_store(path) as copy, pytest.raises(InputError, match=r"trials\.csv: it is the store itself"):
        write_report(copy, path.parent)
    assert path.read_bytes() == store.path.read_bytes()


def test_a_report_that_cannot_be_whole_changes_nothing(report, tmp_path):
    _, store = report
    folder = tmp_path / "blocked"
    (folder / "report.html").mkdir(parents=True)
    (folder / "trials.csv").write_text("mine")
    with pytest.raises(InputError, match="it is a folder"):
        write_report(store, folder)
    assert (folder / "trials.csv").read_text() == "mine"
    assert sorted(p.name for p in folder.iterdir()) == ["report.html", "trials.csv"]
