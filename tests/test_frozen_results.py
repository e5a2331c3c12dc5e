"""Literal results of all packages: a change of names or structure must not change any of them.

The values were computed by this toolkit. They do not show that a result is right; the tests of the single
modules compare with closed forms and data of others. A commit that changes a value here says why.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from benchmarks.layers import bench, field_behind, recorded_frames, true_layer
from lensdesign import (
    Lens,
    Pose,
    check_design,
    launch,
    lens_drawing,
    load_design,
    load_specification,
    optimize,
    pupil_hexapolar,
    scaled,
    trace,
)
from tolerancing import load_study, open_store, run_study, summarize
from wavesim import (
    Frame,
    FrameSettings,
    calibrate_frames,
    engine_for,
    image,
    reconstruct_colours,
    reconstruct_frames,
    reconstruct_layers,
)
from wavesim.calibration.free_space import DEFAULT_FRAME_SETTINGS, reconstruct_free_space
from wavesim.fields.field import Field
from wavesim.scene.patches import patch_scene

FIELD_DIGITS = 1e-9
"""Relative difference that compilers and processors may cause in rays and figures made of them."""

ENGINE_DIGITS = 1e-5
"""Relative difference that they may cause in a propagated field; some kernels work in single precision."""

ITERATED_DIGITS = 1e-3
"""Relative difference that they may cause after many iterations, which may also be one more or one fewer."""


RAYS = [
    [
        4.84782079105,
        8.27382244002,
        5.81678211512,
        -0.000710983809499,
        -0.00753690514491,
        0.999971344371,
        24.4032758967,
    ],
    [
        -4.70602114174,
        8.27401995832,
        5.85043231697,
        0.00798324713764,
        -0.00752202511258,
        0.999939841642,
        24.4021425554,
    ],
    [-9.48311318679, 0.0, 5.86725804815, 0.0123174758517, 0.0, 0.999924137017, 24.4015758559],
    [
        -4.70602114174,
        -8.27401995832,
        5.85043231697,
        0.00798324713764,
        0.00752202511258,
        0.999939841642,
        24.4021425554,
    ],
    [
        4.84782079105,
        -8.27382244002,
        5.81678211512,
        -0.000710983809499,
        0.00753690514491,
        0.999971344371,
        24.4032758967,
    ],
    [
        4.88958009162,
        8.08632739951,
        5.93161018875,
        0.00143665924391,
        -0.0678000145159,
        0.997697897182,
        24.0422332163,
    ],
    [
        -4.74693492743,
        8.08651115308,
        5.96558297845,
        0.00582681815377,
        -0.0677900210333,
        0.997682595437,
        24.0410766688,
    ],
    [
        -9.47938106683,
        -0.247334368368,
        5.86767976831,
        0.0141074403451,
        -0.0623686383608,
        0.9979534724,
        24.453277322,
    ],
    [
        -4.66548476265,
        -8.43980724853,
        5.74764505982,
        0.01187361701,
        -0.0465821157242,
        0.998843893566,
        24.8567388813,
    ],
    [
        4.80652610362,
        -8.43960094533,
        5.71431031229,
        -0.00461664732785,
        -0.0465638818529,
        0.998904645837,
        24.8578407936,
    ],
]

SHEET = {
    "efl_mm": 19.1657946819,
    "bfl_mm": 17.6632480436,
    "sbp_object": 19615483.0531,
    "sbp_sensor": 30225663.4783,
    "max_spread_deg": 4.8105019091,
    "throughput": 1.0,
    "drawn items": 210,
}

SPOTS_MM = (14.2724651919, 14.2597403075, 14.221687786)

OPTIMUM = {"radius_1_mm": 37.5904610026, "radius_2_mm": -11.9136162111, "conic_2": -1.12960609747}

FIELDS = {
    "eikonal": {
        "energy": 1.71047513653e-05,
        "x_mm": 0.167212362716,
        "y_mm": 0.000553682004099,
        "peak": 0.0285949271997,
        "autocorrelation, real": 1.66640629657e-05,
        "autocorrelation, imaginary": 1.80861503806e-06,
    },
    "hierarchical": {
        "energy": 1.71303236129e-05,
        "x_mm": 0.167253371474,
        "y_mm": 0.000544024862377,
        "peak": 0.0286056157202,
        "autocorrelation, real": 1.6724847228e-05,
        "autocorrelation, imaginary": 1.85507281003e-06,
    },
    "slices": {
        "energy": 1.58724288461e-05,
        "x_mm": 0.166331555377,
        "y_mm": 0.000546270121093,
        "peak": 0.0269363223273,
        "autocorrelation, real": 1.50272629163e-05,
        "autocorrelation, imaginary": 2.26903956916e-06,
    },
    "wpm": {
        "energy": 1.70389465732e-05,
        "x_mm": 0.0628680915852,
        "y_mm": 0.000121796151213,
        "peak": 0.189181020384,
        "autocorrelation, real": 1.51187849641e-05,
        "autocorrelation, imaginary": 1.70495067334e-06,
    },
    "thin-lens": {
        "energy": 1.88385998151e-05,
        "x_mm": 0.178572410803,
        "y_mm": 0.00067096380778,
        "peak": 0.0243118792169,
        "autocorrelation, real": 6.55485918125e-06,
        "autocorrelation, imaginary": -1.68549223918e-05,
    },
    "no-lens": {
        "energy": 8.40851344564e-09,
        "x_mm": 0.215665446761,
        "y_mm": 0.000999999986722,
        "peak": 3.39247121258e-05,
        "autocorrelation, real": 3.68995587798e-09,
        "autocorrelation, imaginary": -4.56674444462e-09,
    },
}

STUDY = {
    "yield": 0.708333333333,
    "contrast_0p775um": 0.961759674813,
    "contrast_1p55um": 0.964536865672,
    "strehl": 0.653886375096,
    "largest_spread_deg": 4.85398701968,
}

CHAIN = {
    "counts": 1316383.0,
    "correlation": 0.963522611818,
    "misfit": 0.145826881779,
    "found decenter": 0.00100347811496,
    "standard deviation": 7.186437035249e-06,
}


COLOURS = {
    "counts": 802058,
    "misfit": 0.0770443059648,
    "held out": 1.2441828672,
    "correlation 1": 0.971946090125,
    "correlation 2": 0.981662242569,
    "misfit of a film": 0.0643603985739,
    "deviation of heights": 0.013559213785,
}

LAYERS = {
    "counts": 704557,
    "misfit": 0.0720878733858,
    "scale": 2.05236908576,
    "correlation 1": 0.584971218015,
    "correlation 2": 0.730039848468,
}

SOURCE = {
    "counts": 1300271,
    "misfit": 0.0714564788345,
    "correlation": 0.995032057275,
}

FREE_SPACE = {
    "distance scale": 1.02445047313,
    "misfit": 0.0120959045967,
    "amplitude": 59.8420257568,
}

KNOWN_OBJECT = {
    "decenter_x_mm": 0.00100296962517,
    "working_distance_mm": 5.8451880501e-05,
}


@pytest.fixture(scope="module")
def twin() -> Lens:
    """A small twin of the paper's lens."""
    return scaled(load_design("designs/paper_singlet.toml"), 1 / 48)


