"""Reports of stores: one page and one PDF that say what the summary says, and tables that match the store."""

import csv
import json
import re
import shutil
import subprocess
from html.parser import HTMLParser

import numpy as np
import pytest
from places import DESIGNS

from lensdesign import InputError
from tolerancing.report.blocks import Heading, number_text, percent_text
from tolerancing.report.report import report_data, report_of, write_report
from tolerancing.run.run import run_study
from tolerancing.statistics.summary import summarize
from tolerancing.store.store import create_store, open_store
from tolerancing.study.files import load_study

DESIGN = DESIGNS / "paper_singlet.toml"

HOSTILE = "<script>alert(1)</script> & $co$ \\u0007 _\\u202e"

STUDY = f"""
title = "{HOSTILE}"
design = "design.toml"
trials = 40
seed = 7
sampling = {{ rings = 2, arms = 6, pupil_samples = 64 }}
fidelity = {{ worst_share = 0.1, random_share = 0.2 }}

[[perturbation]]
target = "lens"
parameter = "decenter_y_mm"
distribution = "normal"
sigma = 0.01

[[perturbation]]
name = "shop_radius"
target = "surface 2"
parameter = "radius_mm"
distribution = "truncated_normal"
sigma = 0.004
limit = 0.008

[[correlation]]
names = ["lens_decenter_y", "shop_radius"]
coefficient = 0.25

[[compensator]]
target = "lens"
parameter = "tilt_x_deg"
limit = 0.05

[[merit]]
kind = "largest_spread_deg"
at_most = 4.83

[[merit]]
kind = "line_pair_contrast"
name = "contrast"
line_width_um = 1.0
at_least = 0.9
level = "pupil"

[[merit]]
kind = "line_pair_contrast"
name = "dear_contrast"
line_width_um = 0.8
at_least = 0.8
level = "pupil"
predicted_by = "contrast"

[[sweep]]
name = "decenter"
target = "lens"
parameter = "decenter_y_mm"
values = [0.0, 0.01, 0.02]
line_widths_um = [1.0]
merits = ["contrast"]
picture_values = [0.0, 0.02]

[[grid]]
name = "both"
x = {{ target = "lens", parameter = "decenter_y_mm", values = [0.0, 0.01] }}
y = {{ target = "surface 2", parameter = "radius_mm", values = [0.0] }}
merits = ["largest_spread_deg"]
"""

SECTIONS = [
    "Summary",
    "System and layout",
    "Tolerances",
    "Sensitivities",
    "Predicted from the design",
    "Distributions",
    "Yield against tolerance scale",
    "Merits against perturbations",
    "Worst trials",
    "Sweeps, grids and slice counts (as in the paper's Fig. 7)",
    "Fidelity: low- and high-fidelity merits",
    "Method, fidelity and error",
    "Versions and reproduction",
    "Appendix: coefficients of the sensitivities",
]


def read(path):
    """Rows of a CSV file, as text."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


class Page(HTMLParser):
    """Collects whatever a browser would load, ids and references, points, rows of tables, and the text."""

    def __init__(self, text):
        super().__init__()
        self.loaded, self.ids, self.references, self.trials = [], [], [], []
        self.tags, self.headings, self.rows, self.inside, self.in_cell = [], [], [], "", False
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.inside = tag
        for name, value in attrs:
            if name in ("src", "srcset", "data", "poster") or (name.endswith("href") and value[0] != "#"):
                self.loaded.append(value)
            elif name.endswith("href"):
                self.references.append(value[1:])
            elif name == "id":
                self.ids.append(value)
            elif name == "data-trial":
                self.trials.append(int(value))
            self.references += re.findall(r"url\(#([^)]+)\)", value or "")
        if tag == "tr":
            self.rows.append([])
        if tag in ("td", "th"):
            self.rows[-1].append("")
            self.in_cell = True

    def handle_endtag(self, tag):
        self.in_cell = self.in_cell and tag not in ("td", "th")

    def handle_data(self, data):
        if self.in_cell:
            self.rows[-1][-1] += data.strip()
        if self.inside in ("h2", "h3") and data.strip():
            self.headings.append((self.inside, data.strip()))
            self.inside = ""


def json_of(text):
    """The page's texts by trial."""
    return json.loads(re.search(r'<script type="application/json" id="trials">(.*?)</script>', text)[1])


@pytest.fixture(scope="module")
def full(tmp_path_factory):
    """A report of a finished run that has everything but slice counts, and its store."""
    folder = tmp_path_factory.mktemp("full")
    shutil.copy(DESIGN, folder / "design.toml")
    (folder / "study.toml").write_text(STUDY, encoding="utf-8")
    run_study(load_study(folder / "study.toml"), folder / "store", workers=1)
    with open_store(folder / "store") as store:
        files = write_report(store, folder / "out")
        text = files.html.read_text(encoding="utf-8")
        yield files, store, text, Page(text)


