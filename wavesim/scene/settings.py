"""Settings of simulations, reconstructions and calibrations.

Every field of a model is also an option of the commands, with its name, its default, and its description as
help. The help lists it under the title `option_group` of its class. A field whose `json_schema_extra` has a
`group` is listed under that title. The key `metavar` states how its value is shown.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
)

from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.lengths import PIXEL_PITCH_UM, WAVELENGTH_UM
from lensdesign.common.number_limits import LARGEST_SETTING, SMALLEST_SETTING
from lensdesign.common.option_groups import OptionGroup
from lensdesign.errors import InputError
from lensdesign.lens.poses import Pose
from wavesim.scene.bench_settings import BenchSettings, Numbers, Pair
from wavesim.scene.polarization import ALLOWED, read_polarization
from wavesim.scene.scene import Scene

STARTS = {"paper": ("model", "uniform", "random"), "object": ("even", "amplitude")}
"""Starts of each reconstruction method; the first is the default."""

ITERATIONS = {"paper": 500, "object": 80}

DEFAULT_ERROR = 0.05
"""Default limit of the exit field's relative L2 error, for the choice of an engine."""


class SettingError(InputError):
    """A setting that cannot be used.

    Parameters
    ----------
    text
        The message. It contains names of settings in braces, so that a command can replace them by its
        options.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        super().__init__(self.naming(str))

    def naming(self, name: Callable[[str], str]) -> str:
        """Return the message with each name of a setting replaced by `name(setting)`."""
        return re.sub(r"{(\w+)}", lambda found: name(found[1]), self.text)


class Settings(FrozenModel):
    """A section of settings whose numbers have a magnitude that computations can handle.

    The docstring of each class lists its settings, with their defaults and descriptions.
    """

    @classmethod
    def __pydantic_init_subclass__(cls, **kwargs: Any) -> None:
        super().__pydantic_init_subclass__(**kwargs)
        text, heading, examples = inspect.cleandoc(cls.__doc__ or "").partition("\n\nExamples\n")
        settings = "\n".join(
            f"{name} : default {field.default!r}\n    {field.description or ''}"
            for name, field in cls.model_fields.items()
        )
        cls.__doc__ = f"{text}\n\nAttributes\n----------\n{settings}{heading}{examples}\n"

    @field_validator("*")
    @classmethod
    def _of_usable_size(cls, value: Any) -> Any:
        for number in _floats(value):
            if number != 0.0 and not SMALLEST_SETTING <= abs(number) <= LARGEST_SETTING:
                raise ValueError(
                    f"must be 0 or have a magnitude from {SMALLEST_SETTING:g} to {LARGEST_SETTING:g}"
                )
        return value

    @field_validator("wavelength_um", "pixel_pitch_um", check_fields=False)
    @classmethod
    def _in_micrometres(cls, value: float | None, info: ValidationInfo) -> float | None:
        plausible = WAVELENGTH_UM if info.field_name == "wavelength_um" else PIXEL_PITCH_UM
        doubt = None if value is None else plausible.objection(value, "um")
        if doubt is not None:
            raise ValueError(doubt)
        return value


def _floats(value: Any) -> Iterator[float]:
    """Yield the numbers of a setting."""
    if isinstance(value, float):
        yield value
    elif isinstance(value, tuple):
        for part in value:
            yield from _floats(part)


def _finite_positive(value: float) -> float:
    if not (math.isfinite(value) and value > 0.0):
        raise ValueError("must be finite and greater than 0")
    return value


def _bracket(exposures: tuple[float, ...]) -> tuple[float, ...]:
    """Return exposures in ascending order, once they have been checked."""
    if not exposures or min(exposures) <= 0.0:
        raise ValueError("must be greater than 0")
    # Longest exposure, as a multiple of the one for the brightest pixel; the shortest is its reciprocal.
    longest_exposure = 1e9
    if max(exposures) > longest_exposure or min(exposures) < 1.0 / longest_exposure:
        raise ValueError(f"must be from {1.0 / longest_exposure:g} to {longest_exposure:g}")
    return tuple(sorted(exposures))


Size = Annotated[float, AfterValidator(_finite_positive)]
Count = Annotated[int, AfterValidator(_finite_positive)]
Points = Annotated[
    tuple[Pair, ...],
    Field(
        description="Centre x,y of an additional USAF chart with fine groups; may be repeated.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    ),
]
Pixels = int | tuple[int, int] | Literal["all"]
Kind = Literal["complex", "amplitude", "phase"]
Verdict = Literal["full", "quick", "none"]
StopOrigin = Literal["patch", "stated", "frames", "calibration"]
"""Where a field stop comes from: the patch's sides, settings, the frames, or an earlier calibration."""

