"""What the paper's discussion leaves to later work: what there is of it here, with a figure each."""

from __future__ import annotations

from typing import Any

from lensdesign import load_design, scaled
from lensdesign.analysis import check_design
from paper.element import DESIGNS, PAPER_DESIGN, Budget, Element, Made, Number, Work
from paper.shots import BRACKET, ENGINE_ERROR, SEED, Shot, shot
from wavesim import calibrate_frames, engine_for, image, reconstruct_frames
from wavesim.evaluation import resolve

PLASTIC = "moulded_pair.toml"
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
    work.tell("compensation")
    numbers = _compensation(work)
    work.tell("calibration")
    numbers += _calibration(shot(scale, "chart", BRACKET))
    work.tell("single shot")
    numbers += [
        Number(
            "single shot, amplitude object: correlation from one plane",
            _single(shot(scale, "chart", BRACKET), "amplitude", iterations),
        ),
        Number(
            "single shot, complex object: correlation from one plane",
            _single(shot(scale, "tissue", BRACKET, 4), "complex", iterations),
            remark="less than from four planes (Fig. 6); no second wavelength or code is tried",
        ),
    ]
    plastic = load_design(DESIGNS / PLASTIC)
    numbers += [
        Number("several wavelengths: shortest of a plastic design", min(plastic.wavelengths_um), "µm"),
        Number(
            "several wavelengths: longest of it",
            max(plastic.wavelengths_um),
            "µm",
            remark="an image is of one wavelength or a narrow band at a time; several at once are not",
        ),
        Number(
            "plastic aspheres: largest angle behind that pair over the limit",
            (angles := check_design(plastic)).max_spread_deg / angles.spread_limit_deg,
            remark="two elements of E48R; a single plastic asphere is in no file here",
        ),
        Number("less computation: 200 slices take so many times as long as tiles", _times(shot(scale))),
        Number("coded surface", "not done", remark="surfaces may carry maps, but none is sought for a code"),
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
            remark="decenter and tilt of one lens do nearly the same: along that line they are known least",
        ),
    ]


def _single(one: Shot, kind: str, iterations: int) -> float:
    """Correlation of the object from the frames of the first plane alone."""
    chosen, first = one.imaged.settings, one.imaged.frames[0].settings.plane_distance_mm
    frames = [frame for frame in one.imaged.frames if frame.settings.plane_distance_mm == first]
    found = reconstruct_frames(
        one.lens,
        frames,
        kind=kind,
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
    "Compensation with the light's own angles, calibration of tilt and decenter from the frames, single "
    "shots of amplitude objects, lenses for several wavelengths and of plastic, and engines that take far "
    "less computation are there. Not done: a coded surface, a single shot of complex objects, and several "
    "wavelengths imaged in one command."
)

COMMANDS = ("python -m paper --only discussion", f"lensdesign check designs/{PLASTIC}")

DISCUSSION = Element(
    "discussion",
    "Discussion: what is left to later work",
    "A more accurate phase compensation and less computation; calibration of tilt and decenter by "
    "optimization; a single shot through a coded lens; several wavelengths; moulded plastic aspheres.",
    discussion,
    SETTINGS,
    {"quick": 60.0, "full": 300.0},
    designs=(PAPER_DESIGN, PLASTIC),
)
