"""What the paper's discussion leaves to later work: what there is of it here, with a figure each."""

from __future__ import annotations

from typing import Any

import numpy as np

from lensdesign import Lens, load_design, scaled
from lensdesign.analysis import check_design
from lensdesign.lens.surface_figure_source import SurfaceFigureSource
from lensdesign.lens.zernikes import zernike_orders
from paper.element import DESIGNS, PAPER_DESIGN, Budget, Element, Made, Number, Work
from paper.shots import BRACKET, ENGINE_ERROR, SEED, Shot, shot
from paper.twin import MARGIN, OBJECT_PITCH_UM, STOP_SHARE
from wavesim import calibrate_frames, engine_for, image, reconstruct_frames
from wavesim.metrics import resolve

PLASTIC = "phone_lens.toml"
"""One moulded asphere, for three wavelengths."""

SUPPORT_SHARE = 0.6
"""Of the field's diameter: the part to which the object is known to be confined."""

CODE_ORDERS, CODE_UM = 8, 0.1
"""Of the polynomials that stand for a coded surface; their root mean square together."""

FIRST_TWIN, LINES_UM, PAPER_SLICES = 1 / 16, 0.775, 200
DECENTER_MM, TILT_DEG = 2e-3, 0.3

SETTINGS: dict[Budget, dict[str, float]] = {
    "small": {"twin": 1 / 48, "iterations": 6},
    "quick": {"twin": 1 / 48, "iterations": 30},
    "full": {"twin": 1 / 16, "iterations": 60},
}


def discussion(work: Work) -> Made:
    """A number for each item."""
    scale, iterations = work.settings["twin"], int(work.settings["iterations"])
    work.progress("compensation")
    numbers = _compensation(work)
    work.progress("calibration")
    numbers += _calibration(shot(scale, "chart", BRACKET))
    work.progress("single shot")
    numbers += [
        Number(
            "single shot, amplitude object: correlation from one plane",
            _single(shot(scale, "chart", BRACKET), iterations),
        ),
        *_complex_shots(scaled(work.lens, scale), 2 * iterations),
    ]
    plastic = load_design(DESIGNS / PLASTIC)
    numbers += [
        Number("several wavelengths: shortest of the plastic lens", min(plastic.wavelengths_um), "µm"),
        Number("several wavelengths: longest of it", max(plastic.wavelengths_um), "µm"),
        Number(
            "moulded plastic asphere: largest angle behind it over the limit",
            (angles := check_design(plastic)).max_spread_deg / angles.spread_limit_deg,
            remark="one element of E48R, 1.13 mm thick",
        ),
        Number("less computation: 200 slices take so many times as long as tiles", _times(shot(scale))),
    ]
    return Made(tuple(numbers), COMMANDS, DIFFERENCE)


def _compensation(work: Work) -> list[Number]:
    """Slices as thick as 200 of the lens are, vertical and oblique."""
    lens, slices = scaled(work.lens, FIRST_TWIN), round(PAPER_SLICES * FIRST_TWIN)
    found = []
    for kind in ("vertical", "oblique"):
        line = resolve(lens, [LINES_UM], slices=slices, compensation=kind).lines[0]
        name = (
            f"compensation: {slices} {kind} slices on a lens 16 times as small, correlation of the exit field"
        )
        found.append(Number(name, line.exit_correlation))
    return found


def _calibration(like: Shot) -> list[Number]:
    """Frames of a lens off its axis, of the same chart; and where it is found."""
    chosen = like.imaged.settings
    patch: dict[str, Any] = {"patch_mm": chosen.patch_mm, "field_stop_mm": chosen.field_stop_mm}
    patch["object_pitch_um"] = chosen.object_pitch_um
    off = image(
        like.lens,
        "usaf",
        engine="eikonal",
        error=ENGINE_ERROR,
        seed=SEED,
        exposures=BRACKET,
        decenter_x_mm=DECENTER_MM,
        tilt_y_deg=TILT_DEG,
        **patch,
    )
    found = calibrate_frames(
        like.lens,
        off.frames,
        known=off.target.transmission,
        parameters="rigid",
        error=ENGINE_ERROR,
        **patch,
    )
    values = dict(zip(found.parameters, found.values, strict=True))
    return [
        Number("calibration: decenter put", 1e3 * DECENTER_MM, "µm"),
        Number("calibration: decenter found", 1e3 * values["decenter_x_mm"], "µm"),
        Number("calibration: tilt put", TILT_DEG, "°"),
        Number("calibration: tilt found", values["tilt_y_deg"], "°"),
        Number("calibration: misfit before", found.misfit_before),
        Number("calibration: misfit with what is found", found.misfit),
        Number(
            "calibration: misfit of the noise alone",
            found.misfit_of_noise or 0.0,
            remark="decenter and tilt of one lens have nearly the same effect, so they are least certain "
            "along this line",
        ),
    ]