def rays(lens: Lens) -> list[list[float]]:
    """Position (mm), direction and optical path (mm) of ten rays through a displaced lens."""
    pose = Pose(decenter_x_mm=0.05, tilt_y_deg=0.2)
    pupil = pupil_hexapolar(1).points[2:]
    starts, directions = launch(lens, [[0.0, 0.0], [0.0, 1.2]], pupil, 0.532, pose)
    traced = trace(lens, starts, directions, 0.532, pose)
    columns = [traced.position, traced.direction, traced.opl[..., None]]
    return np.concatenate(columns, axis=-1).reshape(-1, 7).tolist()


def sheet(lens: Lens) -> dict[str, float]:
    """Figures of a design's check, and how many items its drawing has."""
    found, drawing = check_design(lens), lens_drawing(lens)
    return {
        "efl_mm": found.efl_mm,
        "bfl_mm": found.bfl_mm,
        "sbp_object": found.sbp_object,
        "sbp_sensor": found.sbp_sensor,
        "max_spread_deg": found.max_spread_deg,
        "rms_spot_diameter_mm": found.rms_spot_diameter_mm,
        "throughput": found.throughput,
        "drawn items": len(drawing.sheets[0].items),
    }


def optimum() -> dict[str, float]:
    """The goal and two variables of a search."""
    found = optimize(load_specification("designs/feasible_singlet_spec.toml"))
    first, second = found.lens.surfaces
    return {"radius_1_mm": first.radius_mm, "radius_2_mm": second.radius_mm, "conic_2": second.conic}


