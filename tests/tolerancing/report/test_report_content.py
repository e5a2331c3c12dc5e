"""What a report is made of, without a store: blocks, points, models, and all the ways in which data lack."""

import json
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tolerancing.merits.rays import LargestSpread
from tolerancing.perturbations.distributions import Normal, Uniform
from tolerancing.report.blocks import (
    Cell,
    FigureBlock,
    Headline,
    Paragraph,
    Report,
    Table,
    cut,
    joined,
    number_text,
    plain,
    table,
)
from tolerancing.report.data import MOST_POINTS, WORST_POINTS, ReportData
from tolerancing.report.figures.style import axis_label
from tolerancing.report.html import html_page, safe_json
from tolerancing.report.pdf import FONT, broken_lines, register_fonts, write_pdf
from tolerancing.report.report import report_of
from tolerancing.report.sections.series import series_section
from tolerancing.report.sections.summary import summary_section
from tolerancing.report.sections.trials import SCALES, pictured_trials, scale_section, score_text
from tolerancing.statistics.scorer import kurtosis
from tolerancing.statistics.summary import summary_of
from tolerancing.study.files import load_study
from tolerancing.study.results import Picture, StepResults, TrialResults
from tolerancing.study.scaled_trials import SCALED_TRIALS
from tolerancing.study.sweep import SENSITIVITY, STEPS


def data_of(loaded, scores, values=None, messages=None, steps=(), nominal=None):
    """A report's data from scores, shape (trials, merits)."""
    study, scores = loaded.study, np.asarray(scores, float)
    count = len(scores)
    if values is None:
        drawn = np.random.default_rng(5).normal(size=(count, len(study.perturbations)))
        values = drawn * [p.distribution.standard_deviation for p in study.perturbations]
    passed = [m.passed(scores[:, k]) for k, m in enumerate(study.merits)]
    results = TrialResults(
        trials=np.arange(count),
        values=values,
        scores=scores,
        extras=np.full((count, len(study.extra_columns)), np.nan),
        messages=tuple(messages or [""] * count),
        passed=np.all(passed, axis=0),
        seconds=np.full(count, 0.01),
    )
    record = SimpleNamespace(
        toolkit_version="0", fingerprint=loaded.fingerprint, seed="7", planned_trials=count, created="then"
    )
    nominal = {m.label: m.limit for m in study.merits} if nominal is None else nominal
    summary = summary_of(record, study, nominal, results, len(steps))
    return ReportData(loaded, record, nominal, results, None, list(steps), summary)


@pytest.fixture
def loaded(write_study, ray_study):
    return load_study(write_study(ray_study))


@given(st.text())
def test_json_cannot_end_its_script(text):
    found = safe_json({"1": text.encode("utf-8", "replace").decode()})
    assert not set("<>&\u2028\u2029") & set(found)
    assert json.loads(found) == {"1": text.encode("utf-8", "replace").decode()}


@given(st.text(), st.integers(2, 30))
def test_shown_text_has_no_control_characters(text, most):
    assert not re.search(r"[\x00-\x08\x0b\x0c\x0e-\x1f\x7f-\x9f]", plain(text))
    assert len(plain(text)) == len(text)
    assert len(cut(text, most)) <= most


@settings(deadline=None)
@given(st.text(alphabet="ab_ 1", max_size=60), st.floats(20.0, 200.0))
def test_lines_of_cells_hold_all_of_the_text(text, width):
    from reportlab.pdfbase.pdfmetrics import stringWidth

    register_fonts()
    lines = broken_lines(text, FONT, 7.0, width)
    assert "".join(lines).replace(" ", "") == text.replace(" ", "")
    for line in lines:
        several = len(re.findall(r"[^\s_]*_+|[^\s_]+", line)) > 1
        assert not several or stringWidth(line.rstrip(), FONT, 7.0) <= width


def test_numbers_in_words():
    assert [number_text(v) for v in (None, np.nan, np.inf, -np.inf, -0.5)] == ["–", "–", "∞", "−∞", "−0.5"]
    assert [joined(v) for v in ([], ["a"], ["a", "b"], ["a", "b", "c"])] == ["", "a", "a and b", "a, b and c"]