STOP_ORIGINS: dict[StopOrigin, str] = {
    "patch": "as wide as the patch (default)",
    "stated": "from the settings",
    "frames": "estimated from the frames",
    "calibration": "from the calibration",
}


def _pixels(value: Any) -> Any:
    """Return numbers of pixels from their text, such as 9344x7000."""
    if not isinstance(value, str) or value == "all":
        return value
    parts = value.split("x")
    if not all(part.strip().isdecimal() for part in parts) or len(parts) > 2:
        raise ValueError("must be a whole number, two numbers such as 9344x7000, or all")
    sides = [int(part) for part in parts]
    return sides[0] if len(sides) == 1 else (sides[0], sides[1])


class PatchSettings(Settings):
    """The square of the object plane that is imaged, its field stop, and the light on it."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    patch_mm: float | None = Field(None, description="Side of the object patch; default: the whole field.")
    field_stop_mm: float | None = Field(None, description="Diameter of the field stop; default: the patch.")
    field_stop_at_mm: Pair | None = Field(
        None, description="x,y of the field stop's centre; default: on the axis."
    )
    object_pitch_um: float | None = Field(
        None, description="Pitch of the object's samples; default: from the numerical aperture."
    )
    illumination: str = Field(
        "plane",
        description="plane, tilted, gaussian, point, speckle, or FILE of a measured field.",
        json_schema_extra={
            "group": OptionGroup.ILLUMINATION,
            "metavar": "[plane|tilted|gaussian|point|speckle]|FILE",
        },
    )
    light_tilt_deg: Pair = Field(
        (0.0, 0.0),
        description="Angles x,y of tilted light.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    waist_mm: float | None = Field(
        None,
        description="Radius of the waist of a Gaussian beam.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    source_distance_mm: float | None = Field(
        None,
        description="Distance of a point source before the object; negative: its light converges behind it.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    speckle_na: float | None = Field(
        None,
        description="Numerical aperture of speckle, the light of a diffuser.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    speckle_seed: int = Field(
        0,
        ge=0,
        description="Seed of the random waves of speckle.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    light_pitch_um: float | None = Field(
        None,
        description="Sample pitch of a measured field whose file does not state it.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )

    @field_validator("light_tilt_deg", "waist_mm", "source_distance_mm", "speckle_na", "speckle_seed")
    @classmethod
    def _of_its_kind(cls, value: Any, info: ValidationInfo) -> Any:
        kinds = {"light_tilt_deg": "tilted", "waist_mm": "gaussian", "source_distance_mm": "point"}
        kind = kinds.get(str(info.field_name), "speckle")
        unused = cls.model_fields[str(info.field_name)].default
        if value != unused and info.data.get("illumination") != kind:
            raise SettingError(f"{{{info.field_name}}}: requires {{illumination}} {kind}")
        return value


class PoseSettings(Settings):
    """Pose of the lens as mounted, as in :class:`lensdesign.Pose`."""

    option_group: ClassVar[OptionGroup] = OptionGroup.MOUNTED_LENS

    decenter_x_mm: float = Field(0.0, description="Shift of the lens as mounted, along x.")
    decenter_y_mm: float = Field(0.0, description="Shift of the lens as mounted, along y.")
    despace_mm: float = Field(0.0, description="Shift of the lens towards the sensor.")
    tilt_x_deg: float = Field(0.0, description="Rotation of the lens about x.")
    tilt_y_deg: float = Field(0.0, description="Rotation of the lens about y.")
    pivot_z_mm: float = Field(0.0, description="Centre of rotation, from the front vertex.")

    @property
    def pose(self) -> Pose:
        """Pose of the lens."""
        return Pose(**{name: getattr(self, name) for name in PoseSettings.model_fields})


class EngineDetails(Settings):
    """Settings of single engines; None leaves the value to the engine."""

    option_group: ClassVar[OptionGroup] = OptionGroup.ENGINE

    tile_width_mm: Size | None = Field(None, description="Width of a tile of the object (eikonal engine).")
    hierarchical: bool | None = Field(
        None, description="Whether tiles form a hierarchy (eikonal engine); default: by their number."
    )
    slices: Count | None = Field(None, description="Number of slices (engine slices).")
    compensation: str | None = Field(
        None,
        description="Phase compensation (engine slices).",
        json_schema_extra={"metavar": "[vertical|oblique]"},
    )
    interface: str | None = Field(
        None,
        description="Treatment of surfaces within a step (engine wpm).",
        json_schema_extra={"metavar": "[substep|staircase]"},
    )
    step_um: Size | None = Field(None, description="Step along z (engine wpm).")
    pitch_um: Size | None = Field(
        None, description="Pitch of the working grid (engines slices, wpm, thin-lens)."
    )

    def details(self) -> dict[str, Any]:
        """Return the settings that are given, by their names in the engines."""
        names = (*EngineDetails.model_fields, "spacing")
        given = {name: getattr(self, name, None) for name in names}
        if self.pitch_um is not None:
            given |= {"pitch_um": None, "pitch_mm": 1e-3 * self.pitch_um}
        return {name: value for name, value in given.items() if value is not None}


class SingleEngineDetails(EngineDetails):
    """Settings of an engine that is run by its name."""

    option_group: ClassVar[OptionGroup] = OptionGroup.ENGINE

    spacing: str | None = Field(
        None,
        description="Positions of the slices (engine slices).",
        json_schema_extra={"metavar": "[equal|paper|equal-phase]"},
    )


class EngineSettings(EngineDetails):
    """The engine, and the error that it may have."""

    option_group: ClassVar[OptionGroup] = OptionGroup.ENGINE

    engine: str = Field(
        "auto",
        description="Engine, or auto: the cheapest that meets the error limit.",
        json_schema_extra={"metavar": "[auto|eikonal|slices|wpm|thin-lens|no-lens]"},
    )
    error: float | None = Field(None, description="Allowed relative error of the exit field; default: 0.05.")


class LightSettings(Settings):
    """Polarization of the light, and coatings other than those of the design."""

    option_group: ClassVar[OptionGroup] = OptionGroup.ILLUMINATION

    polarization: str = Field(
        "auto",
        description="Light: scalar waves, unpolarized, circular, or degrees of linear polarization from x; "
        "auto: scalar waves where their error is allowed.",
        json_schema_extra={"metavar": "[auto|scalar|unpolarized|circular]|DEG"},
    )
    coating: Literal["ideal", "bare", "mgf2"] | None = Field(
        None, description="Coating of all surfaces; default: the design's."
    )

    @field_validator("polarization")
    @classmethod
    def _known_polarization(cls, value: str) -> str:
        try:
            read_polarization("polarization", value)
        except InputError:
            raise ValueError(ALLOWED) from None
        return value

    def applied_to(self, scene: Scene) -> Scene:
        """Return the scene with this polarization and coating."""
        return replace(
            scene, polarization=read_polarization("polarization", self.polarization), coating=self.coating
        )


class MachineSettings(Settings):
    """Memory and cluster of a run."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OUTPUT

    memory_gb: Size | None = Field(None, description="Memory limit; default: 80 % of what is free.")
    cluster: str | None = Field(
        None,
        description="Dask scheduler (ADDRESS) whose workers compute the tiles of a whole field.",
        json_schema_extra={"metavar": "ADDRESS"},
    )


