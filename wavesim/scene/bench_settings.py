"""Settings for deviations of the bench from the design. Each one is an option of `wavesim image`."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from typing import Any, ClassVar

from pydantic import field_validator

from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.option_groups import OptionGroup, setting
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import SURFACE_DELTAS, Pose, SurfacePerturbation
from lensdesign.lens.shapes.registry import parameters
from lensdesign.lens.surface_figure import surface_figure_from_zernike
from wavesim.scene.light_errors import LightErrors, Orders
from wavesim.scene.source import Source
from wavesim.scene.system_state import SystemState

Numbers = tuple[float, ...]
Pair = tuple[float, float]

ZERNIKE = re.compile(r"zernike_(\d+)_um")
"""Name of a Zernike term of a surface's figure: rms sag over the clear semi-diameter, in um."""


class BenchSettings(FrozenModel):
    """Deviations of light, lens and camera from what the frames state."""

    option_group: ClassVar[OptionGroup] = OptionGroup.CAMERA_ERRORS

    light_error_deg: Pair = setting(
        (0.0, 0.0), "Error x,y of the light's direction.", OptionGroup.ILLUMINATION
    )
    light_amplitude: str | None = setting(
        None,
        "Relative amplitude errors of the light as Legendre modes (order in x and in y): 10:-0.04,02:0.05.",
        OptionGroup.ILLUMINATION,
        metavar="ORDERS:COEFFICIENT,...",
    )
    light_phase_waves: str | None = setting(
        None,
        "Phase errors of the light as Legendre modes, in waves: 20:0.03,11:-0.02.",
        OptionGroup.ILLUMINATION,
        metavar="ORDERS:COEFFICIENT,...",
    )
    source_deg: float = setting(
        0.0, "Diameter of the light source (partial coherence).", OptionGroup.ILLUMINATION
    )
    bandwidth_nm: float = setting(
        0.0, "Full width of the light's rectangular spectrum.", OptionGroup.ILLUMINATION
    )
    perturb: str | None = setting(
        None,
        "Errors of the lens: 'surface 1: radius_mm=0.01, index=0.001; surface 2: conic=0.02'.",
        OptionGroup.MOUNTED_LENS,
        metavar="ERRORS",
    )
    working_distance_error_mm: float = setting(
        0.0, "Shift of the object away from the lens.", OptionGroup.MOUNTED_LENS
    )
    sensor_tilt_deg: Pair = setting((0.0, 0.0), "Tilt of the sensor about x,y.")
    plane_shift_um: tuple[Pair, ...] = setting(
        (), "x,y shift of the sensor on the first plane; repeat the option for the next planes."
    )
    plane_background: Numbers = setting(
        (0.0,), "Background as a fraction of the mean intensity: one value, or one for each plane."
    )
    background_slope: tuple[Pair, ...] = setting(
        (),
        "Change x,y of the background from the centre to the edge of the first plane, as a "
        "fraction of the mean intensity; repeat the option for the next planes.",
    )
    vibration_um: float = setting(
        0.0, "Standard deviation of the sensor's vibration along x and y during an exposure."
    )
    prnu: float = setting(
        0.0, "Standard deviation of the pixels' gain (EMVA 1288), as a fraction of the mean gain."
    )
    dsnu_electrons: float = setting(0.0, "Standard deviation of the pixels' dark signal (EMVA 1288).")
    hot_pixels: float = setting(0.0, "Fraction of hot pixels, which are bright without light.")
    dead_pixels: float = setting(0.0, "Fraction of dead pixels, which do not respond to light.")
    exposure_error: Numbers = setting(
        (0.0,), "Relative error of the exposure time: one value, or one for each exposure."
    )
    plane_exposure_error: Numbers = setting((), "Additional relative error of the exposure on each plane.")
    nonlinearity: float = setting(
        0.0, "Relative increase of the light over that of a linear camera, at the largest count."
    )

    @field_validator("light_amplitude", "light_phase_waves")
    @classmethod
    def _modes(cls, text: str | None) -> str | None:
        modes_of(text)
        return text

    @field_validator("perturb")
    @classmethod
    def _perturbed(cls, text: str | None) -> str | None:
        perturbed_surfaces(text)
        return text

    @field_validator("exposure_error")
    @classmethod
    def _above_0(cls, errors: tuple[float, ...]) -> tuple[float, ...]:
        if not errors or not all(-1.0 < error < math.inf for error in errors):
            raise ValueError("must be finite, and above -1")
        return errors

    def state(self, lens: Lens, pose: Pose, planes: int) -> SystemState:
        """Return the state with these deviations, for a number of recording planes.

        Raises
        ------
        InputError
            If a value is not usable, or the lens has no such surface.
        """
        backgrounds, shifts = self.plane_background, self.plane_shift_um
        if len(backgrounds) not in (1, planes):
            text = ",".join(f"{fraction:g}" for fraction in backgrounds)
            raise InputError(
                f"plane_background = {text!r}: must be one number, or {planes} (one for each plane)"
            )
        for name, pairs in (
            ("plane_shift_um", shifts),
            ("background_slope", self.background_slope),
            ("plane_exposure_error", self.plane_exposure_error),
        ):
            if len(pairs) > planes:
                raise InputError(f"{name}: {len(pairs)} values are given, but there are only {planes} planes")
        light = LightErrors(
            self.light_error_deg, modes_of(self.light_amplitude), modes_of(self.light_phase_waves)
        )
        return SystemState(
            pose,
            surface_perturbations(lens, self.perturb),
            object_shift_mm=(0.0, 0.0, 0.0 - self.working_distance_error_mm),
            sensor_tilt_deg=self.sensor_tilt_deg,
            light=light,
            plane_shifts_um=shifts,
            plane_backgrounds=backgrounds * planes if len(backgrounds) == 1 else backgrounds,
            plane_background_slopes=self.background_slope,
            plane_exposure_errors=self.plane_exposure_error,
            nonlinearity=self.nonlinearity,
            vibration_um=self.vibration_um,
            source=Source(self.source_deg, self.bandwidth_nm),
        )

    def errors(self) -> dict[str, Any]:
        """Return the settings that differ from their defaults, by name."""
        own = {name: getattr(self, name) for name in BenchSettings.model_fields}
        return {
            name: value for name, value in own.items() if value != BenchSettings.model_fields[name].default
        }

    @property
    def differs(self) -> bool:
        """True if light, lens or sensor position deviate from the design, apart from pixels and exposures."""
        # Settings of pixels and exposures, which do not belong to the bench.
        pixel_settings = {
            "prnu",
            "dsnu_electrons",
            "hot_pixels",
            "dead_pixels",
            "exposure_error",
            "nonlinearity",
        }
        return bool(self.errors().keys() - pixel_settings)