@pytest.mark.parametrize(
    ("column", "unit", "shown"),
    [
        ("contrast_0p775um", "", "contrast 0.775 µm"),
        ("shift_um", "um", "shift (µm)"),
        ("lens_decenter_x_mm", "mm", "lens decenter x (mm)"),
        ("album_2", "", "album 2"),
        ("contrast_2um_edge", "", "contrast 2 µm edge"),
    ],
)
def test_names_of_columns_as_figures_show_them(column, unit, shown):
    assert axis_label(SimpleNamespace(column=column, unit=unit)) == shown


def test_tables_are_in_micrometres_and_names_stay():
    row = ("shift_2um", Cell("at most 5 um", failed=True), "2.5e-3 um (um), album 2")
    shown = table(["<name (um)", "limit", "rest"], [row])
    assert shown.columns[0].title == "name (µm)"
    assert [cell.text for cell in shown.cells()[0]] == [
        "shift_2um",
        "at most 5 µm",
        "2.5e-3 µm (µm), album 2",
    ]
    assert shown.cells()[0][1].failed


def test_kurtosis_is_that_of_the_distribution():
    assert kurtosis(Uniform(half_width=0.3, mean=1.0)) == pytest.approx(1.8, rel=1e-3)
    assert kurtosis(Normal(sigma=2.0)) == pytest.approx(3.0, rel=0.02)


def test_points_are_the_worst_and_others_at_random(loaded):
    scores = np.random.default_rng(1).normal(4.8, 0.02, (20_000, 1))
    data = data_of(loaded, scores)
    assert len(data.drawn) == len(set(data.drawn.tolist())) == MOST_POINTS
    worst = np.argsort(-scores[:, 0])[:WORST_POINTS]  # the limit is a largest value
    assert set(worst.tolist()) <= set(data.drawn.tolist())
    assert data.drawn.tolist() == data_of(loaded, scores).drawn.tolist()
    assert "1,500 of 20,000 trials" in data.drawn_text
    page = html_page(report_of(data))
    assert len(page) < 1_000_000
    assert len(json.loads(re.search(r'id="trials">(.*?)</script>', page)[1])) == MOST_POINTS


def test_bad_points_are_red_and_stand_where_they_belong(loaded):
    scores = np.linspace(4.7, 4.9, 60)[:, None]
    page = html_page(report_of(data_of(loaded, scores)))
    groups = re.findall(r'<g [^>]*class="(good|bad)"[^>]*>(.*?)</g>', page)
    assert len(groups) == 6
    bad = {i for i in range(60) if scores[i, 0] > 4.83}
    for kind, text in groups:
        trials = [int(t) for t in re.findall(r'data-trial="(\d+)"', text)]
        assert set(trials) == (bad if kind == "bad" else set(range(60)) - bad)
    rug = re.findall(r'cx="([\d.]+)" cy="([\d.]+)" r="1.5" data-trial="(\d+)"', page)[: len(scores)]
    x = np.array([float(a) for a, _, t in sorted(rug, key=lambda item: int(item[2]))])
    assert np.all(np.diff(x) > 0.0)
    assert len({b for _, b, _ in rug}) == 1


def sensitivity_steps(study, change):
    """Steps of a merit that changes as asked: `change` of the fraction of the tolerance, by perturbation."""
    return [
        StepResults(
            SENSITIVITY,
            k * len(STEPS) + i,
            {},
            {m.label: m.limit + change[k](f) for m in study.merits},
            "",
            (),
            0.1,
        )
        for k in range(len(study.perturbations))
        for i, f in enumerate(STEPS)
    ]


def test_the_worst_offender_brings_most_of_the_variance(loaded):
    steps = sensitivity_steps(loaded.study, [lambda f: 0.03 * f, lambda f: 0.04 * f])
    data = data_of(loaded, np.full((10, 1), 4.8), steps=steps)
    shares = data.variance_fractions
    widths = [p.distribution.standard_deviation / p.distribution.largest for p in loaded.study.perturbations]
    expected = np.array([0.03 * widths[0], 0.04 * widths[1]]) ** 2
    assert shares[0] == pytest.approx(expected / expected.sum())
    offenders = next(
        b for b in report_of(data).blocks if isinstance(b, Table) and b.columns[0].title == "Perturbation"
    )
    assert offenders.rows[0][0] == loaded.study.perturbations[int(np.argmax(expected))].column


