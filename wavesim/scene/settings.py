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
from typing import Annotated, Any, ClassVar, Literal, NamedTuple, Self

from pydantic import (
    AfterValidator,
    AliasChoices,
    BeforeValidator,
    ConfigDict,
    Field,
    ValidationInfo,
    field_validator,
    model_validator,
)

from lensdesign.common.frozen_model import FrozenModel
from lensdesign.common.lengths import PIXEL_PITCH_UM, WAVELENGTH_UM, PlausibleLength
from lensdesign.common.number_limits import LARGEST_SETTING, SMALLEST_SETTING
from lensdesign.common.option_groups import OptionGroup, setting
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


class Rule(NamedTuple):
    """A setting that requires or excludes another one, in each model that has both.

    Both are names of settings that differ from their defaults, or a name and the value that it must have.
    """

    setting: str
    relation: Literal["requires", "excludes"]
    other: str
    reason: str = ""
    without_effect: Any = None
    """Value of the setting to which the rule does not apply, besides its default."""

    def is_broken(self, settings: FrozenModel) -> bool:
        """Return whether settings contradict this rule."""
        names = {self.setting.partition(" ")[0], self.other.partition(" ")[0]}
        if not names <= type(settings).model_fields.keys() or not self._is_given(settings, self.setting):
            return False
        return self._is_given(settings, self.other) == (self.relation == "excludes")

    def _is_given(self, settings: FrozenModel, stated: str) -> bool:
        name, _, value = stated.partition(" ")
        own, default = getattr(settings, name), type(settings).model_fields[name].default
        return own == value if value else own not in (default, self.without_effect)

    @property
    def message(self) -> str:
        """What is wrong, with names of settings in braces."""
        one, other = (re.sub(r"^\w+", r"{\g<0>}", stated) for stated in (self.setting, self.other))
        if self.relation == "requires":
            return f"{one}: requires {other}{self.reason}"
        if " " in self.setting + self.other:
            return f"{one}: cannot be used with {other}{self.reason}"
        return f"{one}, {other}: give only one of them{self.reason}"


RULES = (
    Rule("light_tilt_deg", "requires", "illumination tilted"),
    Rule("waist_mm", "requires", "illumination gaussian"),
    Rule("source_distance_mm", "requires", "illumination point"),
    Rule("speckle_na", "requires", "illumination speckle"),
    Rule("speckle_seed", "requires", "illumination speckle"),
    Rule("chart_at_mm", "requires", "usaf"),
    Rule("colour_filters", "requires", "wavelengths_um"),
    Rule("wavelength_um", "excludes", "wavelengths_um"),
    Rule("channels", "excludes", "thickness_um"),
    Rule("film_index", "requires", "thickness_um"),
    Rule("film_index", "excludes", "kind amplitude", ", which has no phase"),
    Rule("kind thickness", "requires", "film_index"),
    Rule("heights_um", "requires", "film_index"),
    Rule("ground_mm", "requires", "film_index"),
    Rule("undetermined_layers", "requires", "layers_um"),
    Rule("numerical_aperture", "requires", "free_space"),
    Rule("predict_mm", "requires", "free_space"),
    Rule("start amplitude", "excludes", "kind phase"),
    Rule("hold_out_plane", "excludes", "method paper"),
    Rule("starts", "excludes", "method paper"),
    Rule("source_deg", "excludes", "method paper", ", which assumes coherent light", 0.0),
    Rule("bandwidth_nm", "excludes", "method paper", ", which assumes coherent light", 0.0),
)
"""Which settings belong together, and which contradict each other."""


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

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        broken = [rule.message for rule in RULES if rule.is_broken(self)]
        if broken:
            raise SettingError("\n".join(broken))
        return self


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


def _plausible(length: PlausibleLength) -> AfterValidator:
    """Return the check that a length in micrometres is plausible."""

    def check(value: float) -> float:
        objection = length.objection(value, "um")
        if objection is not None:
            raise ValueError(objection)
        return value

    return AfterValidator(check)