def test_every_section_is_there_in_order(full):
    _, _, text, page = full
    titles = [heading.split(". ", 1)[1] for tag, heading in page.headings if tag == "h2"]
    assert titles == SECTIONS
    for part in ("Worst offenders", "Correlations", "Compensators", "Root sum square and Monte Carlo"):
        assert ("h3", part) in page.headings
    assert ("h3", "Line pairs of these trials") in page.headings
    assert "is not finished" not in text


def test_the_page_needs_nothing_beside_itself(full):
    _, _, text, page = full
    assert all(source.startswith("data:image/png;base64,") for source in page.loaded)
    assert page.tags.count("script") == 2
    assert not {"link", "iframe", "object", "img"} & set(page.tags)
    assert not re.search(r"https?:|@import|url\((?!#)", text)
    assert "default-src 'none'" in text
    assert len(set(page.ids)) == len(page.ids)
    assert set(page.references) <= set(page.ids)


def test_the_theme_s_button_stands_beside_what_scrolls(full):
    _, _, text, _ = full
    links, button = re.search(r"<nav>\s*<div>(.*?)</div>(.*?)</nav>", text, re.DOTALL).groups()
    assert links.count("<a ") == len(SECTIONS)
    assert "<button" not in links
    assert "<button" in button
    # On a wide screen no entry is out of sight.
    assert re.search(r"min-width: 900px.*?nav div \{ flex-wrap: wrap", text, re.DOTALL)
    # A single panel in the last row is as wide as its siblings.
    assert "auto-fit" not in text


def test_field_heights_have_their_own_colours_in_both_themes(full):
    _, _, text, _ = full
    from lensdesign.raytrace.paths import FIELD_COLORS

    for number, colour in enumerate(FIELD_COLORS, start=1):
        assert f"stroke:var(--field-{number})" in text.replace(" ", "")
        # Light, printed; and twice dark, as asked and as the system has it.
        declared = re.findall(rf"--field-{number}: (#[0-9a-f]{{6}})", text)
        assert declared.count(colour.lower()) == 2
        assert len(declared) == 4


def test_lengths_in_figures_are_in_micrometres(full):
    _, _, text, _ = full
    drawn = " ".join(re.findall(r"<text[^>]*>([^<]*)</text>", text))
    assert "µm" in drawn
    assert not re.search(r"\d\s?um\b|\(um\)", drawn)


def test_names_cannot_break_out(full):
    _, _, text, page = full
    assert "&lt;script&gt;alert(1)" in text
    assert "<script>alert" not in text
    assert "\x07" not in text
    assert page.tags.count("svg") > 10


def test_numbers_of_the_page_are_those_of_the_summary(full):
    _, store, text, page = full
    summary = summarize(store)
    assert summary.good.total == 40
    assert f"Yield: {summary.good.passed} of 40 trials keep every limit" in text
    assert f'<div class="big">{percent_text(summary.good.fraction)}</div>' in text
    for merit in summary.merits:
        row = next(r for r in page.rows if r[0] == merit.merit.column and r[2] == merit.merit.limit_text)
        numbers = [merit.nominal, *(merit.percentiles[p] for p in (50, 5, 95))]
        assert row[3:7] == [number_text(v) for v in numbers]
        assert row[7] == percent_text(merit.good.fraction)
        assert row[8].startswith(f"{percent_text(merit.good.low)} – {percent_text(merit.good.high)}")
        missed = merit.good.total - merit.good.passed
        assert str(missed) in row[1] or row[1].startswith(("pass", "fail"))


def test_points_know_their_trials(full):
    _, store, text, page = full
    texts, results = json_of(text), store.trials()
    assert {int(k) for k in texts} == set(page.trials) == set(range(40))
    # One in each scatter plot and rug of both merits, one of them also without compensation.
    counts = {trial: page.trials.count(trial) for trial in range(40)}
    dear = set(store.high_fidelity().trials)
    scatters = 2 * 2
    for trial, count in counts.items():
        assert count == scatters + 3 + (trial in dear)
    assert texts["3"].startswith(f"trial 3: largest_spread_deg {results.scores[3, 0]:.4g}°, contrast ")
    assert "lens_decenter_y_mm" in texts["3"]


def test_tables_match_the_store(full):
    files, store, _, _ = full
    names = ["report.html", "report.pdf", "steps.csv", "trials.csv"]
    assert sorted(p.name for p in files.html.parent.iterdir()) == names
    results = store.trials()
    trials = read(files.trials_csv)
    assert [int(row["trial"]) for row in trials] == list(range(40))
    for columns, array in (
        (["lens_decenter_y_mm", "shop_radius_mm"], results.values),
        (["largest_spread_deg", "contrast"], results.scores),
    ):
        assert [[float(row[column]) for column in columns] for row in trials] == array.tolist()
    assert len(read(files.steps_csv)) == sum(len(s.scores) for s in store.steps())


