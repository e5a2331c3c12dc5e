"""Pictures of a lens: what they show, that they are files, and that they leave nothing behind."""

from __future__ import annotations

import re
import subprocess
import sys
import warnings
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import assume, given, settings
from matplotlib.collections import LineCollection
from matplotlib.colors import to_hex
from matplotlib.image import imread
from matplotlib.lines import Line2D
from matplotlib.patches import Polygon
from matplotlib.text import Text
from random_lenses import lenses

from lensdesign import Lens
from lensdesign.analysis.exit_beam import rms_spot_diameter
from lensdesign.errors import InputError
from lensdesign.lens.edges import Edge, Flange
from lensdesign.lens.scaling import scaled
from lensdesign.lens.solid import glass_elements
from lensdesign.plots import plots
from lensdesign.plots.charts import spread_figure
from lensdesign.plots.layout import THICK, THIN
from lensdesign.plots.plots import draw_all, incidence_figure, layout_figure, spot_figure, write_figure
from lensdesign.plots.scene3d import RenderingError
from lensdesign.raytrace.paths import FIELD_COLORS, FIELD_FRACTIONS, sized_lens


@pytest.fixture(scope="module")
def triplet() -> Lens:
    """A cemented doublet, an inner stop in air, and an aspheric singlet of no given size."""
    return Lens.model_validate(
        {
            "wavelengths_um": [0.532, 0.633],
            "object": {"field_diameter_mm": 6.0, "numerical_aperture": 0.2, "working_distance_mm": 40.0},
            "sensor": {"pixel_pitch_um": 3.2, "pixels": [6000, 4000], "plane_distances_mm": [2.0, 4.0, 30.0]},
            "surface": [
                {"radius_mm": 40.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 12.0},
                {"radius_mm": -30.0, "thickness_mm": 2.0, "material": "N-SF6", "semi_diameter_mm": 12.0},
                {"radius_mm": -200.0, "thickness_mm": 4.0, "semi_diameter_mm": 10.5},
                {"thickness_mm": 5.0, "stop": True, "semi_diameter_mm": 8.0},
                {"radius_mm": 35.0, "asphere": [1e-5], "thickness_mm": 5.0, "material": "N-BK7"},
                {"radius_mm": -90.0},
            ],
        }
    )


def no_rendering(monkeypatch: pytest.MonkeyPatch) -> None:
    def refuse(*_: Any) -> None:
        raise RenderingError("no off-screen rendering on this machine")

    monkeypatch.setattr(plots, "render_lens", refuse)


def test_layout_shows_glass_rays_and_planes(paper_lens: Lens) -> None:
    (axes,) = layout_figure(paper_lens).axes
    assert axes.get_aspect() == 1.0
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("z (mm)", "y (mm)")
    fans = [c for c in axes.collections if isinstance(c, LineCollection)]
    assert [c.get_label() for c in fans] == [f"field height {h} mm" for h in ("0", "1.05", "1.5")]
    for fan, height in zip(fans, (0.0, 1.05, 1.5), strict=True):
        segments = fan.get_segments()
        assert 9 <= len(segments) <= 11
        assert np.array([s[0] for s in segments]) == pytest.approx(
            np.tile([-13.5, height], (len(segments), 1))
        )
        assert np.array([s[-1][0] for s in segments]) == pytest.approx(31.7)
    glass = next(p for p in axes.patches if isinstance(p, Polygon))
    low, high = glass.get_xy().min(axis=0), glass.get_xy().max(axis=0)
    assert [*low, *high] == pytest.approx([0.0, -10.0, 9.7, 10.0])
    planes = [line.get_xydata() for line in axes.lines if line.get_linewidth() == THICK][2:5]
    expected = [[[z, -half], [z, half]] for z, half in ((-13.5, 1.5), (11.7, 11.2), (31.7, 11.2))]
    assert np.array(planes) == pytest.approx(np.array(expected))
    texts = {t.get_text() for t in axes.texts}
    assert {"object\nØ 3 mm", "$H_{1}$ = 2 mm", "$H_{2}$ = 22 mm", "stop", "N-BK7", "5 mm"} == texts