def _wavelengths(wavelengths: tuple[float, ...]) -> tuple[float, ...]:
    if len(wavelengths) < 2 or len(set(wavelengths)) < len(wavelengths):
        raise ValueError("must be two or more different wavelengths")
    return wavelengths


def _planes(planes: tuple[float, ...]) -> tuple[float, ...]:
    """Return distances of planes in ascending order, once they have been checked."""
    if not planes or min(planes) <= 0.0 or len(set(planes)) < len(planes):
        raise ValueError("must be distinct and greater than 0")
    return tuple(sorted(planes))


def _exposures(exposures: tuple[float, ...]) -> tuple[float, ...]:
    """Return exposures in ascending order, once they have been checked."""
    if not exposures or min(exposures) <= 0.0:
        raise ValueError("must be greater than 0")
    # Longest exposure, as a multiple of the one for the brightest pixel; the shortest is its reciprocal.
    longest_exposure = 1e9
    if max(exposures) > longest_exposure or min(exposures) < 1.0 / longest_exposure:
        raise ValueError(f"must be from {1.0 / longest_exposure:g} to {longest_exposure:g}")
    return tuple(sorted(exposures))


def _ascending(distances: tuple[float, ...]) -> tuple[float, ...]:
    steps = (after - before for before, after in pairwise(distances))
    if not distances or not all(map(math.isfinite, distances)) or any(step <= 0.0 for step in steps):
        raise ValueError("must be finite and ascending")
    return distances


def _pixels(value: Any) -> Any:
    """Return numbers of pixels from their text, such as 9344x7000."""
    if not isinstance(value, str) or value == "all":
        return value
    parts = value.split("x")
    if not all(part.strip().isdecimal() for part in parts) or len(parts) > 2:
        raise ValueError("must be a whole number, two numbers such as 9344x7000, or all")
    sides = [int(part) for part in parts]
    return sides[0] if len(sides) == 1 else (sides[0], sides[1])


Size = Annotated[float, AfterValidator(_finite_positive)]
Count = Annotated[int, AfterValidator(_finite_positive)]
Seed = Annotated[int, Field(ge=0)]
Wavelength = Annotated[float, _plausible(WAVELENGTH_UM)]
PixelPitch = Annotated[float, _plausible(PIXEL_PITCH_UM)]
Wavelengths = Annotated[tuple[Wavelength, ...], AfterValidator(_wavelengths)]
Planes = Annotated[Numbers, AfterValidator(_planes)]
Exposures = Annotated[Numbers, AfterValidator(_exposures)]
Layers = Annotated[Numbers, AfterValidator(_ascending)]
Pixels = Annotated[int | tuple[int, int] | Literal["all"] | None, BeforeValidator(_pixels)]
FilmIndex = Annotated[float, Field(gt=1.0, le=5.0)]
Region = tuple[float, float, float, float]
Points = Annotated[
    tuple[Pair, ...],
    setting(
        ..., "Centre x,y of an additional USAF chart with fine groups; may be repeated.", OptionGroup.OBJECT
    ),
]
FullWell = Annotated[
    float,
    setting(
        ...,
        "Full well in electrons.",
        options=["full_well_electrons", "full_well"],
        alias="full_well",
        ge=1.0,
        le=1e9,
    ),
]
ReadNoise = Annotated[
    float,
    setting(
        ...,
        "Read noise in electrons.",
        options=["read_noise_electrons", "read_noise"],
        alias="read_noise",
        ge=0.0,
        le=1e9,
    ),
]
Bits = Annotated[int, setting(..., "Bits of a count.", ge=1, le=16)]
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


