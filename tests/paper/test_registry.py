"""The paper's numbers, element by element, on the smallest twins; and the page in the documentation.

Elements that share what they compute stand in one class: a class goes to one worker.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from places import ROOT
from quick_verdicts import judge_quickly

from lensdesign import Lens, trace
from lensdesign.raytrace import launch
from paper import style
from paper.element import Made, Number
from paper.microscope import Objective
from paper.registry import ELEMENTS
from paper.results import Result
from paper.run import make_all
from wavesim import Field, Grid

ROOMS = [ROOT / "paper", *(path for path in (ROOT / "paper").rglob("*") if path.is_dir())]
PAGE, PICTURES = ROOT / "docs" / "paper.md", ROOT / "docs" / "images" / "paper"


class Results:
    """Elements, each made when it is first asked for."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.made: dict[str, Result] = {}

    def __getitem__(self, key: str) -> Result:
        """The result of an element, with small pictures and verdicts that are found sooner."""
        if key not in self.made:
            with pytest.MonkeyPatch.context() as patch:
                judge_quickly(patch)
                patch.setattr(style, "DOTS_PER_INCH", style.DOTS_PER_INCH[-1:])
                made = make_all(ELEMENTS, self.folder, "small", [key])
            self.made |= {result.key: result for result in made}
        return self.made[key]


@pytest.fixture(scope="session")
def results(tmp_path_factory: pytest.TempPathFactory) -> Results:
    """What this worker makes of the paper."""
    return Results(tmp_path_factory.mktemp("paper"))


def numbers(results: Results, key: str) -> dict[str, Number]:
    return {number.name: number for number in results[key].made.numbers}


def assert_numbers_and_commands(made: Made) -> None:
    """Every number is stated once, and there are commands that give the same."""
    assert made.commands
    assert made.difference
    assert len({number.name for number in made.numbers}) == len(made.numbers)


class TestLens:
    """The lens: what it is designed for, and the rays through it."""

    KEYS = (
        "equation-1",
        "equation-2",
        "table-1",
        "figure-2a",
        "figure-2b",
        "figure-2c",
        "figure-2d",
        "figure-2g",
    )

    @pytest.mark.parametrize("key", KEYS)
    def test_numbers_are_told_once_and_commands_are_there(self, key: str, results: Results) -> None:
        assert_numbers_and_commands(results[key].made)

    def test_the_products_and_the_limit_of_angles(self, results: Results) -> None:
        first, second = numbers(results, "equation-1"), numbers(results, "equation-2")
        assert first["SBP of the object"].here == pytest.approx(1.96155e7, rel=1e-5)
        assert first["SBP of the sensor"].here == pytest.approx(3.02257e7, rel=1e-5)
        assert first["resolution, λ / (2 NA)"].agrees
        assert second["limit of the angle, asin(λ / (2 Δ))"].here == pytest.approx(4.7682, abs=1e-4)
        assert second["largest angle behind the lens"].here == pytest.approx(4.8105, abs=1e-4)
        assert second["highest frequency of the pixels"].agrees

    def test_the_rim_of_the_stop_is_the_aperture(self, results: Results) -> None:
        table = numbers(results, "table-1")
        assert all(number.agrees is not False for number in table.values())
        assert table["sine of the ray through its rim: the aperture"].here == pytest.approx(0.5, abs=3e-4)
        assert table["index of N-BK7 at 0.532 µm"].here == pytest.approx(1.5194726, abs=1e-6)

    def test_the_search_meets_what_the_table_misses(self, results: Results) -> None:
        design, limit = numbers(results, "figure-2a"), 4.7682
        found = design["smallest that is found at its thickness, aperture and distance"].here
        printed = design["largest angle of the lens of Table 1"].here
        assert isinstance(found, float)
        assert found < limit < printed
        assert found == pytest.approx(4.643, abs=2e-3)

    def test_spots_have_the_papers_diameter(self, results: Results) -> None:
        spots = [number.here for number in results["figure-2c"].made.numbers]
        assert spots == pytest.approx([14.27, 14.25, 14.22], abs=0.01)

    def test_light_arrives_within_the_limit_and_with_the_radiance_of_its_source(
        self, results: Results, paper_lens: Lens
    ) -> None:
        """Isotropic sources have 1 / cos of their axial radiance; lenses without loss conserve it."""
        by_name = numbers(results, "figure-2d")
        heights = np.linspace(0.0, 1.0, 401)
        pupil = np.stack([np.zeros_like(heights), heights], axis=-1)
        origins, directions = launch(paper_lens, [(0.0, 0.0)], pupil, 0.532)
        rays = trace(paper_lens, origins, directions, 0.532, plane_z_mm=paper_lens.exit_vertex_z_mm + 3.0)
        for point in (0, 3, 7, 9):
            assert by_name[f"largest angle at (0, {point}) mm"].agrees
            cosine = np.interp(point, rays.position[:, 1], directions[:, 2])
            measured = by_name[f"radiance at (0, {point}) mm, over the source's along its axis"]
            rays_there = int(measured.remark.split()[0])
            # A ninth of the directions are averaged, and a little less than a ninth of the rays.
            assert measured.here == pytest.approx(1.0 / cosine, rel=4.0 * (rays_there / 9) ** -0.5)

    def test_the_example_of_measured_surfaces_has_the_papers_errors(self, results: Results) -> None:
        by_name = numbers(results, "figure-2g")
        assert by_name["peak-to-valley of the entrance surface"].agrees
        assert by_name["peak-to-valley of the exit surface"].agrees
        waves = by_name["wavefront that they leave, 0 mm off the axis"].here
        ratio = by_name["Strehl ratio of the reconstruction there, 0 mm off the axis"].here
        assert isinstance(waves, float)
        assert ratio == pytest.approx(np.exp(-((2.0 * np.pi * waves) ** 2)), abs=5e-3)  # Marechal