def modes_of(text: str | None) -> dict[Orders, float]:
    """Parse the coefficients of Legendre modes of the light from text such as "10:-0.04,02:0.05".

    Raises
    ------
    ValueError
        If the text has another form.
    """
    found: dict[Orders, float] = {}
    for part in (text or "").split(",") if text is not None else ():
        match = re.fullmatch(r"\s*(\d)(\d)\s*:\s*(\S+)\s*", part)
        size = _number(match[3]) if match else math.nan
        if match is None or not math.isfinite(size) or match[1] == match[2] == "0":
            raise ValueError(
                f"{part!r}: must be orders in x and y, a colon and a coefficient, such as 10:-0.04"
            )
        found[int(match[1]), int(match[2])] = size
    return found


def perturbed_surfaces(text: str | None) -> dict[int, dict[str, float]]:
    """Parse surface perturbations from text, by the index of the surface from 1 and the name of the change.

    Raises
    ------
    ValueError
        If a name is unknown, or a value is not a finite number.
    """
    allowed = (*SURFACE_DELTAS, *(name for name in parameters() if name not in SURFACE_DELTAS))
    found: dict[int, dict[str, float]] = {}
    for part in text.split(";") if text is not None else ():
        match = re.fullmatch(r"\s*surface\s+([1-9]\d*)\s*:(.+)", part)
        if match is None:
            raise ValueError(f"{part.strip()!r}: must have the form 'surface 1: radius_mm=0.01, index=0.001'")
        for one in match[2].split(","):
            name, _, value = (word.strip() for word in one.partition("="))
            if name not in allowed and not ZERNIKE.fullmatch(name):
                raise ValueError(
                    f"{name!r}: allowed: {', '.join(allowed)}, zernike_INDEX_um{did_you_mean(name, allowed)}"
                )
            if not math.isfinite(_number(value)):
                raise ValueError(f"{one.strip()!r}: must have the form NAME=NUMBER, with a finite number")
            found.setdefault(int(match[1]), {})[name] = _number(value)
    return found


def surface_perturbations(lens: Lens, text: str | None) -> dict[int, SurfacePerturbation]:
    """Return the perturbations of a lens's surfaces, by the index of the surface from 0.

    Raises
    ------
    InputError
        If the lens has no such surface, or a surface with a figure has no clear semi-diameter.
    """
    found = {}
    for index, deltas in perturbed_surfaces(text).items():
        if index > len(lens.surfaces):
            raise InputError(f"perturb: surface {index}: the lens has only {len(lens.surfaces)} surfaces")
        found[index - 1] = _perturbation(deltas, lens.surfaces[index - 1].semi_diameter_mm, index)
    return found


def _perturbation(
    deltas: Mapping[str, float], semi_diameter_mm: float | None, index: int
) -> SurfacePerturbation:
    plain = {name: value for name, value in deltas.items() if name in SURFACE_DELTAS}
    zernike = {int(match[1]): deltas[name] for name in deltas if (match := ZERNIKE.fullmatch(name))}
    shape = {n: v for n, v in deltas.items() if n not in plain and not ZERNIKE.fullmatch(n)}
    made: SurfacePerturbation = replace(SurfacePerturbation(shape=shape), **plain)  # type: ignore[arg-type]
    if not zernike:
        return made
    if semi_diameter_mm is None:
        raise InputError(
            f"perturb: surface {index}: a figure needs semi_diameter_mm, which the design does not state"
        )
    return replace(made, figure=surface_figure_from_zernike(zernike, semi_diameter_mm))


def _number(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        return math.nan