class PatchSettings(Settings):
    """The square of the object plane that is imaged, its field stop, and the light on it."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    patch_mm: float | None = setting(None, "Side of the object patch; default: the whole field.")
    field_stop_mm: float | None = setting(None, "Diameter of the field stop; default: the patch.")
    field_stop_at_mm: Pair | None = setting(None, "x,y of the field stop's centre; default: on the axis.")
    object_pitch_um: float | None = setting(
        None, "Pitch of the object's samples; default: from the numerical aperture."
    )
    illumination: str = setting(
        "plane",
        "plane, tilted, gaussian, point, speckle, or FILE of a measured field.",
        OptionGroup.ILLUMINATION,
        metavar="[plane|tilted|gaussian|point|speckle]|FILE",
    )
    light_tilt_deg: Pair = setting((0.0, 0.0), "Angles x,y of tilted light.", OptionGroup.ILLUMINATION)
    waist_mm: float | None = setting(
        None, "Radius of the waist of a Gaussian beam.", OptionGroup.ILLUMINATION
    )
    source_distance_mm: float | None = setting(
        None,
        "Distance of a point source before the object; negative: its light converges behind it.",
        OptionGroup.ILLUMINATION,
    )
    speckle_na: float | None = setting(
        None, "Numerical aperture of speckle, the light of a diffuser.", OptionGroup.ILLUMINATION
    )
    speckle_seed: Seed = setting(0, "Seed of the random waves of speckle.", OptionGroup.ILLUMINATION)
    light_pitch_um: float | None = setting(
        None, "Sample pitch of a measured field whose file does not state it.", OptionGroup.ILLUMINATION
    )


class PoseSettings(Settings):
    """Pose of the lens as mounted, as in :class:`lensdesign.Pose`."""

    option_group: ClassVar[OptionGroup] = OptionGroup.MOUNTED_LENS

    decenter_x_mm: float = setting(0.0, "Shift of the lens as mounted, along x.")
    decenter_y_mm: float = setting(0.0, "Shift of the lens as mounted, along y.")
    despace_mm: float = setting(0.0, "Shift of the lens towards the sensor.")
    tilt_x_deg: float = setting(0.0, "Rotation of the lens about x.")
    tilt_y_deg: float = setting(0.0, "Rotation of the lens about y.")
    pivot_z_mm: float = setting(0.0, "Centre of rotation, from the front vertex.")

    @property
    def pose(self) -> Pose:
        """Pose of the lens."""
        return Pose(**{name: getattr(self, name) for name in PoseSettings.model_fields})


class EngineDetails(Settings):
    """Settings of single engines; None leaves the value to the engine."""

    option_group: ClassVar[OptionGroup] = OptionGroup.ENGINE

    tile_width_mm: Size | None = setting(None, "Width of a tile of the object (eikonal engine).")
    hierarchical: bool | None = setting(
        None, "Whether tiles form a hierarchy (eikonal engine); default: by their number."
    )
    slices: Count | None = setting(None, "Number of slices (engine slices).")
    compensation: str | None = setting(
        None, "Phase compensation (engine slices).", metavar="[vertical|oblique]"
    )
    interface: str | None = setting(
        None, "Treatment of surfaces within a step (engine wpm).", metavar="[substep|staircase]"
    )
    step_um: Size | None = setting(None, "Step along z (engine wpm).")
    pitch_um: Size | None = setting(None, "Pitch of the working grid (engines slices, wpm, thin-lens).")

    def details(self) -> dict[str, Any]:
        """Return the settings that are given, by their names in the engines."""
        names = (*EngineDetails.model_fields, "spacing")
        given = {name: getattr(self, name, None) for name in names}
        if self.pitch_um is not None:
            given |= {"pitch_um": None, "pitch_mm": 1e-3 * self.pitch_um}
        return {name: value for name, value in given.items() if value is not None}


class SingleEngineDetails(EngineDetails):
    """Settings of an engine that is run by its name."""

    spacing: str | None = setting(
        None, "Positions of the slices (engine slices).", metavar="[equal|paper|equal-phase]"
    )


class EngineSettings(EngineDetails):
    """The engine, and the error that it may have."""

    engine: str = setting(
        "auto",
        "Engine, or auto: the cheapest that meets the error limit.",
        metavar="[auto|eikonal|slices|wpm|thin-lens|no-lens]",
    )
    error: float | None = setting(None, "Allowed relative error of the exit field; default: 0.05.")


class LightSettings(Settings):
    """Polarization of the light, and coatings other than those of the design."""

    option_group: ClassVar[OptionGroup] = OptionGroup.ILLUMINATION

    polarization: str = setting(
        "auto",
        "Light: scalar waves, unpolarized, circular, or degrees of linear polarization from x; "
        "auto: scalar waves where their error is allowed.",
        metavar="[auto|scalar|unpolarized|circular]|DEG",
    )
    coating: Literal["ideal", "bare", "mgf2"] | None = setting(
        None, "Coating of all surfaces; default: the design's."
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

    memory_gb: Size | None = setting(None, "Memory limit; default: 80 % of what is free.")
    cluster: str | None = setting(
        None, "Dask scheduler (ADDRESS) whose workers compute the tiles of a whole field.", metavar="ADDRESS"
    )


class CameraSettings(Settings):
    """The sensor, its stage, and its exposures."""

    option_group: ClassVar[OptionGroup] = OptionGroup.CAMERA

    model_config = ConfigDict(loc_by_alias=False)

    planes_mm: Planes | None = setting(
        None,
        "Distances of the planes from the exit vertex; default: the design's.",
        options=["plane_distance_mm", "planes_mm"],
    )
    pixels: Pixels = setting(
        None,
        "Pixels along each side, or 9344x7000, or all; default: as many as the light covers.",
        metavar="SIDE|WIDTHxHEIGHT|all",
    )
    noise: bool = setting(True, "Simulate shot noise and read noise.")
    seed: Seed = setting(0, "Seed of the noise and of the tissue object.", OptionGroup.OUTPUT)
    full_well_electrons: FullWell = 10_000.0
    read_noise_electrons: ReadNoise = 2.0
    bits: Bits = 12
    peak_fill: float = setting(
        0.8,
        "Fraction of full well that the brightest pixel receives in exposure 1.",
        validation_alias=AliasChoices("peak_fill", "brightest_share"),
        ge=1e-6,
        le=1e6,
    )
    exposures: Exposures = setting(
        (1.0,), "Exposure times of each plane, relative to that for the peak fill."
    )
    fill_factor: float = setting(
        1.0,
        "Linear fill factor of a pixel (0 to 1).",
        validation_alias=AliasChoices("fill_factor", "active_width"),
    )
    stage_error_mm: Numbers = setting(
        (0.0,), "Error of the plane distance: one value, or one for each plane.", OptionGroup.CAMERA_ERRORS
    )
    shift_um: Pair = setting(
        (0.0, 0.0), "x,y shift of the sensor from plane to plane.", OptionGroup.CAMERA_ERRORS
    )


class ObjectSettings(Settings):
    """An object on the patch, and the wavelength of its light."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    wavelength_um: Wavelength | None = setting(
        None, "Wavelength; default: the design's first.", OptionGroup.ILLUMINATION
    )
    ground: Literal["bright", "dark"] = setting(
        "bright", "Bright or dark background of a chart (usaf, star)."
    )
    chart_at_mm: Points = ()
    ghost: float = setting(
        0.0,
        "Ghost of the lens: product of the reflectances of both outer surfaces.",
        OptionGroup.MOUNTED_LENS,
        ge=0.0,
        le=1.0,
    )
    ghosts: Literal["none", "coherent", "incoherent"] = setting(
        "none",
        "All ghosts by the coatings: between lens surfaces with their fringes (coherent) or as "
        "smooth light (incoherent); those of cover glass and sensor as smooth light.",
        OptionGroup.MOUNTED_LENS,
    )
    picture_pixel_um: Size | None = setting(
        None, "Side of a picture's pixel on the object; default: fitted to the field stop."
    )
    picture_width_mm: Size | None = setting(
        None, "Width of a picture on the object; default: fitted to the field stop."
    )