def test_offenders_come_from_ranks_where_steps_are_missing(loaded):
    rng = np.random.default_rng(0)
    values = rng.normal(size=(100, 2)) * 0.01
    data = data_of(loaded, 4.8 + values[:, 1:], values)
    assert data.sensitivity is None
    assert data.variance_fractions[0, 1] > 0.9


def test_yield_against_scale_is_that_of_the_scaled_trials(loaded):
    rng = np.random.default_rng(2)
    values = rng.normal(size=(2000, 2)) * [0.02, 0.009]
    score = lambda v: 4.82 + 0.4 * v[:, 0] + 30.0 * v[:, 1] ** 2  # noqa: E731
    data = data_of(loaded, score(values)[:, None], values)
    figure = next(b for b in scale_section(data) if isinstance(b, FigureBlock)).panels[0].figure
    lines = {line.get_label(): line for line in figure.axes[0].get_lines()}
    shares = lines["all limits"].get_ydata()
    expected = [100.0 * np.mean(score(s * values) <= 4.83) for s in SCALES]
    assert shares == pytest.approx(expected, abs=1.0)


def test_a_model_that_explains_nothing_is_left_out(loaded):
    scores = np.random.default_rng(3).normal(4.8, 0.05, (200, 1))
    blocks = scale_section(data_of(loaded, scores))
    assert not any(isinstance(b, FigureBlock) for b in blocks)
    assert "explains too little" in blocks[-1].text


@pytest.mark.parametrize(
    ("throughputs", "disagrees"), [([0.95] * 15 + [0.8] * 185, True), ([0.95] * 200, False)]
)
def test_merits_that_reject_other_trials_are_named(write_study, ray_study, throughputs, disagrees):
    loaded = load_study(write_study(ray_study + '[[merit]]\nkind = "throughput"\nat_least = 0.9\n'))
    scores = np.column_stack([np.full(200, 4.7), throughputs])
    said = [b.text for b in summary_section(data_of(loaded, scores)) if isinstance(b, Paragraph)]
    assert any("only 7.5 % meet throughput" in text for text in said) is disagrees


def test_the_curve_of_all_limits_is_missing_where_a_merit_is_left_out(write_study, ray_study):
    loaded = load_study(write_study(ray_study + '[[merit]]\nkind = "throughput"\nat_least = 0.9\n'))
    rng = np.random.default_rng(3)
    values = rng.normal(0.0, 0.02, (200, len(loaded.study.perturbations)))
    scores = np.column_stack([4.8 + values[:, 0], rng.normal(0.9, 0.05, 200)])
    blocks = scale_section(data_of(loaded, scores, values))
    (figure,) = [b.panels[0].figure for b in blocks if isinstance(b, FigureBlock)]
    (line,) = figure.axes[0].get_legend_handles_labels()[0]
    assert line.get_label() == "largest spread (°)"
    # The bold one is that of all limits.
    assert line.get_linewidth() < 2.0


def test_points_beside_the_models_are_yields_of_the_trials(loaded):
    values = np.random.default_rng(2).normal(size=(2000, 2)) * [0.02, 0.009]
    scores = 4.82 + 0.4 * values[:, 0] + 30.0 * values[:, 1] ** 2
    data = data_of(loaded, scores[:, None], values)
    axis = next(b for b in scale_section(data) if isinstance(b, FigureBlock)).panels[0].figure.axes[0]
    share = 100.0 * np.mean(scores <= 4.83)
    curve = next(line for line in axis.get_lines() if line.get_label() == "all limits")
    assert np.interp(1.0, SCALES, curve.get_ydata()) == pytest.approx(share)
    for container in axis.containers:  # of the merit, and of all limits, which are this one
        point, _, (interval,) = container.lines
        assert point.get_xydata() == pytest.approx(np.array([[1.0, share]]))
        (low, high) = interval.get_segments()[0][:, 1]
        assert low < share < high
    assert len(axis.containers) == 2