def exit_field(lens: Lens, name: str) -> dict[str, float]:
    """Energy, centre and one phase of the field that an engine carries to the sensor."""
    scene = patch_scene(lens, 0.02, plane_distance_mm=0.1)
    engine = engine_for(scene, name)
    y, x = scene.object_grid.y_mm[:, None], scene.object_grid.x_mm
    values = np.exp(-((x / 4e-3) ** 2) - ((y - 1e-3) / 3e-3) ** 2 + 20j * x / 4e-3) + 0j
    found = engine.forward(Field(scene.object_grid, values, scene.wavelength_um))
    power = np.abs(found.values) ** 2
    rows, columns = found.grid.y_mm, found.grid.x_mm
    neighbours = np.vdot(found.values[:, :-1], found.values[:, 1:]) * found.grid.cell
    return {
        "energy": float(power.sum() * found.grid.cell),
        "x_mm": float(np.sum(power * columns) / power.sum()),
        "y_mm": float(np.sum(power * rows[:, None]) / power.sum()),
        "peak": float(power.max()),
        "autocorrelation, real": float(neighbours.real),
        "autocorrelation, imaginary": float(neighbours.imag),
    }


def chain(lens: Lens) -> dict[str, float]:
    """Frames of a star, its reconstruction, and the mounting that a calibration finds."""
    made = image(
        lens, "star", patch_mm=0.03, exposures=(1.0, 30.0), engine="eikonal", error=0.1, decenter_x_mm=1e-3
    )
    settings = {"patch_mm": 0.03, "kind": "amplitude", "error": 0.1}
    found = reconstruct_frames(lens, made.frames, truth=made.target.transmission, **settings)
    bench = calibrate_frames(
        lens, made.frames, parameters="decenter_x_mm", most_mountings=8, verdict="none", **settings
    )
    return {
        "counts": float(made.frames[0].counts.sum()),
        "correlation": found.truth["object_correlation"],
        "misfit": found.curve[-1],
        "found decenter": bench.values[0],
        "standard deviation": bench.deviations[0],
    }


def colours(lens: Lens) -> dict[str, float]:
    """An object at two wavelengths, from frames behind a filter mosaic, and a film's height from others."""
    patch: dict[str, Any] = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    light: dict[str, Any] = {"wavelengths_um": (0.532, 0.635), "planes_mm": (0.03, 0.15, 0.3)}
    made = image(lens, "star", exposures=(1.0, 30.0), colour_filters="bayer", **light, **patch)
    found = reconstruct_colours(
        lens, made.frames, kind="amplitude", truth=made.coloured, iterations=25, **patch
    )
    in_turn = image(lens, "star", exposures=(1.0, 30.0), **light, **patch)
    film = reconstruct_colours(
        lens, in_turn.frames, kind="thickness", film_index=1.5, iterations=10, repeats=2, **patch
    )
    assert film.heights is not None
    return {
        "counts": float(made.frames[0].counts.sum()),
        "misfit": found.misfit[-1],
        "held out": found.held_out_over_noise,
        "correlation 1": found.truth[0]["object_correlation"] or 0.0,
        "correlation 2": found.truth[1]["object_correlation"] or 0.0,
        "misfit of a film": film.misfit[-1],
        "deviation of heights": float(np.median(film.heights.deviation_um[film.patch.inside])),
    }