class TestMethod:
    """How fields pass the lens, and what tilts and slices do to them."""

    KEYS = ("figure-3", "figure-4", "equation-5", "figure-7a", "figure-7bc", "equation-b1", "figure-11")

    @pytest.mark.parametrize("key", KEYS)
    def test_numbers_are_told_once_and_commands_are_there(self, key: str, results: Results) -> None:
        assert_numbers_and_commands(results[key].made)

    def test_slices_are_cut_as_the_surfaces_lie(self, results: Results, paper_lens: Lens) -> None:
        """Planes and radii of one slice against the sag, and the gain of Eq. 4 against its thickness."""
        by_name = numbers(results, "figure-4")
        back, index = paper_lens.surfaces[1], paper_lens.indices(0.532)[1]
        here = {name: number.here for name, number in by_name.items()}
        near, far = (
            here["its plane z_p, from the exit vertex"],
            here["its plane z_(p+1), from the exit vertex"],
        )
        inner, outer = here["inner radius R_p of its annulus"], here["outer radius R_(p+1) of its annulus"]
        assert isinstance(near, float)
        assert isinstance(far, float)
        assert back.sag_mm(np.array([inner, outer])) == pytest.approx([near, far], abs=1e-6)
        gained = here["compensation over it: glass in place of air"]
        assert gained == pytest.approx((index - 1.0) * (near - far) / 0.532e-3, rel=1e-9)
        assert by_name["slices of each surface"].agrees
        assert here["largest error of vertical compensation in one slice"] > 1.0
        assert here["largest error of oblique compensation in one slice"] < 1e-3

    def test_constants_of_the_retrieval_are_the_papers(self, results: Results) -> None:
        assert [n.name for n in results["figure-3"].made.numbers if n.agrees is False] == []
        assert sum(n.agrees is True for n in results["figure-3"].made.numbers) == 6

    def test_the_virtual_plane_lies_in_the_glass(self, results: Results) -> None:
        by_name = numbers(results, "figure-11")
        virtual = by_name["virtual plane z_temp: where the exit slices are summed"].here
        entrance = by_name["first cutting plane of the entrance surface"].here
        assert isinstance(virtual, float)
        assert entrance < virtual < 0.0

    def test_chirps_take_a_beam_to_other_samples(self, results: Results) -> None:
        by_name = numbers(results, "equation-b1")
        assert by_name["relative error against the closed form of a Gaussian beam"].here < 1e-3
        wanted = by_name["what the Fourier transform needs, 2π f x"].here
        assert by_name["sum of π[l x² + f²/l − (l x − f)²/l]"].here == pytest.approx(wanted)

    def test_a_chart_is_found_where_it_stands(self, results: Results) -> None:
        by_name = numbers(results, "equation-5")
        assert by_name["found too far by"].here == pytest.approx(by_name["true"].here, abs=0.05)

    def test_slices_help_wide_lines_at_once_and_fine_ones_only_if_oblique(self, results: Results) -> None:
        by_name = numbers(results, "figure-7a")
        assert by_name["gain from 10 to 30 slices, 1.55 µm, vertical"].here > 0.1
        assert abs(by_name["gain from 30 to 50 slices, 1.55 µm, vertical"].here) < 0.05
        assert by_name["contrast of 0.775 µm lines, 50 slices, vertical"].here < 0.2
        assert by_name["contrast of 0.775 µm lines, 10 slices, oblique"].here > 0.9

    def test_tilt_blurs_fine_lines_and_decenter_does_not(self, results: Results) -> None:
        by_name = numbers(results, "figure-7bc")
        assert by_name["contrast of 0.775 µm lines, decenter 0.05 mm"].here > 0.9
        assert by_name["contrast of 0.775 µm lines, tilt 0.5°"].here < 0.75
        assert by_name["contrast of 1.55 µm lines, tilt 0.5°"].here > 0.9

    def test_a_tilt_about_the_exit_vertex_loses_fine_lines_where_nothing_is_refocused(
        self, results: Results
    ) -> None:
        by_name = numbers(results, "figure-7bc")
        name = "contrast of {} µm lines, tilt {}° about the {}, {}"
        assert by_name[name.format(0.775, 0.5, "exit vertex", "refocused")].here > 0.7
        assert by_name[name.format(0.775, 0.5, "exit vertex", "not refocused")].here < 0.2
        assert by_name[name.format(0.775, 0.3, "exit vertex", "not refocused")].here > 0.7
        assert by_name[name.format(1.55, 0.5, "exit vertex", "not refocused")].here > 0.8
        lost = "lines of 0.775 µm resolved at a tilt of 0.5° about the exit vertex, not refocused"
        assert by_name[lost].here == "no"