class ColourObjectSettings(Settings):
    """Wavelengths recorded together, filters on the pixels, and objects that depend on the wavelength."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    wavelengths_um: Wavelengths | None = setting(
        None,
        "Wavelengths that the sensor records at once, or one after the other with --all-wavelengths.",
        OptionGroup.ILLUMINATION,
    )
    colour_filters: str = setting(
        "monochrome",
        "Filters on the pixels, of light of several wavelengths: monochrome (none), bayer, or "
        "FILE (TOML) of a pattern and its responses.",
        OptionGroup.CAMERA,
        metavar="[monochrome|bayer]|FILE",
    )
    channels: bool = setting(
        False, "Whether a colour picture transmits a wavelength as its red, green or blue channel does."
    )
    thickness_um: Size | None = setting(
        None,
        "The object is a clear film of this thickness where its amplitude is 1, and thinner in "
        "proportion elsewhere.",
    )
    film_index: FilmIndex | None = setting(None, "Refractive index of such a film, in air; default: 1.5.")


class LayerSettings(Settings):
    """Positions of the layers of an object that has several."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    layers_um: Layers | None = setting(
        None,
        "Distances of the object's layers from the object plane, positive towards the lens, in "
        "the order in which light passes them; default: one layer in the object plane.",
    )


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

    patch_mm: float = setting(0.1, "Side of the object patch.")