def test_layout_of_several_elements(triplet: Lens) -> None:
    (axes,) = layout_figure(triplet).axes
    glass = [p for p in axes.patches if isinstance(p, Polygon) and len(p.get_xy()) > 10]
    assert len(glass) == 3
    wedges = [p.get_xy()[0] for p in axes.patches if isinstance(p, Polygon) and len(p.get_xy()) < 10]
    assert np.array(wedges) == pytest.approx(np.array([[12.0, 8.0], [12.0, -8.0]]))


def test_layout_draws_no_ray_beyond_its_failure(paper_lens: Lens) -> None:
    (axes,) = layout_figure(paper_lens.with_surface(1, semi_diameter_mm=8.3)).axes
    segments = [s for c in axes.collections if isinstance(c, LineCollection) for s in c.get_segments()]
    inside = [s for s in segments if s[-1][0] < 30.0]
    assert 0 < len(inside) < len(segments)
    assert max(abs(s[-1][1]) for s in inside) <= 8.3 + 1e-9
    assert max(s[-1][0] for s in inside) < 9.7


def test_layout_of_a_lens_that_does_not_close_is_still_drawn(paper_lens: Lens) -> None:
    assert layout_figure(paper_lens.with_surface(0, thickness_mm=4.5)).axes


def crowded(lens: Lens) -> list[str]:
    """What of the figure's text overlaps other text, or leaves the figure, by the renderer's extents."""
    figure = layout_figure(lens)
    figure.draw_without_rendering()
    (axes,) = figure.axes
    ticks = [t for axis in (axes.xaxis, axes.yaxis) for t in axis.get_ticklabels() if t.get_text()]
    inside = [t for t in ticks if figure.bbox.contains(*t.get_window_extent().p0)]
    texts = [*figure.texts, *axes.texts, axes.xaxis.label, axes.yaxis.label, *inside]
    boxes = [(t.get_text(), Text.get_window_extent(t)) for t in texts]
    boxes += [("legend", legend.get_window_extent()) for legend in figure.legends]
    found = [name for name, box in boxes if figure.bbox.count_contains(box.corners()) < 4]
    for i, (name, box) in enumerate(boxes):
        found += [f"{name} on {other}" for other, its in boxes[:i] if box.overlaps(its)]
    return found


def many_elements(count: int) -> Lens:
    """A row of plates, a millimetre apart, with as many sensor planes."""
    plates = [
        {"thickness_mm": 1.0, "material": "N-LASF46A" if i % 2 == 0 else None, "semi_diameter_mm": 4.0}
        for i in range(2 * count - 1)
    ]
    return Lens.model_validate(
        {
            "wavelengths_um": [0.532],
            "object": {"field_diameter_mm": 2.0, "numerical_aperture": 0.1, "working_distance_mm": 15.0},
            "sensor": {
                "pixel_pitch_um": 3.2,
                "pixels": [3000, 2000],
                "plane_distances_mm": [round(0.1 + 0.05 * i, 2) for i in range(count)],
            },
            "surface": [*plates, {"semi_diameter_mm": 4.0}],
        }
    )


def flanged(lens: Lens) -> Lens:
    """With a bevel in front and a wide flange."""
    flange = Flange(semi_diameter_mm=16.0, distance_mm=2.5, thickness_mm=2.0)
    return lens.replaced(edges=(Edge(semi_diameter_mm=10.5, front_bevel_mm=0.3, flange=flange),))


def test_layout_shows_the_whole_edge(paper_lens: Lens) -> None:
    (axes,) = layout_figure(flanged(paper_lens)).axes
    glass = next(p for p in axes.patches if isinstance(p, Polygon))
    assert np.abs(glass.get_xy()[:, 1]).max() == pytest.approx(16.0)
    assert axes.get_ylim()[0] < -16.0
    assert axes.get_ylim()[1] > 16.0
    (name,) = (t for t in axes.texts if t.get_text() == "N-BK7")
    assert name.get_position()[1] < -16.0