class TestRetrieval:
    """The field behind the lens, found from intensities."""

    KEYS = ("figure-1", "figure-2e", "figure-8", "figure-9", "figure-10")

    @pytest.mark.parametrize("key", KEYS)
    def test_numbers_are_told_once_and_commands_are_there(self, key: str, results: Results) -> None:
        assert_numbers_and_commands(results[key].made)

    def test_only_a_good_start_leads_to_the_chart_and_a6_does_not_tell(self, results: Results) -> None:
        by_name = numbers(results, "figure-8")
        model, even, random = (
            by_name[f"correlation of the object, start: {start}"].here
            for start in ("forward model", "even phase", "random phase")
        )
        assert model > 0.5
        assert max(even, random) < 0.3
        assert all(
            by_name[f"correlation A6, start: {start}"].here > 0.98
            for start in ("forward model", "even phase")
        )
        assert numbers(results, "figure-10")["correlation A6 at the end"].agrees
        frames = "from frames: correlation {}, start: {}"
        assert by_name[frames.format("of the object", "forward model")].here > 2.0 * max(
            by_name[frames.format("of the object", start)].here for start in ("even phase", "random phase")
        )
        assert by_name[frames.format("A6", "even phase")].here > 0.95

    def test_spectra_end_at_the_circle_of_the_pixels(self, results: Results) -> None:
        by_name = numbers(results, "figure-2e")
        for name in ("USAF chart", "tissue"):
            assert by_name[f"energy beyond it in the light itself, {name}"].here < 1e-3
            assert by_name[f"energy beyond 156.25 lp/mm, {name}, retrieved"].here < 0.02


class TestObjects:
    """Charts and tissue, found from frames."""

    KEYS = ("figure-5", "figure-5-at-size", "figure-6")

    @pytest.mark.parametrize("key", KEYS)
    def test_numbers_are_told_once_and_commands_are_there(self, key: str, results: Results) -> None:
        assert_numbers_and_commands(results[key].made)

    def test_brackets_bring_the_lens_more_than_one_exposure(self, results: Results) -> None:
        by_name = {name: number.here for name, number in numbers(results, "figure-5-at-size").items()}
        name = "correlation with the object: {}"
        assert (
            by_name[name.format("three exposures")] > by_name[name.format("one exposure, the paper's")] + 0.1
        )

    def test_the_chart_comes_back_with_the_lens_and_coarser_without(self, results: Results) -> None:
        """By the aperture, and by the pixels of a camera without lens: 7-2 is the last below 156 lp/mm."""
        by_name = numbers(results, "figure-5")
        assert by_name["correlation with the object, in the object domain"].here > 0.9
        assert by_name["with the lens, in the object domain: finest element"].here.startswith("9-")
        assert by_name["without the lens: finest element"].here[:3] in ("7-2", "7-3")
        assert by_name["correlation with the object, thin lens"].here < 0.5

    def test_tissue_is_seen_as_by_the_larger_objective(self, results: Results) -> None:
        by_name = numbers(results, "figure-6")
        assert by_name["correlation with the tissue, complex"].here > 0.8
        high = by_name["with the 20× objective's, condenser 0.7 NA"].here
        assert high > 0.9
        assert high > by_name["with the 2× objective's, condenser 0.7 NA"].here + 0.02
        assert by_name["that over the 20× objective's 1.25 mm"].agrees