class FrameSetSettings(Settings):
    """Properties of frames that their files do not state; one value for all frames, or one for each."""

    option_group: ClassVar[OptionGroup] = OptionGroup.FRAMES

    plane_distance_mm: Numbers | None = setting(
        None,
        "Distance of each frame's plane from the exit vertex, in the order of FRAMES; default: "
        "as the frames state.",
    )
    exposure: Numbers | None = setting(
        None, "Exposure of each frame, in any unit; default: as the frames state."
    )
    pixel_pitch_um: PixelPitch | None = setting(
        None, "Pixel pitch of the frames; default: as the frames state."
    )
    wavelength_um: Wavelength | None = setting(None, "Wavelength of the frames; default: as they state.")
    bits: int | None = setting(None, "Bits of a count.")
    offset_counts: float | None = setting(None, "Count of a dark pixel.")
    gain_electrons_per_count: float | None = setting(None, "Gain of the sensor.")
    read_noise_electrons: float | None = setting(None, "Read noise of the sensor.")
    saturation_counts: int | None = setting(
        None,
        "Lowest count of a pixel that may be clipped; default: the largest count, or one that "
        "many of the brightest pixels share.",
    )
    nonlinearity: float | None = setting(
        None,
        "Relative increase of the light over that of a linear camera, at the largest count; "
        "default: as the frames state.",
    )
    flat: Path | None = setting(
        None, "FILE of a flat frame (even light), in counts: TIFF, PNG or .npy.", metavar="FILE"
    )
    dark: Path | None = setting(
        None, "FILE of a dark frame (no light), in counts: TIFF, PNG or .npy.", metavar="FILE"
    )
    bad_pixels: Path | None = setting(None, "FILE of a mask in which bad pixels are not 0.", metavar="FILE")