def test_labels_do_not_overlap(paper_lens: Lens, triplet: Lens) -> None:
    def with_planes(*distances: float) -> Lens:
        return paper_lens.replaced(
            sensor=paper_lens.sensor.model_copy(update={"plane_distances_mm": distances})
        )

    def with_field(diameter_mm: float) -> Lens:
        return paper_lens.replaced(
            object=paper_lens.object.model_copy(update={"field_diameter_mm": diameter_mm})
        )

    lenses = {
        "paper": paper_lens,
        "triplet": triplet,
        "planes 0.1 mm apart": with_planes(2.0, 2.1, 2.2),
        "planes 1 µm apart": with_planes(2.0, 2.001, 2.002, 2.003, 22.0),
        "far plane": with_planes(0.1, 900.0),
        "tiny field": with_field(1e-4),
        "large field": with_field(17.5),
        "small twin": scaled(paper_lens, 1e-3),
        "large twin": scaled(paper_lens, 50.0),
        "five elements": many_elements(5),
        "twenty elements": many_elements(20),
        "flange": flanged(paper_lens),
    }
    assert {name: crowded(lens) for name, lens in lenses.items()} == {name: [] for name in lenses}


@settings(max_examples=15)
@given(lenses())
def test_labels_of_random_lenses_do_not_overlap(lens: Lens) -> None:
    try:
        sized_lens(lens)
        glass_elements(lens)
    except InputError:
        assume(False)
    assert crowded(lens) == []


def test_names_are_no_mathematics(paper_lens: Lens, tmp_path: Path) -> None:
    name = r"$\frac{_^\alpha"
    catalogue = tmp_path / "odd.agf"
    catalogue.write_text(f"CC test\nNM {name} 2 0 1.5 60\nCD 1.25 0.01 0 0 0 0\nLD 0.3 2.0\n")
    odd = paper_lens.with_surface(0, material="N-BK7").replaced(
        title=r"$\frac{ a_b^c \ & <svg>", glass_catalogs=(catalogue,)
    )
    odd = odd.with_surface(0, material=name)
    figure = layout_figure(odd)
    assert name in {t.get_text() for t in figure.axes[0].texts}
    for suffix in ("png", "svg"):
        write_figure(layout_figure(odd), tmp_path / f"layout.{suffix}")
    assert name in (tmp_path / "layout.svg").read_text()
    assert crowded(odd) == []


def test_long_names_are_cut(paper_lens: Lens, tmp_path: Path) -> None:
    catalogue = tmp_path / "odd.agf"
    catalogue.write_text(f"CC test\nNM {'W' * 90} 2 0 1.5 60\nCD 1.25 0.01 0 0 0 0\nLD 0.3 2.0\n")
    odd = paper_lens.replaced(glass_catalogs=(catalogue,)).with_surface(0, material="W" * 90)
    assert "W" * 23 + "…" in {t.get_text() for t in layout_figure(odd).axes[0].texts}
    assert crowded(odd) == []


def test_text_in_svg_stays_text(paper_lens: Lens, tmp_path: Path) -> None:
    write_figure(layout_figure(paper_lens), tmp_path / "layout.svg")
    root = ElementTree.parse(tmp_path / "layout.svg").getroot()
    shown = {"".join(e.itertext()).strip() for e in root.iter("{http://www.w3.org/2000/svg}text")}
    assert {"stop", "N-BK7", "5 mm", "z (mm)", "field height 1.05 mm"} <= shown


def test_two_line_widths(triplet: Lens) -> None:
    (axes,) = layout_figure(triplet).axes
    widths = {line.get_linewidth() for line in axes.lines}
    widths |= {width for c in axes.collections for width in np.atleast_1d(c.get_linewidth())}
    widths |= {p.get_linewidth() for p in axes.patches}
    assert widths == {0.0, THIN, THICK}


def test_layout_is_to_scale(paper_lens: Lens, triplet: Lens) -> None:
    for lens in (paper_lens, triplet, many_elements(20), scaled(paper_lens, 1e-3)):
        figure = layout_figure(lens)
        (axes,) = figure.axes
        figure.draw_without_rendering()
        across, up = np.diff(axes.transData.transform([(0.0, 0.0), (1.0, 1.0)]), axis=0)[0]
        assert across == pytest.approx(up)
        bar = next(t.get_text() for t in axes.texts if re.fullmatch(r"[\d.e-]+ mm", t.get_text()))
        drawn = np.ptp([line for line in axes.lines if line.get_linewidth() == THICK][-1].get_xdata())
        assert drawn == pytest.approx(float(bar.split()[0]))