class CameraSettings(Settings):
    """The sensor, its stage, and its exposures."""

    option_group: ClassVar[OptionGroup] = OptionGroup.CAMERA

    model_config = ConfigDict(loc_by_alias=False)

    planes_mm: Numbers | None = Field(
        None,
        description="Distances of the planes from the exit vertex; default: the design's.",
        json_schema_extra={"options": ["plane_distance_mm", "planes_mm"]},
    )
    pixels: Annotated[Pixels | None, BeforeValidator(_pixels)] = Field(
        None,
        description="Pixels along each side, or 9344x7000, or all; default: as many as the light covers.",
        json_schema_extra={"metavar": "SIDE|WIDTHxHEIGHT|all"},
    )
    noise: bool = Field(True, description="Simulate shot noise and read noise.")
    seed: int = Field(
        0,
        ge=0,
        description="Seed of the noise and of the tissue object.",
        json_schema_extra={"group": OptionGroup.OUTPUT},
    )
    full_well_electrons: float = Field(
        10_000.0,
        alias="full_well",
        ge=1.0,
        le=1e9,
        description="Full well in electrons.",
        json_schema_extra={"options": ["full_well_electrons", "full_well"]},
    )
    read_noise_electrons: float = Field(
        2.0,
        alias="read_noise",
        ge=0.0,
        le=1e9,
        description="Read noise in electrons.",
        json_schema_extra={"options": ["read_noise_electrons", "read_noise"]},
    )
    bits: int = Field(12, ge=1, le=16, description="Bits of a count.")
    peak_fill: float = Field(
        0.8,
        validation_alias=AliasChoices("peak_fill", "brightest_share"),
        ge=1e-6,
        le=1e6,
        description="Fraction of full well that the brightest pixel receives in exposure 1.",
    )
    exposures: Numbers = Field(
        (1.0,), description="Exposure times of each plane, relative to that for the peak fill."
    )
    fill_factor: float = Field(
        1.0,
        validation_alias=AliasChoices("fill_factor", "active_width"),
        description="Linear fill factor of a pixel (0 to 1).",
    )
    stage_error_mm: Numbers = Field(
        (0.0,),
        description="Error of the plane distance: one value, or one for each plane.",
        json_schema_extra={"group": OptionGroup.CAMERA_ERRORS},
    )
    shift_um: Pair = Field(
        (0.0, 0.0),
        description="x,y shift of the sensor from plane to plane.",
        json_schema_extra={"group": OptionGroup.CAMERA_ERRORS},
    )

    @field_validator("planes_mm")
    @classmethod
    def _apart(cls, planes: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if planes is None:
            return None
        if not planes or min(planes) <= 0.0 or len(set(planes)) < len(planes):
            raise ValueError("must be distinct and greater than 0")
        return tuple(sorted(planes))

    _lit = field_validator("exposures")(_bracket)


class ObjectSettings(Settings):
    """An object on the patch, and the wavelength of its light."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    wavelength_um: float | None = Field(
        None,
        description="Wavelength; default: the design's first.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    ground: Literal["bright", "dark"] = Field(
        "bright", description="Bright or dark background of a chart (usaf, star)."
    )
    chart_at_mm: Points = ()
    ghost: float = Field(
        0.0,
        ge=0.0,
        le=1.0,
        description="Ghost of the lens: product of the reflectances of both outer surfaces.",
        json_schema_extra={"group": OptionGroup.MOUNTED_LENS},
    )
    ghosts: Literal["none", "coherent", "incoherent"] = Field(
        "none",
        description="All ghosts by the coatings: between lens surfaces with their fringes (coherent) or as "
        "smooth light (incoherent); those of cover glass and sensor as smooth light.",
        json_schema_extra={"group": OptionGroup.MOUNTED_LENS},
    )
    picture_pixel_um: Size | None = Field(
        None, description="Side of a picture's pixel on the object; default: fitted to the field stop."
    )
    picture_width_mm: Size | None = Field(
        None, description="Width of a picture on the object; default: fitted to the field stop."
    )


class ColourObjectSettings(Settings):
    """Wavelengths recorded together, filters on the pixels, and objects that depend on the wavelength."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    wavelengths_um: Numbers | None = Field(
        None,
        description="Wavelengths that the sensor records at once, or one after the other with "
        "--all-wavelengths.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    colour_filters: str = Field(
        "monochrome",
        description="Filters on the pixels, of light of several wavelengths: monochrome (none), bayer, or "
        "FILE (TOML) of a pattern and its responses.",
        json_schema_extra={"group": OptionGroup.CAMERA, "metavar": "[monochrome|bayer]|FILE"},
    )
    channels: bool = Field(
        False,
        description="Whether a colour picture transmits a wavelength as its red, green or blue channel does.",
    )
    thickness_um: Size | None = Field(
        None,
        description="The object is a clear film of this thickness where its amplitude is 1, and thinner in "
        "proportion elsewhere.",
    )
    film_index: float | None = Field(
        None, gt=1.0, le=5.0, description="Refractive index of such a film, in air; default: 1.5."
    )

    @field_validator("film_index")
    @classmethod
    def _of_a_film(cls, film_index: float | None, info: ValidationInfo) -> float | None:
        if film_index is not None and info.data.get("thickness_um") is None:
            raise SettingError("{film_index}: requires {thickness_um}")
        return film_index

    @field_validator("wavelengths_um")
    @classmethod
    def _several(cls, wavelengths: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if wavelengths is None:
            return None
        for wavelength in wavelengths:
            doubt = WAVELENGTH_UM.objection(wavelength, "um")
            if doubt is not None:
                raise ValueError(doubt)
        if len(wavelengths) < 2 or len(set(wavelengths)) < len(wavelengths):
            raise ValueError("must be two or more different wavelengths")
        return wavelengths

    @field_validator("colour_filters")
    @classmethod
    def _of_several(cls, filters: str, info: ValidationInfo) -> str:
        if filters != "monochrome" and info.data.get("wavelengths_um") is None:
            raise SettingError("{colour_filters}: requires {wavelengths_um}")
        return filters

    @field_validator("thickness_um")
    @classmethod
    def _without_channels(cls, thickness_um: float | None, info: ValidationInfo) -> float | None:
        if thickness_um is not None and info.data.get("channels"):
            raise SettingError("{channels}, {thickness_um}: give only one of them")
        return thickness_um


class LayerSettings(Settings):
    """Positions of the layers of an object that has several."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    layers_um: Numbers | None = Field(
        None,
        description="Distances of the object's layers from the object plane, positive towards the lens, in "
        "the order in which light passes them; default: one layer in the object plane.",
    )

    @field_validator("layers_um")
    @classmethod
    def _ascending(cls, distances: tuple[float, ...] | None) -> tuple[float, ...] | None:
        if distances is None:
            return None
        steps = (after - before for before, after in pairwise(distances))
        if not distances or not all(map(math.isfinite, distances)) or any(step <= 0.0 for step in steps):
            raise ValueError("must be finite and ascending")
        return distances


class ImageSettings(
    ColourObjectSettings,
    PoseSettings,
    MachineSettings,
    EngineSettings,
    LightSettings,
    BenchSettings,
    CameraSettings,
    PatchSettings,
    ObjectSettings,
    LayerSettings,
):
    """Settings of :func:`wavesim.image`. Lengths are in the unit that their names state.

    Every setting is also an option of `wavesim image`. A description that begins with a name, such as
    "gaussian:" or "slices:", is for a setting of this illumination, object or engine only.

    Examples
    --------
    >>> from wavesim import ImageSettings
    >>> settings = ImageSettings(patch_mm=0.5, exposures=(30.0, 1.0))
    >>> settings.exposures, settings.bits, settings.replaced(bits=10).bits
    ((1.0, 30.0), 12, 10)
    >>> ImageSettings.model_fields["patch_mm"].description
    'Side of the object patch; default: the whole field.'
    """


class ChoiceSettings(LightSettings, PatchSettings, ObjectSettings):
    """The object for whose light `wavesim choose-engine` predicts the errors of the engines."""

    patch_mm: float = Field(0.1, description="Side of the object patch.")


class FrameSetSettings(Settings):
    """Properties of frames that their files do not state; one value for all frames, or one for each."""

    option_group: ClassVar[OptionGroup] = OptionGroup.FRAMES

    plane_distance_mm: Numbers | None = Field(
        None,
        description="Distance of each frame's plane from the exit vertex, in the order of FRAMES; default: "
        "as the frames state.",
    )
    exposure: Numbers | None = Field(
        None, description="Exposure of each frame, in any unit; default: as the frames state."
    )
    pixel_pitch_um: float | None = Field(
        None, description="Pixel pitch of the frames; default: as the frames state."
    )
    wavelength_um: float | None = Field(None, description="Wavelength of the frames; default: as they state.")
    bits: int | None = Field(None, description="Bits of a count.")
    offset_counts: float | None = Field(None, description="Count of a dark pixel.")
    gain_electrons_per_count: float | None = Field(None, description="Gain of the sensor.")
    read_noise_electrons: float | None = Field(None, description="Read noise of the sensor.")
    saturation_counts: int | None = Field(
        None,
        description="Lowest count of a pixel that may be clipped; default: the largest count, or one that "
        "many of the brightest pixels share.",
    )
    nonlinearity: float | None = Field(
        None,
        description="Relative increase of the light over that of a linear camera, at the largest count; "
        "default: as the frames state.",
    )
    flat: Path | None = Field(
        None,
        description="FILE of a flat frame (even light), in counts: TIFF, PNG or .npy.",
        json_schema_extra={"metavar": "FILE"},
    )
    dark: Path | None = Field(
        None,
        description="FILE of a dark frame (no light), in counts: TIFF, PNG or .npy.",
        json_schema_extra={"metavar": "FILE"},
    )
    bad_pixels: Path | None = Field(
        None,
        description="FILE of a mask in which bad pixels are not 0.",
        json_schema_extra={"metavar": "FILE"},
    )


class FramedSettings(EngineSettings, PatchSettings):
    """Settings that reconstructions and calibrations share."""

    option_group: ClassVar[OptionGroup] = OptionGroup.SOLVER

    kind: Kind = Field(
        "complex",
        description="Kind of the object: complex, amplitude (without phase), or phase (without absorption).",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    field_stop: Literal["stated", "find"] = Field(
        "stated",
        description="stated, or find: estimate from the frames the diameter or position that is not given.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    scale: float | None = Field(
        None,
        description="Recorded amplitude where the transmission is 1; default: fitted.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    fill_factor: float = Field(
        1.0,
        validation_alias=AliasChoices("fill_factor", "active_width"),
        ge=0.0,
        le=1.0,
        description="Linear fill factor of a pixel (0 to 1).",
        json_schema_extra={"group": OptionGroup.CAMERA},
    )
    source_deg: float | Literal["find"] | None = Field(
        None,
        description="Diameter of the light source (partial coherence), or find; default: calibrated, or 0.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    bandwidth_nm: float | Literal["find"] | None = Field(
        None,
        description="Full width of the light's rectangular spectrum, or find; default: calibrated, or 0.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )

    verdict: Verdict = Field(
        "full",
        description="Tests of the result: full, quick (residuals alone), or none.",
        json_schema_extra={"group": OptionGroup.EVALUATION},
    )

    @field_validator("source_deg", "bandwidth_nm")
    @classmethod
    def _width_within_limits(cls, width: float | str | None, info: ValidationInfo) -> float | str | None:
        limits = {
            "source_deg": (90.0, "from 0 to below 90"),
            "bandwidth_nm": (math.inf, "finite and not negative"),
        }
        limit, allowed = limits[str(info.field_name)]
        if isinstance(width, int | float) and not 0.0 <= width < limit:
            raise ValueError(f"must be {allowed}, or 'find'")
        return width

    @field_validator("field_stop")
    @classmethod
    def _something_to_find(cls, stop: str, info: ValidationInfo) -> str:
        both = all(info.data.get(name) is not None for name in ("field_stop_mm", "field_stop_at_mm"))
        if stop == "find" and both:
            raise SettingError(
                "{field_stop} find: {field_stop_mm} and {field_stop_at_mm} are both given, so there is "
                "nothing to find; omit at least one of them"
            )
        return stop

    def with_stop(self, field_stop_mm: float, field_stop_at_mm: Pair) -> Self:
        """Return the same settings with a stated field stop."""
        stop = {"field_stop_mm": field_stop_mm, "field_stop_at_mm": field_stop_at_mm}
        return self.replaced(field_stop="stated", **stop)

    @property
    def field_stop_from(self) -> StopOrigin:
        """Origin of the field stop's position and diameter."""
        if self.field_stop == "find":
            return "frames"
        is_default = self.field_stop_mm is None and self.field_stop_at_mm is None
        return "patch" if is_default else "stated"


class ReconstructionSettings(PoseSettings, MachineSettings, FramedSettings):
    """Settings of :func:`wavesim.reconstruct_frames`. Lengths are in the unit that their names state.

    Every setting is also an option of `wavesim reconstruct`. A description that begins with a name, such as
    "object:" or "slices:", is for a setting of this method, illumination or engine only.

    Examples
    --------
    >>> from wavesim import ReconstructionSettings
    >>> settings = ReconstructionSettings(patch_mm=0.5, kind="amplitude")
    >>> settings.most_iterations, settings.replaced(method="paper").most_iterations
    (80, 500)
    >>> ReconstructionSettings.model_fields["kind"].description
    'Kind of the object: complex, amplitude (without phase), or phase (without absorption).'
    """

    option_group: ClassVar[OptionGroup] = OptionGroup.SOLVER

    method: Literal["paper", "object"] = Field("object", description="paper (Appendix A) or object.")
    iterations: int | None = Field(
        None, ge=1, description="Largest number of iterations; default: 80, or 500 with --method paper."
    )
    tv_weight: float | Literal["auto"] = Field(
        "auto", description="Weight of the total variation (method object); auto: from the noise."
    )
    start: str | None = Field(
        None,
        description="Start: model, uniform or random for paper; even or amplitude for object.",
        json_schema_extra={"metavar": "[model|uniform|random|even|amplitude]"},
    )
    refocus_mm: Pair | None = Field(
        None,
        description="low,high: range in which the focus is searched.",
        json_schema_extra={"metavar": "LOW,HIGH"},
    )
    usaf: Literal["bright", "dark"] | None = Field(
        None,
        description="The object is a USAF chart with a bright or dark background.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    chart_at_mm: Points = ()
    hold_out_plane: int | None = Field(
        None,
        description="Number of a plane, from 1, that is only predicted and compared (method object).",
        json_schema_extra={"group": OptionGroup.EVALUATION},
    )
    starts: int = Field(1, ge=1, description="Number of starts, whose results are compared (method object).")
    region_mm: tuple[float, float, float, float] | None = Field(
        None,
        description="x,y,width,height: region of the object that is evaluated and written.",
        json_schema_extra={"group": OptionGroup.EVALUATION, "metavar": "X,Y,WIDTH,HEIGHT"},
    )

    @field_validator("start")
    @classmethod
    def _start_of_method(cls, start: str | None, info: ValidationInfo) -> str | None:
        method = info.data.get("method", "object")
        if start is not None and start not in STARTS[method]:
            raise ValueError(f"allowed for {method}: {', '.join(STARTS[method])}")
        if start == "amplitude" and info.data.get("kind") == "phase":
            raise SettingError("{start} amplitude: cannot be used with {kind} phase")
        return start

    @field_validator("hold_out_plane", "starts")
    @classmethod
    def _of_object(cls, value: int | None, info: ValidationInfo) -> int | None:
        if value not in (None, 1) and info.data.get("method") == "paper":
            raise SettingError(f"{{{info.field_name}}}: cannot be used with {{method}} paper")
        return value

    @field_validator("chart_at_mm")
    @classmethod
    def _of_a_chart(cls, points: tuple[Pair, ...], info: ValidationInfo) -> tuple[Pair, ...]:
        if points and info.data.get("usaf") is None:
            raise SettingError("{chart_at_mm}: requires {usaf}")
        return points

    @field_validator("method")
    @classmethod
    def _coherent_for_paper(cls, method: str, info: ValidationInfo) -> str:
        for name in ("source_deg", "bandwidth_nm"):
            if method == "paper" and info.data.get(name):
                raise SettingError(
                    f"{{{name}}}: cannot be used with {{method}} paper, which assumes coherent light"
                )
        return method

    @property
    def most_iterations(self) -> int:
        """Most iterations; default: the method's."""
        return self.iterations or ITERATIONS[self.method]

    @property
    def first(self) -> str:
        """Start of the iteration; default: the method's first one."""
        return self.start or STARTS[self.method][0]

    @property
    def focus_mm(self) -> Pair | None:
        """Range in which the focus is searched; default: the method's."""
        paper_refocus_mm = (-0.01, 0.01)
        return self.refocus_mm or (paper_refocus_mm if self.method == "paper" else None)


class ColourSettings(PoseSettings, EngineSettings, PatchSettings):
    """Settings of :func:`wavesim.reconstruct_colours`. Lengths are in the unit that their names state.

    Examples
    --------
    >>> from wavesim.scene.settings import ColourSettings
    >>> ColourSettings(kind="thickness", film_index=1.46).film_index
    1.46
    """

    option_group: ClassVar[OptionGroup] = OptionGroup.SOLVER

    kind: Literal["complex", "amplitude", "thickness"] = Field(
        "complex",
        description="Object: complex or amplitude at each wavelength, or a grey film whose thickness all "
        "wavelengths share.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    iterations: int = Field(150, ge=1, description="Largest number of iterations.")
    tv_weight: float | Literal["auto"] = Field(
        "auto", description="Weight of the total variation; auto: from the noise."
    )
    start: Literal["even", "amplitude"] = Field(
        "even", description="Start: even, or amplitude: first iterations seek an amplitude object."
    )
    scale: Size | None = Field(
        None,
        description="Recorded amplitude where the transmission is 1; default: fitted.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    fill_factor: float = Field(
        1.0,
        ge=0.0,
        le=1.0,
        description="Linear fill factor of a pixel (0 to 1).",
        json_schema_extra={"group": OptionGroup.CAMERA},
    )
    film_index: float | None = Field(
        None,
        gt=1.0,
        le=5.0,
        description="Refractive index of a film in air, whose height is then found from all wavelengths.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    heights_um: Pair | None = Field(
        None,
        description="Lowest and highest possible height; default: the range that is unambiguous.",
        json_schema_extra={"group": OptionGroup.OBJECT, "metavar": "LOW,HIGH"},
    )
    ground_mm: tuple[float, float, float, float] | None = Field(
        None,
        description="x,y,width,height of a region whose height is 0; default: the most common phase.",
        json_schema_extra={"group": OptionGroup.OBJECT, "metavar": "X,Y,WIDTH,HEIGHT"},
    )
    repeats: int = Field(
        10,
        ge=2,
        le=1000,
        description="Repeats with other noise, from which the deviations of heights follow.",
        json_schema_extra={"group": OptionGroup.EVALUATION},
    )
    seed: int = Field(
        0, ge=0, description="Seed of that noise.", json_schema_extra={"group": OptionGroup.OUTPUT}
    )

    @field_validator("tv_weight")
    @classmethod
    def _weight(cls, weight: float | str) -> float | str:
        if not isinstance(weight, str) and not 0.0 <= weight < math.inf:
            raise ValueError("must be finite and not negative, or 'auto'")
        return weight

    @field_validator("film_index")
    @classmethod
    def _of_films(cls, film_index: float | None, info: ValidationInfo) -> float | None:
        kind = info.data.get("kind")
        if film_index is not None and kind == "amplitude":
            raise SettingError("{film_index}: cannot be used with {kind} amplitude, which has no phase")
        return film_index

    @field_validator("heights_um", "ground_mm")
    @classmethod
    def _with_index(cls, value: Any, info: ValidationInfo) -> Any:
        if value is not None and info.data.get("film_index") is None:
            raise SettingError(f"{{{info.field_name}}}: requires {{film_index}}")
        if value is not None and info.field_name == "heights_um" and not value[0] < value[1]:
            raise ValueError("must be two increasing numbers")
        return value


class FreeSpaceSettings(Settings):
    """Frames that were recorded without a lens, and planes that are predicted from them."""

    option_group: ClassVar[OptionGroup] = OptionGroup.FREE_SPACE

    free_space: bool = Field(
        False, description="Reconstruct the field on z = 0 from frames without a lens, on their pitch."
    )
    calibrate: bool = Field(
        False,
        description="First calibrate the bench; in free space: distances, drift and exposures.",
        json_schema_extra={"group": OptionGroup.SOLVER},
    )
    numerical_aperture: Size | None = Field(
        None, description="Numerical aperture of light in free space; default: from the frames' spectra."
    )
    predict_mm: Numbers | None = Field(
        None, description="Distances of further planes in free space whose amplitudes are predicted."
    )

    @field_validator("numerical_aperture", "predict_mm")
    @classmethod
    def _in_free_space(cls, value: Any, info: ValidationInfo) -> Any:
        if value not in (None, False) and not info.data.get("free_space"):
            raise SettingError(f"{{{info.field_name}}}: requires {{free_space}}")
        return value


class LayerReconstructionSettings(LayerSettings):
    """Layers of an object that are reconstructed from frames."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    undetermined_layers: bool = Field(
        False,
        description="Reconstruct layers even if the frames do not determine them: the result is one of many "
        "solutions, with few edges.",
    )

    @field_validator("undetermined_layers")
    @classmethod
    def _of_layers(cls, value: bool, info: ValidationInfo) -> bool:
        if value and not info.data.get("layers_um"):
            raise SettingError("{undetermined_layers}: requires {layers_um}")
        return value


class PlanSettings(Settings):
    """Settings of :func:`wavesim.calibration.plan_frames`."""

    option_group: ClassVar[OptionGroup] = OptionGroup.CAMERA

    model_config = ConfigDict(loc_by_alias=False)

    kind: Kind = Field(
        "complex", description="Kind of the object.", json_schema_extra={"group": OptionGroup.OBJECT}
    )
    patch_mm: Size | None = Field(
        None,
        description="Side of the object patch; default: the whole field.",
        json_schema_extra={"group": OptionGroup.OBJECT},
    )
    wavelength_um: Size | None = Field(
        None,
        description="Wavelength; default: the design's first.",
        json_schema_extra={"group": OptionGroup.ILLUMINATION},
    )
    planes_mm: Pair | None = Field(
        None,
        description="Distances of the nearest and farthest plane; default: the design's.",
        json_schema_extra={
            "metavar": "NEAREST,FARTHEST",
            "options": ["plane_distance_mm", "planes_mm"],
        },
    )
    most_planes: int = Field(
        4,
        ge=1,
        le=8,
        description="Largest number of planes, which are evenly spaced.",
        json_schema_extra={"options": ["max_planes", "most_planes"]},
    )
    exposures: Numbers = Field(
        (1.0, 30.0, 1000.0), description="Exposure bracket; it is compared with its shortest exposure alone."
    )
    correlation: float = Field(
        0.99,
        gt=0.0,
        lt=1.0,
        description="Required correlation of the object.",
        json_schema_extra={"group": OptionGroup.EVALUATION},
    )
    full_well_electrons: Size = Field(
        10_000.0,
        alias="full_well",
        ge=1.0,
        le=1e9,
        description="Full well in electrons.",
        json_schema_extra={"options": ["full_well_electrons", "full_well"]},
    )
    read_noise_electrons: float = Field(
        2.0,
        alias="read_noise",
        ge=0.0,
        le=1e9,
        description="Read noise in electrons.",
        json_schema_extra={"options": ["read_noise_electrons", "read_noise"]},
    )
    bits: int = Field(12, ge=1, le=16, description="Bits of a count.")
    seed: int = Field(
        0, ge=0, description="Seed of object and noise.", json_schema_extra={"group": OptionGroup.OUTPUT}
    )

    @field_validator("planes_mm")
    @classmethod
    def _apart(cls, planes: Pair | None) -> Pair | None:
        if planes is not None and not 0.0 < planes[0] < planes[1]:
            raise ValueError("must be two numbers, increasing and greater than 0")
        return planes

    _lit = field_validator("exposures")(_bracket)


class CalibrationSettings(FramedSettings):
    """Settings of :func:`wavesim.calibrate_frames`."""

    option_group: ClassVar[OptionGroup] = OptionGroup.SOLVER

    engine: str = Field(
        "auto",
        description="Engine, or auto: eikonal for the search, and the cheapest that meets the error limit "
        "for the verdict.",
        json_schema_extra={"metavar": "[auto|eikonal|slices|wpm|thin-lens|no-lens]"},
    )
    iterations: int = Field(5, ge=1, description="Iterations of each reconstruction within the search.")
    most_mountings: int = Field(
        80,
        ge=1,
        description="Largest number of benches that are tested.",
        json_schema_extra={"options": ["max_mountings", "most_mountings"]},
    )
    parameters: str = Field(
        "all",
        description="Unknowns: all, groups, rigid (decenter and tilt of the lens), or names separated by "
        "commas; a wrong name lists them.",
        json_schema_extra={"metavar": "[all|light|lens|mounting|camera|rigid]|NAME,..."},
    )
    pivot_z_mm: float = Field(
        0.0,
        description="Centre of rotation, from the front vertex.",
        json_schema_extra={"group": OptionGroup.MOUNTED_LENS},
    )
    deviations: bool = Field(
        True,
        description="State standard deviations; return parameters that are not needed to nominal.",
        json_schema_extra={"group": OptionGroup.EVALUATION},
    )