class TestOtherWays:
    """Appendix A on frames, and what the paper leaves to later work."""

    KEYS = ("the-papers-way", "discussion")

    @pytest.mark.parametrize("key", KEYS)
    def test_numbers_are_told_once_and_commands_are_there(self, key: str, results: Results) -> None:
        assert_numbers_and_commands(results[key].made)

    def test_appendix_a_wants_other_frames_and_oblique_slices(self, results: Results) -> None:
        by_name = {name: number.here for name, number in numbers(results, "the-papers-way").items()}
        correlation = {
            name.partition(": ")[2]: here for name, here in by_name.items() if name.startswith("corr")
        }
        assert correlation["one exposure, two planes: the paper's"] < 0.4
        best = correlation["the same, pixels that are points"]
        assert best > 0.8
        assert correlation["back by the eikonal engine"] == pytest.approx(best)
        vertical, oblique = (
            correlation[f"back by 4 {kind} slices, as thick as the paper's 200"]
            for kind in ("vertical", "oblique")
        )
        assert vertical < oblique - 0.2

    def test_what_is_left_to_later_work_has_numbers(self, results: Results) -> None:
        by_name = {name: number.here for name, number in numbers(results, "discussion").items()}
        assert by_name["calibration: decenter found"] == pytest.approx(
            by_name["calibration: decenter put"], abs=0.3
        )
        assert (
            by_name["calibration: misfit with what is found"]
            < 1.2 * by_name["calibration: misfit of the noise alone"]
        )
        shot = "single shot, {} object: correlation from one plane"
        assert by_name[shot.format("amplitude")] > 0.88 > by_name[shot.format("complex")]
        confined = by_name[f"{shot.format('complex')}, confined to 0.6 of the field's diameter"]
        assert confined > by_name[shot.format("complex")] + 0.05
        assert by_name["moulded plastic asphere: largest angle behind it over the limit"] <= 1.0


def test_an_objective_passes_its_aperture_and_no_more() -> None:
    """Fringes of a grating: within the aperture in full, less through a condenser, beyond it none."""
    grid = Grid((128, 128), 0.25e-3, 0.0)
    fringes = 4.0 / (128 * 0.25e-3)  # lp/mm
    wave = 1.0 + 0.5 * np.cos(2.0 * np.pi * fringes * grid.x_mm) * np.ones((128, 1))
    behind = Field(grid, wave.astype(complex), 0.532)
    wide, narrow = Objective("wide", 0.2), Objective("narrow", 0.05)
    assert wide.coherent(behind) == pytest.approx(wave**2, abs=1e-9)
    assert narrow.coherent(behind) == pytest.approx(1.0, abs=1e-9)
    assert wide.partially_coherent(behind, 1e-9) == pytest.approx(wide.coherent(behind), abs=1e-6)
    assert np.std(wide.partially_coherent(behind, 0.9)) < 0.95 * np.std(wide.coherent(behind))


def test_the_page_has_every_element_as_it_is_now() -> None:
    page = PAGE.read_text(encoding="utf-8")
    for key, element in ELEMENTS.items():
        assert f"## {element.title}\n\n**The paper.** {element.statement}\n" in page, key


def test_pictures_are_small_and_all_are_shown() -> None:
    page, kept = PAGE.read_text(encoding="utf-8"), sorted(PICTURES.glob("*"))
    assert all(path.stat().st_size < 150_000 for path in kept)
    assert sum(path.stat().st_size for path in kept) < 2_500_000
    for path in kept:
        assert f"(images/paper/{path.name})" in page, path.name


@pytest.mark.parametrize("room", ROOMS, ids=lambda path: path.name)
def test_rooms_are_small_and_modules_short(room: Path) -> None:
    names = {path.name for path in room.iterdir()} - {"__init__.py", "__pycache__"}
    assert len(names) <= 15
    for path in room.glob("*.py"):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 400, path


def test_every_element_is_tested() -> None:
    classes = (TestLens, TestMethod, TestRetrieval, TestObjects, TestOtherWays)
    assert sorted(key for one in classes for key in one.KEYS) == sorted(ELEMENTS)