def layers() -> dict[str, float]:
    """Two layers, from frames that an independent model has made."""
    lens, patch = bench(0.016)
    true = [true_layer(patch, "amplitude", "sparse", seed) for seed in (1, 2)]
    behind = field_behind(patch, (-20.0, 0.0), true)
    frames = recorded_frames(lens, patch, behind, [0.2, 0.3], 0)
    settings: dict[str, Any] = {"kind": "amplitude", "patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    truth = [behind.with_values(one * patch.inside) for one in true]
    found = reconstruct_layers(
        lens, frames, (-20.0, 0.0), truth=truth, field_stop_mm=0.016, iterations=15, **settings
    )
    return {
        "counts": float(frames[0].counts.sum()),
        "misfit": found.curve[-1],
        "scale": found.scale,
        "correlation 1": found.truth[0]["object_correlation"] or 0.0,
        "correlation 2": found.truth[1]["object_correlation"] or 0.0,
    }


def source(lens: Lens) -> dict[str, float]:
    """An object in the light of a wide source with a bandwidth."""
    patch: dict[str, Any] = {"patch_mm": 0.03, "engine": "eikonal", "error": 0.1}
    made = image(lens, "tissue", exposures=(1.0, 30.0), source_deg=0.3, **patch)
    found = reconstruct_frames(
        lens,
        made.frames,
        truth=made.target.transmission,
        kind="complex",
        iterations=10,
        verdict="none",
        source_deg=0.3,
        bandwidth_nm=1.0,
        **patch,
    )
    return {
        "counts": float(made.frames[0].counts.sum()),
        "misfit": found.curve[-1],
        "correlation": found.truth["object_correlation"] or 0.0,
    }


def free_space() -> dict[str, float]:
    """A field behind a stack of frames, with the stage's scale and drift."""
    cycles = np.fft.fftfreq(96, 0.4)
    random, squared = np.random.default_rng(3), cycles[:, None] ** 2 + cycles**2
    soft = np.fft.ifft2(np.fft.fft2(random.standard_normal((96, 96))) * np.exp(-squared / 0.06)).real
    spectrum = np.fft.fft2(np.exp(0.5j * soft / soft.std()))
    frames = list[Frame]()
    for z_um in (10.0, 25.0, 45.0):
        carried = np.fft.ifft2(spectrum * np.exp(2j * np.pi * 1.02 * z_um * np.sqrt(4.0 - squared)))
        counts = random.poisson(4000.0 * np.abs(carried) ** 2).astype(np.uint16)
        stated = FrameSettings(
            pixel_pitch_um=0.4, wavelength_um=0.5, plane_distance_mm=1e-3 * z_um, **DEFAULT_FRAME_SETTINGS
        )
        frames.append(Frame(counts, stated))
    found = reconstruct_free_space(frames, calibrates=True, iterations=20)
    return {
        "distance scale": found.distance_scale,
        "misfit": found.misfit[-1],
        "amplitude": float(found.amplitude(0.035).mean()),
    }


def known_object(lens: Lens) -> dict[str, float]:
    """The mounting that frames of a known object determine."""
    settings: dict[str, Any] = {"patch_mm": 0.03, "error": 0.1}
    made = image(lens, "star", exposures=(1.0, 30.0), engine="eikonal", decenter_x_mm=1e-3, **settings)
    names = "decenter_x_mm,working_distance_mm"
    found = calibrate_frames(
        lens, made.frames, known=made.target.transmission, parameters=names, most_mountings=8, **settings
    )
    return dict(zip(found.parameters, found.values, strict=True))


def tolerances(store: Path) -> dict[str, float]:
    """Means and deviations of the merits of a short study, and its yield."""
    run_study(load_study("designs/paper_tolerances.toml"), store, trials=24, workers=1)
    with open_store(store) as opened:
        summary = summarize(opened)
    means = {merit.merit.column: merit.mean for merit in summary.merits}
    return {"yield": summary.good.fraction} | means


def test_rays(paper_lens: Lens) -> None:
    assert np.array(rays(paper_lens)) == pytest.approx(np.array(RAYS), rel=FIELD_DIGITS, abs=1e-12)


def test_sheet(paper_lens: Lens) -> None:
    found = sheet(paper_lens)
    assert found.pop("rms_spot_diameter_mm") == pytest.approx(SPOTS_MM, rel=FIELD_DIGITS)
    assert found == pytest.approx(SHEET, rel=FIELD_DIGITS)


def test_optimum() -> None:
    assert optimum() == pytest.approx(OPTIMUM, rel=1e-6)


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.filterwarnings("ignore::wavesim.SamplingWarning")
def test_exit_field(paper_lens: Lens, name: str) -> None:
    # The wave propagation method takes long through all but the smallest lens.
    lens = scaled(paper_lens, 1 / (128 if name == "wpm" else 48))
    assert exit_field(lens, name) == pytest.approx(FIELDS[name], rel=ENGINE_DIGITS)


def test_study(tmp_path: Path) -> None:
    assert tolerances(tmp_path / "store") == pytest.approx(STUDY, rel=FIELD_DIGITS)


@pytest.mark.filterwarnings("ignore:little diversity")
def test_chain(twin: Lens) -> None:
    assert chain(twin) == pytest.approx(CHAIN, rel=ITERATED_DIGITS)


@pytest.mark.filterwarnings("ignore:little diversity")
def test_colours(paper_lens: Lens) -> None:
    assert colours(scaled(paper_lens, 1 / 64)) == pytest.approx(COLOURS, rel=ITERATED_DIGITS)


def test_layers() -> None:
    assert layers() == pytest.approx(LAYERS, rel=ITERATED_DIGITS)


@pytest.mark.filterwarnings("ignore:little diversity")
def test_source(twin: Lens) -> None:
    assert source(twin) == pytest.approx(SOURCE, rel=ITERATED_DIGITS)


@pytest.mark.filterwarnings("ignore")
def test_free_space() -> None:
    assert free_space() == pytest.approx(FREE_SPACE, rel=ITERATED_DIGITS)


@pytest.mark.filterwarnings("ignore:little diversity")
def test_known_object(twin: Lens) -> None:
    assert known_object(twin) == pytest.approx(KNOWN_OBJECT, rel=ITERATED_DIGITS)