def test_spots_land_on_the_design_s_sensor_planes(paper_lens: Lens) -> None:
    figure = spot_figure(paper_lens)
    assert [axes.get_ylabel().split("\n")[0] for axes in figure.axes[::3]] == [
        f"{distance} mm behind the exit vertex" for distance in (2, 22)
    ]
    for number, axes in enumerate(figure.axes):
        (frame,), (dots,) = axes.patches, axes.lines
        assert np.array([frame.get_xy(), (frame.get_width(), frame.get_height())]) == pytest.approx(
            np.array([[-14.9504, -11.2], [29.9008, 22.4]])
        )
        assert axes.get_xlim()[1] > 14.9504
        assert dots.get_color() == FIELD_COLORS[number % 3]
        distance, height = (2.0, 22.0)[number // 3], 1.5 * FIELD_FRACTIONS[number % 3]
        points = np.stack(dots.get_data(), axis=-1)
        spot = rms_spot_diameter(paper_lens, None, height, distance)
        assert points.mean(axis=0) == pytest.approx(spot.centroid_mm, abs=0.02)
        # Even filling by rings counts the rim in full, so it comes out a little larger.
        drawn = 2.0 * np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=-1)))
        assert drawn == pytest.approx(spot.rms_diameter_mm, rel=0.03)
    alone = paper_lens.replaced(sensor=paper_lens.sensor.replaced(plane_distances_mm=(5.0,)))
    assert len(spot_figure(alone).axes) == 3


def test_spot_diameters_are_those_of_the_analysis(paper_lens: Lens) -> None:
    titles = [axes.get_title() for axes in spot_figure(paper_lens, [3.0]).axes]
    shown = [float(re.search(r"([\d.]+) mm$", t)[1]) for t in titles]  # type: ignore[index]
    assert shown == [14.27, 14.25, 14.22]


def test_spots_state_what_is_lost(paper_lens: Lens) -> None:
    figure = spot_figure(paper_lens.with_surface(1, semi_diameter_mm=8.3))
    assert all(re.search(r"6\d\.\d % pass", axes.get_title()) for axes in figure.axes)


def test_every_picture_says_which_lens_it_is_of(paper_lens: Lens) -> None:
    odd = paper_lens.replaced(title="One \\$lens_\n" + 300 * "W")
    for draw in (layout_figure, spot_figure, incidence_figure, spread_figure):
        for lens, said in ((paper_lens, "Spatial information transfer lens, Table 1"), (odd, "One ")):
            figure = draw(lens)
            figure.draw_without_rendering()
            texts = [figure._suptitle] if figure._suptitle else figure.texts  # type: ignore[attr-defined]
            (title,) = (text for text in texts if text.get_text().startswith(said))
            box = Text.get_window_extent(title)
            assert figure.bbox.x0 <= box.x0 < box.x1 <= figure.bbox.x1
            assert "0.532 µm" in title.get_text() or draw is spread_figure


def test_colours_of_field_heights_mean_nothing_else(paper_lens: Lens) -> None:
    two = paper_lens.replaced(wavelengths_um=(0.633, 0.532))
    for figure in (incidence_figure(paper_lens), spread_figure(paper_lens), spread_figure(two)):
        colours = {to_hex(Line2D.get_color(line)) for axes in figure.axes for line in axes.lines}
        assert not colours & {colour.lower() for colour in FIELD_COLORS}


def test_incidence_shows_the_limit_and_who_exceeds_it(paper_lens: Lens) -> None:
    figure = incidence_figure(paper_lens)
    titles = [axes.get_title() for axes in figure.axes]
    assert [t.split("\n")[0] for t in titles] == ["(0, 0) mm", "(0, 3) mm", "(0, 7) mm", "(0, 9) mm"]
    labels = [t.get_text() for t in figure.legends[0].get_texts()]
    assert labels == ["spread limit 4.77°", "within the limit", "beyond the limit"]
    for axes in figure.axes:
        limit, within = (np.hypot(*np.asarray(line.get_xydata()).T) for line in axes.lines[:2])
        # Angles in the xz and yz planes: a circle to 0.01 deg, and exactly so on the axes.
        assert limit[::90] == pytest.approx(np.full(5, 4.7682), abs=1e-4)
        assert limit == pytest.approx(np.full(361, 4.7682), abs=0.01)
        assert within.max() < 4.7682 + 0.01
    (beyond,) = (x for x in figure.axes[3].lines if x.get_label() == "beyond the limit")
    assert 0 < len(np.asarray(beyond.get_xydata())) < 20


