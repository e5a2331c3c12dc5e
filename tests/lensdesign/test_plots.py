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
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.collections import LineCollection
from matplotlib.image import imread
from matplotlib.patches import Polygon

from lensdesign import Lens, plots
from lensdesign.analysis import rms_spot_diameter
from lensdesign.errors import InputError
from lensdesign.plots import draw_all, incidence_figure, layout_figure, save_figure, spot_figure
from lensdesign.ray_paths import FIELD_COLORS
from lensdesign.scene3d import RenderingError


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
    planes = [line.get_xydata() for line in axes.lines if line.get_linewidth() == 2.0][:3]
    expected = [[[z, -half], [z, half]] for z, half in ((-13.5, 1.5), (11.7, 11.2), (31.7, 11.2))]
    assert np.array(planes) == pytest.approx(np.array(expected))
    texts = {t.get_text() for t in axes.texts}
    assert {"object\n⌀ 3 mm", "$H_{1}$ = 2 mm", "$H_{2}$ = 22 mm", "stop", "5 mm"} == texts


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


def test_labels_lie_within_the_figure_and_do_not_overlap(paper_lens: Lens, triplet: Lens) -> None:
    for lens in (paper_lens, triplet):
        figure = layout_figure(lens)
        FigureCanvasAgg(figure).draw()
        boxes = [t.get_window_extent() for t in figure.axes[0].texts]
        boxes += [legend.get_window_extent() for legend in figure.legends]
        for i, box in enumerate(boxes):
            assert figure.bbox.count_contains(box.corners()) == 4
            assert not any(box.overlaps(other) for other in boxes[:i])


def test_spot_diameters_are_those_of_the_analysis(paper_lens: Lens) -> None:
    figure = spot_figure(paper_lens)
    titles = [axes.get_title() for axes in figure.axes]
    shown = [float(re.search(r"([\d.]+) mm$", t)[1]) for t in titles]  # type: ignore[index]
    assert shown == [14.27, 14.26, 14.22]
    for axes, height, color in zip(figure.axes, (0.0, 0.75, 1.5), FIELD_COLORS, strict=True):
        (dots,) = axes.lines
        assert dots.get_color() == color
        points = np.stack(dots.get_data(), axis=-1)
        # Even filling by rings counts the rim in full, so it comes out a little larger.
        drawn = 2.0 * np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=-1)))
        assert drawn == pytest.approx(rms_spot_diameter(paper_lens, None, height).rms_diameter_mm, rel=0.03)


def test_spots_state_what_is_lost(paper_lens: Lens) -> None:
    figure = spot_figure(paper_lens.with_surface(1, semi_diameter_mm=8.3))
    assert all(re.search(r"6\d\.\d % pass", axes.get_title()) for axes in figure.axes)


def test_spots_on_another_plane(paper_lens: Lens) -> None:
    title = spot_figure(paper_lens, plane_distance_mm=22.0).axes[0].get_title()
    expected = rms_spot_diameter(paper_lens, None, 0.0, 22.0).rms_diameter_mm
    assert title.endswith(f"{expected:.2f} mm")


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
    paths = draw_all(paper_lens, tmp_path / "new", ("png", "svg"), report=notes.append)
    names = [f"{n}.{f}" for n in ("layout", "spots", "incidence") for f in ("png", "svg")]
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
        draw_all(paper_lens, tmp_path)


def test_draw_all_with_rendering(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, paper_lens: Lens) -> None:
    monkeypatch.setattr(plots, "render_lens", lambda _, path: Path(path).write_bytes(b"picture"))
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        paths = draw_all(paper_lens, tmp_path)
    assert [p.name for p in paths] == ["layout.png", "spots.png", "incidence.png", "view3d.png"]
    assert all(p.exists() for p in paths)


def test_a_lens_that_does_not_close_has_no_3d_view(tmp_path: Path, paper_lens: Lens) -> None:
    notes: list[str] = []
    paths = draw_all(paper_lens.with_surface(0, thickness_mm=4.5), tmp_path, report=notes.append)
    assert [p.name for p in paths] == ["layout.png", "spots.png", "incidence.png"]
    assert len(notes) == 1
    assert "edge thickness is -0." in notes[0]


@pytest.mark.parametrize("formats", [("bmp",), ("png", "pdf"), ()])
def test_unknown_formats(tmp_path: Path, paper_lens: Lens, formats: tuple[str, ...]) -> None:
    with pytest.raises(InputError, match="allowed are png, svg"):
        draw_all(paper_lens, tmp_path, formats)
    assert not list(tmp_path.iterdir())


def test_save_figure_knows_two_suffixes(tmp_path: Path, paper_lens: Lens) -> None:
    with pytest.raises(InputError, match=r"allowed suffixes are \.png, \.svg"):
        save_figure(layout_figure(paper_lens), tmp_path / "layout.jpg")


def test_a_folder_that_cannot_be_made(tmp_path: Path, paper_lens: Lens) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(InputError, match="cannot write"):
        draw_all(paper_lens, tmp_path / "file")


@pytest.mark.parametrize("suffix", ["png", "svg"])
def test_the_same_lens_gives_the_same_file(tmp_path: Path, paper_lens: Lens, suffix: str) -> None:
    for name in "ab":
        save_figure(layout_figure(paper_lens), tmp_path / f"{name}.{suffix}")
    assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


def test_no_pyplot_and_no_changed_settings(tmp_path: Path, paper_design: Path) -> None:
    code = (
        "import sys, lensdesign, lensdesign.plots as p; assert 'matplotlib' not in sys.modules;"
        "assert 'pyvista' not in sys.modules; import matplotlib; before = matplotlib.rcParams.copy();"
        "f = p.layout_figure(lensdesign.load_design(sys.argv[1])); p.save_figure(f, 'a.svg');"
        "assert matplotlib.rcParams.copy() == before; assert 'matplotlib.pyplot' not in sys.modules"
    )
    command = [sys.executable, "-c", code, str(paper_design)]
    subprocess.run(command, cwd=tmp_path, check=True)