def test_a_poor_model_gives_way_to_trials_at_three_factors(write_study, ray_study):
    """A parabola through a loss that grows with the eighth power of an error is upside down."""
    loaded = load_study(write_study(ray_study + "[scaled_trials]\nfactors = [0.5, 2.0]\ntrials = 200\n"))
    rng = np.random.default_rng(4)
    values = rng.normal(0.0, 0.02, (200, len(loaded.study.perturbations)))
    score = lambda v: 4.7 + 0.1 * np.abs(v[:, 0] / 0.02) ** 8  # noqa: E731
    (series,) = [s for s in loaded.study.series if s.label == SCALED_TRIALS]
    (merit,) = loaded.study.merits
    steps = []
    for step in range(len(series)):
        where = series.coordinates(step)
        (own,) = score(where["tolerance_factor"] * values[[int(where["trial"])]])
        steps.append(StepResults(series.label, step, where, {merit.label: own}, "", (), 0.01))
    blocks = scale_section(data_of(loaded, score(values)[:, None], values, steps=steps))
    assert not blocks[1].text.startswith("Full lines")
    axis = next(b for b in blocks if isinstance(b, FigureBlock)).panels[0].figure.axes[0]
    points = axis.containers[-1].lines[0].get_xydata()
    expected = [[f, 100.0 * np.mean(merit.passed(score(f * values)))] for f in (0.5, 1.0, 2.0)]
    assert points == pytest.approx(np.array(expected))
    assert points[0, 1] > points[1, 1] > points[2, 1]
    rows = next(b for b in blocks if isinstance(b, Table)).rows
    assert plain(rows[-1][1]).startswith(f"{points[0, 1]:.1f} %")


@given(st.floats(4.8, 5.0) | st.floats(4.9 - 1e-6, 4.9 + 1e-6))
def test_a_score_shows_on_which_side_of_its_limit_it_is(score):
    merit = LargestSpread(kind="largest_spread_deg", at_most=4.9)
    assert (float(score_text(merit, score)) <= 4.9) == (score <= 4.9)


def test_scores_have_no_more_digits_than_they_need():
    merit = LargestSpread(kind="largest_spread_deg", at_most=4.9)
    assert [score_text(merit, v) for v in (4.91234, 4.90004, 4.89996)] == ["4.912", "4.90004", "4.9"]
    assert score_text(merit, np.nan) == "–"


def test_long_texts_of_tables_keep_a_width_to_be_read_in():
    rows = [["short", "a text " * 20, Cell("80 %", bar=(0.8, 0.7, 0.9))]]
    page = html_page(Report("title", "subtitle", (table(["<A", "<B", "<C"], rows),), {}, "footer"))
    assert page.count('<td class="left long">a text') == page.count('<td class="left">short') == 1
    assert '<span class="barred">80 %</span>' in page


def test_pictured_trials_are_the_worst_and_the_median(loaded):
    scores = np.linspace(4.7, 4.9, 21)[:, None]
    scores[20] = np.nan
    assert pictured_trials(data_of(loaded, scores)) == [19, 18, 17, 9]


SLICES = """
[[slice_count]]
slices = [10, 30]
line_widths_um = [1.0]
picture_slices = [30]

[[grid]]
name = "both"
x = { target = "lens", parameter = "decenter_x_mm", values = [0.1, -0.1, 0.0] }
y = { target = "lens", parameter = "tilt_x_deg", values = [0.2] }
merits = ["largest_spread_deg"]
"""