def test_incidence_where_no_light_arrives(paper_lens: Lens) -> None:
    figure = incidence_figure(paper_lens, [(0.0, 0.0), (0.0, 14.0)])
    assert figure.axes[1].get_title() == "(0, 14) mm\nno light arrives"


def test_spots_and_incidence_of_several_elements(triplet: Lens) -> None:
    assert all(len(np.asarray(a.lines[0].get_xydata())) > 500 for a in spot_figure(triplet).axes)
    (axes,) = incidence_figure(triplet, [(0.0, 7.0)]).axes
    assert {"within the limit", "beyond the limit"} <= {line.get_label() for line in axes.lines}


def test_draw_all_without_rendering_says_so(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, paper_lens: Lens
) -> None:
    no_rendering(monkeypatch)
    notes: list[str] = []
    paths = draw_all(paper_lens, tmp_path / "new", ("png", "svg"), warn=notes.append)
    names = [f"{n}.{f}" for n in ("layout", "spots", "incidence", "spread") for f in ("png", "svg")]
    assert [p.name for p in paths] == names
    assert sorted(p.name for p in (tmp_path / "new").iterdir()) == sorted(names)
    assert notes == ["3D view left out: no off-screen rendering on this machine"]
    for path in paths:
        if path.suffix == ".png":
            image = imread(path)
            assert image.shape[1] > 1500
            assert np.std(image) > 0.01
        else:
            assert ElementTree.parse(path).getroot().tag.endswith("svg")


def test_draw_all_warns_where_nobody_listens(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, paper_lens: Lens
) -> None:
    no_rendering(monkeypatch)
    with pytest.warns(UserWarning, match="3D view left out"):
        draw_all(paper_lens, tmp_path, ("svg",))


def test_draw_all_with_rendering(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, paper_lens: Lens) -> None:
    monkeypatch.setattr(plots, "render_lens", lambda _, path: Path(path).write_bytes(b"picture"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        paths = draw_all(paper_lens, tmp_path)
    assert [p.name for p in paths] == ["layout.png", "spots.png", "incidence.png", "spread.png", "view3d.png"]
    assert all(p.exists() for p in paths)


def test_a_lens_that_does_not_close_has_no_3d_view(tmp_path: Path, paper_lens: Lens) -> None:
    notes: list[str] = []
    paths = draw_all(paper_lens.with_surface(0, thickness_mm=4.5), tmp_path, warn=notes.append)
    assert [p.name for p in paths] == ["layout.png", "spots.png", "incidence.png", "spread.png"]
    assert len(notes) == 1
    assert "edge thickness is -0." in notes[0]


@pytest.mark.parametrize("formats", [("bmp",), ("png", "pdf"), ()])
def test_unknown_formats(tmp_path: Path, paper_lens: Lens, formats: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="png, svg"):
        draw_all(paper_lens, tmp_path, formats)
    assert not list(tmp_path.iterdir())


def test_save_figure_knows_two_suffixes(tmp_path: Path, paper_lens: Lens) -> None:
    with pytest.raises(InputError, match=r"\.png, \.svg"):
        write_figure(layout_figure(paper_lens), tmp_path / "layout.jpg")


def test_a_folder_that_cannot_be_made(tmp_path: Path, paper_lens: Lens) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        draw_all(paper_lens, tmp_path / "file")


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_the_same_lens_gives_the_same_file(tmp_path: Path, paper_lens: Lens, suffix: str) -> None:
    for name in "ab":
        write_figure(layout_figure(paper_lens), tmp_path / f"{name}.{suffix}")
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_no_pyplot_and_no_changed_settings(tmp_path: Path, paper_design: Path) -> None:
    code = (
        "import sys, lensdesign, lensdesign.plots.plots as p; assert 'matplotlib' not in sys.modules;"
        "assert 'pyvista' not in sys.modules; import matplotlib; before = matplotlib.rcParams.copy();"
        "f = p.layout_figure(lensdesign.load_design(sys.argv[1])); p.write_figure(f, 'a.svg');"
        "assert matplotlib.rcParams.copy() == before; assert 'matplotlib.pyplot' not in sys.modules"
    )
    command = [sys.executable, "-c", code, str(paper_design)]
    assert subprocess.run(command, cwd=tmp_path, check=False).returncode == 0