class FramedSettings(EngineSettings, PatchSettings):
    """Settings that reconstructions and calibrations share."""

    option_group: ClassVar[OptionGroup] = OptionGroup.SOLVER

    kind: Kind = setting(
        "complex",
        "Kind of the object: complex, amplitude (without phase), or phase (without absorption).",
        OptionGroup.OBJECT,
    )
    field_stop: Literal["stated", "find"] = setting(
        "stated",
        "stated, or find: estimate from the frames the diameter or position that is not given.",
        OptionGroup.OBJECT,
    )
    scale: float | None = setting(
        None, "Recorded amplitude where the transmission is 1; default: fitted.", OptionGroup.OBJECT
    )
    fill_factor: float = setting(
        1.0,
        "Linear fill factor of a pixel (0 to 1).",
        OptionGroup.CAMERA,
        validation_alias=AliasChoices("fill_factor", "active_width"),
        ge=0.0,
        le=1.0,
    )
    source_deg: float | Literal["find"] | None = setting(
        None,
        "Diameter of the light source (partial coherence), or find; default: calibrated, or 0.",
        OptionGroup.ILLUMINATION,
    )
    bandwidth_nm: float | Literal["find"] | None = setting(
        None,
        "Full width of the light's rectangular spectrum, or find; default: calibrated, or 0.",
        OptionGroup.ILLUMINATION,
    )

    verdict: Verdict = setting(
        "full", "Tests of the result: full, quick (residuals alone), or none.", OptionGroup.EVALUATION
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

    method: Literal["paper", "object"] = setting("object", "paper (Appendix A) or object.")
    iterations: int | None = setting(
        None, "Largest number of iterations; default: 80, or 500 with --method paper.", ge=1
    )
    tv_weight: float | Literal["auto"] = setting(
        "auto", "Weight of the total variation (method object); auto: from the noise."
    )
    start: str | None = setting(
        None,
        "Start: model, uniform or random for paper; even or amplitude for object.",
        metavar="[model|uniform|random|even|amplitude]",
    )
    refocus_mm: Pair | None = setting(
        None, "low,high: range in which the focus is searched.", metavar="LOW,HIGH"
    )
    usaf: Literal["bright", "dark"] | None = setting(
        None, "The object is a USAF chart with a bright or dark background.", OptionGroup.OBJECT
    )
    chart_at_mm: Points = ()
    hold_out_plane: int | None = setting(
        None,
        "Number of a plane, from 1, that is only predicted and compared (method object).",
        OptionGroup.EVALUATION,
    )
    starts: int = setting(1, "Number of starts, whose results are compared (method object).", ge=1)
    region_mm: Region | None = setting(
        None,
        "x,y,width,height: region of the object that is evaluated and written.",
        OptionGroup.EVALUATION,
        metavar="X,Y,WIDTH,HEIGHT",
    )

    @field_validator("start")
    @classmethod
    def _start_of_method(cls, start: str | None, info: ValidationInfo) -> str | None:
        method = info.data.get("method", "object")
        if start is not None and start not in STARTS[method]:
            raise ValueError(f"allowed for {method}: {', '.join(STARTS[method])}")
        return start

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

    kind: Literal["complex", "amplitude", "thickness"] = setting(
        "complex",
        "Object: complex or amplitude at each wavelength, or a grey film whose thickness all "
        "wavelengths share.",
        OptionGroup.OBJECT,
    )
    iterations: int = setting(150, "Largest number of iterations.", ge=1)
    tv_weight: float | Literal["auto"] = setting(
        "auto", "Weight of the total variation; auto: from the noise."
    )
    start: Literal["even", "amplitude"] = setting(
        "even", "Start: even, or amplitude: first iterations seek an amplitude object."
    )
    scale: Size | None = setting(
        None, "Recorded amplitude where the transmission is 1; default: fitted.", OptionGroup.OBJECT
    )
    fill_factor: float = setting(
        1.0, "Linear fill factor of a pixel (0 to 1).", OptionGroup.CAMERA, ge=0.0, le=1.0
    )
    film_index: FilmIndex | None = setting(
        None,
        "Refractive index of a film in air, whose height is then found from all wavelengths.",
        OptionGroup.OBJECT,
    )
    heights_um: Pair | None = setting(
        None,
        "Lowest and highest possible height; default: the range that is unambiguous.",
        OptionGroup.OBJECT,
        metavar="LOW,HIGH",
    )
    ground_mm: Region | None = setting(
        None,
        "x,y,width,height of a region whose height is 0; default: the most common phase.",
        OptionGroup.OBJECT,
        metavar="X,Y,WIDTH,HEIGHT",
    )
    repeats: int = setting(
        10,
        "Repeats with other noise, from which the deviations of heights follow.",
        OptionGroup.EVALUATION,
        ge=2,
        le=1000,
    )
    seed: Seed = setting(0, "Seed of that noise.", OptionGroup.OUTPUT)

    @field_validator("tv_weight")
    @classmethod
    def _weight(cls, weight: float | str) -> float | str:
        if not isinstance(weight, str) and not 0.0 <= weight < math.inf:
            raise ValueError("must be finite and not negative, or 'auto'")
        return weight

    @field_validator("heights_um")
    @classmethod
    def _increasing(cls, heights: Pair | None) -> Pair | None:
        if heights is not None and not heights[0] < heights[1]:
            raise ValueError("must be two increasing numbers")
        return heights


class FreeSpaceSettings(Settings):
    """Frames that were recorded without a lens, and planes that are predicted from them."""

    option_group: ClassVar[OptionGroup] = OptionGroup.FREE_SPACE

    free_space: bool = setting(
        False, "Reconstruct the field on z = 0 from frames without a lens, on their pitch."
    )
    calibrate: bool = setting(
        False, "First calibrate the bench; in free space: distances, drift and exposures.", OptionGroup.SOLVER
    )
    numerical_aperture: Size | None = setting(
        None, "Numerical aperture of light in free space; default: from the frames' spectra."
    )
    predict_mm: Numbers | None = setting(
        None, "Distances of further planes in free space whose amplitudes are predicted."
    )


class LayerReconstructionSettings(LayerSettings):
    """Layers of an object that are reconstructed from frames."""

    option_group: ClassVar[OptionGroup] = OptionGroup.OBJECT

    undetermined_layers: bool = setting(
        False,
        "Reconstruct layers even if the frames do not determine them: the result is one of many "
        "solutions, with few edges.",
    )


class PlanSettings(Settings):
    """Settings of :func:`wavesim.calibration.plan_frames`."""

    option_group: ClassVar[OptionGroup] = OptionGroup.CAMERA

    model_config = ConfigDict(loc_by_alias=False)

    kind: Kind = setting("complex", "Kind of the object.", OptionGroup.OBJECT)
    patch_mm: Size | None = setting(
        None, "Side of the object patch; default: the whole field.", OptionGroup.OBJECT
    )
    wavelength_um: Annotated[Size, _plausible(WAVELENGTH_UM)] | None = setting(
        None, "Wavelength; default: the design's first.", OptionGroup.ILLUMINATION
    )
    planes_mm: Pair | None = setting(
        None,
        "Distances of the nearest and farthest plane; default: the design's.",
        metavar="NEAREST,FARTHEST",
        options=["plane_distance_mm", "planes_mm"],
    )
    most_planes: int = setting(
        4,
        "Largest number of planes, which are evenly spaced.",
        options=["max_planes", "most_planes"],
        ge=1,
        le=8,
    )
    exposures: Exposures = setting(
        (1.0, 30.0, 1000.0), "Exposure bracket; it is compared with its shortest exposure alone."
    )
    correlation: float = setting(
        0.99, "Required correlation of the object.", OptionGroup.EVALUATION, gt=0.0, lt=1.0
    )
    full_well_electrons: FullWell = 10_000.0
    read_noise_electrons: ReadNoise = 2.0
    bits: Bits = 12
    seed: Seed = setting(0, "Seed of object and noise.", OptionGroup.OUTPUT)

    @field_validator("planes_mm")
    @classmethod
    def _apart(cls, planes: Pair | None) -> Pair | None:
        if planes is not None and not 0.0 < planes[0] < planes[1]:
            raise ValueError("must be two numbers, increasing and greater than 0")
        return planes


class CalibrationSettings(FramedSettings):
    """Settings of :func:`wavesim.calibrate_frames`."""

    option_group: ClassVar[OptionGroup] = OptionGroup.SOLVER

    engine: str = setting(
        "auto",
        "Engine, or auto: eikonal for the search, and the cheapest that meets the error limit "
        "for the verdict.",
        metavar="[auto|eikonal|slices|wpm|thin-lens|no-lens]",
    )
    iterations: int = setting(5, "Iterations of each reconstruction within the search.", ge=1)
    most_mountings: int = setting(
        80, "Largest number of benches that are tested.", options=["max_mountings", "most_mountings"], ge=1
    )
    parameters: str = setting(
        "all",
        "Unknowns: all, groups, rigid (decenter and tilt of the lens), or names separated by "
        "commas; a wrong name lists them.",
        metavar="[all|light|lens|mounting|camera|rigid]|NAME,...",
    )
    pivot_z_mm: float = setting(0.0, "Centre of rotation, from the front vertex.", OptionGroup.MOUNTED_LENS)
    deviations: bool = setting(
        True,
        "State standard deviations; return parameters that are not needed to nominal.",
        OptionGroup.EVALUATION,
    )