def test_slice_counts_and_grids_become_curves_maps_and_plates(write_study, ray_study):
    loaded = load_study(write_study(ray_study + SLICES))
    counts, grid = loaded.study.slice_counts[0], loaded.study.grids[0]
    picture = Picture(1.0, "y", True, 5.0, np.eye(9, dtype=np.float32))
    steps = [
        StepResults(
            counts.label,
            k,
            counts.coordinates(k),
            {"contrast_1um": 0.25 * (k + 1), "contrast_of_eikonal_1um": 0.95},
            "",
            (picture,) if counts.coordinates(k)["slices"] == 30.0 else (),
            0.1,
        )
        for k in range(len(counts))
    ]
    scores = [4.7, np.nan, 4.9]
    steps += [
        StepResults(
            grid.label,
            k,
            grid.coordinates(k),
            {"largest_spread_deg": v},
            "dark" if np.isnan(v) else "",
            (),
            0.1,
        )
        for k, v in enumerate(scores)
    ]
    blocks = series_section(data_of(loaded, np.full((3, 1), 4.8), steps=steps))
    heat, curves, plate = [b for b in blocks if isinstance(b, FigureBlock)]
    mesh = heat.panels[0].figure.axes[0].collections[0]
    # In rising order of x: -0.1, 0 and 0.1.
    assert mesh.get_array().ravel().tolist() == [None, 4.9, 4.7]
    lines = {line.get_label(): line.get_ydata() for line in curves.panels[0].figure.axes[0].get_lines()}
    assert list(lines["vertical"]) == [0.25, 0.75]
    assert list(lines["oblique"]) == [0.5, 1.0]
    assert list(lines["eikonal engine"]) == [0.95, 0.95]
    titles = [axes.get_title() for axes in plate.panels[0].figure.axes]
    assert titles == ["vertical, 30 slices: 0.75", "oblique, 30 slices: 1.00"]
    messages = [b for b in blocks if isinstance(b, Table) and b.columns[-1].title == "Not scored, because"]
    assert [row[-1].text for row in messages[0].rows] == ["dark"]


@pytest.mark.parametrize(
    ("nominal", "scores", "words"),
    [
        (4.8, [4.8, 4.81], "Pass: every trial"),
        (4.8, [4.8, 4.81, 4.9], "Pass in part"),
        (4.8, [4.9, 4.9, 4.81], "Fail: most trials"),
        (4.9, [4.8, 4.8], "Fail: the nominal lens misses largest_spread_deg"),
    ],
)
def test_verdicts(loaded, nominal, scores, words):
    data = data_of(loaded, np.array(scores)[:, None], nominal={"largest_spread_deg": nominal})
    headline = next(b for b in report_of(data).blocks if isinstance(b, Headline))
    assert headline.verdict.startswith(words)


@pytest.mark.parametrize(
    "scores",
    [
        np.full(12, np.nan),
        np.full(12, 4.8),
        np.array([4.8, np.inf, -np.inf, np.nan] * 3),
        np.array([4.8, np.nextafter(4.8, 5.0)] * 6),
        np.array([4.8]),
        np.array([-1e300, 1e300, 0.0] * 4),
        np.array([]),
    ],
    ids=["none scored", "all alike", "infinite", "next to alike", "one", "huge", "none"],
)
def test_whatever_the_scores_the_report_is_whole(loaded, tmp_path, scores):
    messages = ["dark <&>" if np.isnan(s) else "" for s in scores]
    report = report_of(data_of(loaded, scores[:, None], messages=messages))
    page = html_page(report)
    write_pdf(report, tmp_path / "a.pdf")
    assert page.rstrip().endswith("</html>")
    assert (tmp_path / "a.pdf").stat().st_size > 10_000
    if any(messages):
        assert "dark &lt;&amp;&gt;" in page


def test_the_surfaces_tell_all_of_their_shape(loaded):
    plain_rows = surfaces_of(loaded, loaded.lens)
    assert [row[3] for row in plain_rows] == ["–", "–"]
    lens = loaded.lens.with_surface(1, shape_type="biconic", radius_x_mm=-14.0, conic_x=-1.25)
    rows = surfaces_of(loaded, lens.with_surface(0, asphere=(1e-6, 2e-8)))
    assert [row[3] for row in rows] == [
        "even asphere, asphere 1e-06 2e-08",
        "biconic, radius_x_mm -14, conic_x -1.25",
    ]


def surfaces_of(loaded, lens):
    from tolerancing.report.sections.summary import lens_section

    data = data_of(replace(loaded, lens=lens), [[0.5]] * 3)
    found = next(b for b in lens_section(data) if isinstance(b, Table))
    return [[cell.text for cell in row] for row in found.cells()]


def test_long_names_and_messages_fit_the_pages(loaded, tmp_path):
    text = "x" * 5000 + " & <b>" + "long_name_" * 300
    report = report_of(data_of(loaded, np.full((3, 1), np.nan), messages=[text] * 3))
    blocks = (
        *report.blocks,
        table(["<a", *("b_" * k for k in range(1, 30))], [[text] * 30]),
        Paragraph(text),
    )
    from dataclasses import replace

    write_pdf(replace(report, blocks=blocks, title=text), tmp_path / "a.pdf")
    assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