def test_the_pdf_says_the_same(full):
    files, store, _, _ = full
    data = files.pdf.read_bytes()
    pages = len(re.findall(rb"/Type /Page\b(?!s)", data))
    assert data.startswith(b"%PDF")
    assert pages > 5
    assert b"/Outlines" in data
    if shutil.which("pdftotext") is None:
        pytest.skip("there is no pdftotext to read it with")
    run = subprocess.run(["pdftotext", "-layout", str(files.pdf), "-"], capture_output=True, check=True)
    text = run.stdout.decode()
    for number, title in enumerate(SECTIONS, start=1):
        assert f"{number}. {title}" in text
    assert "<script>alert(1)</script> & $co$" in text
    assert f"{pages} of {pages}" in text
    assert f"{summarize(store).good.passed} of 40 trials keep every limit" in re.sub(r"\s+", " ", text)


def test_fidelity_says_what_both_levels_say(full):
    from tolerancing.statistics.control_variates import Seconds, TrialChoice, combined_mean

    _, store, _, page = full
    dear, results = store.high_fidelity(), store.trials()
    worst = np.array([why == "worst" for why in dear.chosen])
    numbers = np.array(dear.trials)
    chosen = TrialChoice(numbers[worst], numbers[~worst])
    scores = np.concatenate([dear.scores[worst, 0], dear.scores[~worst, 0]])
    seconds = Seconds(results.seconds.mean(), dear.seconds.mean())
    found = combined_mean(results.scores[:, 1], chosen, scores, seconds)
    row = next(r for r in page.rows if r[0] == "mean of dear_contrast")
    assert row[1:3] == [number_text(found.estimate), f"{number_text(found.low)} to {number_text(found.high)}"]


def test_sensitivities_stand_in_the_tables(full):
    _, store, _, page = full
    data = report_data(store)
    found = data.sensitivity
    assert found is not None
    rows = [r for r in page.rows if r[0] == "shop_radius_mm" and len(r) == 11]
    assert len(rows) == 2
    change = found.change[1, [0, -1], 0]
    shown = [float(cell.replace("−", "-")) for cell in rows[0][2:4]]
    assert shown == pytest.approx(change, rel=5e-3)


def test_a_page_is_the_same_for_the_same_store(full):
    from tolerancing.report.html import html_page

    _, store, _, _ = full
    first, again = (html_page(report_of(report_data(store), "today")) for _ in range(2))
    assert first == again


def test_report_of_an_unfinished_run_says_how_far_it_is(write_study, ray_study, tmp_path):
    def stop(done, total):
        if done >= 256:
            raise KeyboardInterrupt

    loaded = load_study(write_study(ray_study.replace("trials = 40", "trials = 30000")))
    with pytest.raises(KeyboardInterrupt):
        run_study(loaded, tmp_path / "store", workers=1, progress=stop)
    with open_store(tmp_path / "store") as store:
        done = store.trial_count()
        text = write_report(store, tmp_path / "out").html.read_text(encoding="utf-8")
    assert 0 < done < 30000
    assert f"not finished: the store holds {done:,} of 30,000 trials" in text


def test_report_without_a_single_trial_is_still_a_report(write_study, full_study, tmp_path):
    create_store(load_study(write_study(full_study)), tmp_path / "store", {"strehl": 1.0}, 40)
    with open_store(tmp_path / "store") as store:
        report = report_of(report_data(store))
        text = write_report(store, tmp_path / "out").html.read_text(encoding="utf-8")
    assert "0 of 40 trials and 0 of 11 steps" in text
    assert "The store holds no trials" in text
    titles = [b.text for b in report.blocks if isinstance(b, Heading) and b.level == 2]
    # Without steps there are no coefficients.
    assert titles == SECTIONS[:-1]


def test_failed_trials_stand_in_the_report(write_study, ray_study, tmp_path):
    text = ray_study.replace("sigma = 0.01\nlimit = 0.02", "sigma = 9.0\nlimit = 11.5")
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


def test_the_store_is_never_overwritten_by_its_report(full, tmp_path):
    _, store, _, _ = full
    path = tmp_path / "again" / "trials.csv"
    path.parent.mkdir()
    path.write_bytes(store.path.read_bytes())
    with open_store(path) as copy, pytest.raises(InputError, match=r"trials\.csv.*store itself"):
        write_report(copy, path.parent)
    assert path.read_bytes() == store.path.read_bytes()


def test_a_report_that_cannot_be_whole_changes_nothing(full, tmp_path):
    _, store, _, _ = full
    folder = tmp_path / "blocked"
    (folder / "report.html").mkdir(parents=True)
    (folder / "trials.csv").write_text("mine")
    with pytest.raises(InputError, match="it is a folder"):
        write_report(store, folder)
    assert (folder / "trials.csv").read_text() == "mine"
    assert sorted(p.name for p in folder.iterdir()) == ["report.html", "trials.csv"]