def _complex_shots(lens: Lens, iterations: int) -> list[Number]:
    """Tissue from one plane: as it is, confined to a part of the field, and through a coded surface."""
    whole_mm = STOP_SHARE * lens.object.field_diameter_mm
    part_mm = SUPPORT_SHARE * whole_mm
    name = "single shot, complex object: correlation from one plane"
    return [
        Number(name, _one_plane(lens, whole_mm, iterations), remark="less than from four planes (Fig. 6)"),
        Number(
            f"{name}, confined to {SUPPORT_SHARE:g} of the field's diameter",
            _one_plane(lens, part_mm, iterations),
            remark="a known support gives as much information as further planes",
        ),
        Number(
            f"{name}, exit surface coded by {CODE_UM:g} µm rms",
            _one_plane(_coded(lens), whole_mm, iterations),
            remark="no gain; behind a stronger code rays fold, and fast engines reject it",
        ),
    ]


def _one_plane(lens: Lens, stop_mm: float, iterations: int) -> float:
    """Correlation of tissue in a field stop from frames of the first plane alone."""
    patch = {
        "patch_mm": min(MARGIN * STOP_SHARE, 1.0) * lens.object.field_diameter_mm,
        "field_stop_mm": stop_mm,
        "object_pitch_um": OBJECT_PITCH_UM,
    }
    how: dict[str, Any] = {"engine": "eikonal", "error": ENGINE_ERROR, **patch}
    first = lens.sensor.plane_distances_mm[:1]
    imaged = image(lens, "tissue", seed=SEED, planes_mm=first, exposures=BRACKET, **how)
    true = imaged.target.transmission
    found = reconstruct_frames(lens, imaged.frames, kind="complex", iterations=iterations, truth=true, **how)
    return found.truth["object_correlation"] or 0.0


def _coded(lens: Lens) -> Lens:
    """A lens whose exit surface has a smooth random map, which the reconstruction knows."""
    count = (CODE_ORDERS + 1) * (CODE_ORDERS + 2) // 2
    indices = [index for index in range(count) if zernike_orders(index)[0] >= 2]
    amounts = np.random.default_rng(SEED).standard_normal(len(indices))
    amounts *= CODE_UM / np.linalg.norm(amounts)
    *front, back = lens.surfaces
    code = SurfaceFigureSource(
        zernike_um=tuple(zip(indices, amounts.tolist(), strict=True)), semi_diameter_mm=back.semi_diameter_mm
    )
    return lens.model_copy(update={"surfaces": (*front, back.model_copy(update={"figure": code}))})


def _single(one: Shot, iterations: int) -> float:
    """Correlation of an amplitude object from the frames of the first plane alone."""
    chosen, first = one.imaged.settings, one.imaged.frames[0].settings.plane_distance_mm
    frames = [frame for frame in one.imaged.frames if frame.settings.plane_distance_mm == first]
    found = reconstruct_frames(
        one.lens,
        frames,
        kind="amplitude",
        engine="eikonal",
        error=ENGINE_ERROR,
        patch_mm=chosen.patch_mm,
        field_stop_mm=chosen.field_stop_mm,
        object_pitch_um=chosen.object_pitch_um,
        iterations=iterations,
    )
    return one.correlation(one.light.with_values(one.light.values * found.transmission.values))


def _times(one: Shot) -> float:
    """Predicted seconds of the paper's slices over those of eikonal tiles, on one scene."""
    slices = engine_for(one.case.engine.scene, "slices", slices=PAPER_SLICES, force=True)
    return slices.cost().seconds / one.case.engine.cost().seconds


DIFFERENCE = (
    "The toolkit has compensation with the light's own angles, calibration of tilt and decenter from the "
    "frames, and single shots of amplitude objects. It has lenses for several wavelengths and of "
    "plastic, images at all wavelengths by one command, and engines that need far less computation. A "
    "single shot of a complex object requires a known support that is smaller than the field. A code on "
    "the surface that is weak enough for rays adds nothing. A strong code, a second wavelength in one "
    "reconstruction, and ranges of frequency of each slice are not done."
)

COMMANDS = (
    "python -m paper --only discussion",
    f"lensdesign check designs/{PLASTIC}",
    f"wavesim image designs/{PLASTIC} --object tissue --patch-mm 0.05 --all-wavelengths -o colours",
)

DISCUSSION = Element(
    "discussion",
    "Discussion: what is left to later work",
    "The paper names a more accurate phase compensation, less computation, calibration of tilt and "
    "decenter by optimization, a single shot through a coded lens, several wavelengths, and moulded "
    "plastic aspheres.",
    discussion,
    SETTINGS,
    {"quick": 60.0, "full": 300.0},
    designs=(PAPER_DESIGN, PLASTIC),
)
