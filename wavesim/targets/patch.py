"""Patches of a design's object plane, with an object and its illumination.

A patch is a square of the object plane about the axis, with a round field stop. The commands `wavesim image`
and `wavesim reconstruct` use these functions.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal
from zipfile import is_zipfile

import numpy as np
import scipy.fft

from lensdesign.common.memory import check_memory
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError, validate_positive
from lensdesign.lens.lens import Lens
from wavesim.fields.field import Field, Grid
from wavesim.fields.files import read_centre_um
from wavesim.scene.patches import OBJECT_FINENESS, validate_within_field
from wavesim.scene.scene import wavelength_of
from wavesim.scene.settings import PatchSettings, SettingError
from wavesim.targets.illumination import (
    field_stop,
    gaussian_beam,
    measured_field,
    plane_wave,
    point_source,
    speckle,
)
from wavesim.targets.patterns import (
    Polarity,
    phase_target,
    picture_pixel,
    picture_target,
    read_grey,
    siemens_star,
)
from wavesim.targets.phantom import tissue_phantom
from wavesim.targets.usaf import UsafElement, usaf_chart, usaf_elements_beside, usaf_elements_within

LIGHT_BYTES = 25
"""Peak memory (bytes) of each sample while the illumination is computed, measured."""

SPOKES, STAR_RADIUS = 36, 0.45
"""Number of spokes of the Siemens star, and its radius as a fraction of the field stop's diameter."""

OBJECT_FILE = "object.npz"

PADS, PAD_SHARE, PAD_PHASE_RAD = 4, 0.08, 0.5 * math.pi
"""Phase target: number of pads, side of a pad as a fraction of the stop's diameter, phase of the last pad."""


@dataclass(frozen=True)
class Patch:
    """A square of the object plane about the axis, and the round field stop in it.

    Attributes
    ----------
    grid : Grid
        Samples of the object plane.
    field_stop_mm : float
        Diameter of the stop (mm).
    wavelength_um : float
        Vacuum wavelength (um).
    field_stop_at_mm : (x, y)
        Centre of the stop relative to the axis (mm).
    """

    grid: Grid
    field_stop_mm: float
    wavelength_um: float
    field_stop_at_mm: tuple[float, float] = (0.0, 0.0)

    @property
    def inside(self) -> Any:
        """True where the centre of a sample lies within the stop, shape (ny, nx)."""
        x, y = self.field_stop_at_mm
        squared = (self.grid.y_mm[:, None] - y) ** 2 + (self.grid.x_mm[None, :] - x) ** 2
        return squared <= (0.5 * self.field_stop_mm) ** 2

    @property
    def stop_words(self) -> str:
        """Text with the diameter of the field stop and, if it is not on the axis, its position."""
        return stop_words(self.field_stop_mm, self.field_stop_at_mm)

    def with_stop(self, field_stop_mm: float, at_mm: tuple[float, float]) -> Patch:
        """Return a patch with the same samples and another field stop."""
        return replace(self, field_stop_mm=field_stop_mm, field_stop_at_mm=at_mm)


def stop_words(field_stop_mm: float, at_mm: Sequence[float]) -> str:
    """Return text with the diameter of a field stop and, if it is not on the axis, its position."""
    text = f"field stop {field_stop_mm:.4g} mm"
    return text if not any(at_mm) else f"{text} at {at_mm[0]:.4g}, {at_mm[1]:.4g} mm"


@dataclass(frozen=True, eq=False)
class Target:
    """An object to be imaged.

    Attributes
    ----------
    name : str
        Kind of object, or the file that it came from.
    transmission : Field
        Complex transmission on the patch.
    elements : tuple of UsafElement
        Elements of the USAF charts, those of the central chart first; empty for other objects.
    polarity : {"bright", "dark"}
        Transmission of the field around the shapes of a chart.
    """

    name: str
    transmission: Field
    elements: tuple[UsafElement, ...]
    polarity: Polarity


def object_patch(
    lens: Lens,
    patch_mm: float,
    field_stop_mm: float | None = None,
    *,
    wavelength_um: float | None = None,
    object_pitch_um: float | None = None,
    field_stop_at_mm: tuple[float, float] = (0.0, 0.0),
) -> Patch:
    """Return a patch of a design's object plane.

    Parameters
    ----------
    lens
        The nominal lens.
    patch_mm
        Side of the square (mm).
    field_stop_mm
        Diameter of the field stop (mm). Default: the side of the square.
    wavelength_um
        Vacuum wavelength (um). Default: the design's first wavelength.
    object_pitch_um
        Sample pitch (um). Default: 80 % of the pitch that just samples light of the design's numerical
        aperture.
    field_stop_at_mm
        Centre (x, y) of the field stop relative to the axis (mm).

    Returns
    -------
    Patch
        The patch.

    Raises
    ------
    InputError
        If the patch is larger than the design's field, or the field stop reaches beyond the patch.
    MemoryLimitError
        If the samples do not fit into memory.
    """
    wavelength = wavelength_of(lens, wavelength_um)
    validate_within_field(lens, patch_mm)
    x, y = field_stop_at_mm
    if not (math.isfinite(x) and math.isfinite(y)):
        raise InputError(f"field_stop_at_mm = {x!r}, {y!r}: must be finite")
    room_mm = patch_mm - 2.0 * max(abs(x), abs(y))
    stop_mm = patch_mm if field_stop_mm is None else field_stop_mm
    if not 0.0 < stop_mm <= patch_mm:
        raise InputError(f"field_stop_mm = {stop_mm:g}: must be above 0 and at most patch_mm = {patch_mm:g}")
    if stop_mm > room_mm * (1.0 + 1e-9) + 1e-12:
        raise InputError(
            f"field_stop_at_mm = {x:g},{y:g}: a field stop of {stop_mm:g} mm at this position reaches beyond "
            f"the patch of {patch_mm:g} mm; give a smaller field_stop_mm, or a larger patch_mm"
        )
    if object_pitch_um is None:
        object_pitch_um = OBJECT_FINENESS * 0.5 * wavelength / lens.object.numerical_aperture
    validate_positive("object_pitch_um", object_pitch_um)
    side = 1e3 * patch_mm / object_pitch_um
    check_memory(
        LIGHT_BYTES * max(side, 1.0) * side,
        f"object_pitch_um = {object_pitch_um:g}: an object of {side:.3g} x {side:.3g} samples",
        "give a larger object_pitch_um or a smaller patch_mm",
    )
    count = scipy.fft.next_fast_len(max(4, math.ceil(1e3 * patch_mm / object_pitch_um - 1e-9)))
    grid = Grid((count, count), 1e-3 * object_pitch_um, lens.object_z_mm)
    return Patch(grid, stop_mm, wavelength, (float(x), float(y)))


def usaf_elements_of(patch: Patch) -> tuple[UsafElement, ...]:
    """Return the USAF elements that fit the square inside a field stop and that the samples resolve.

    Raises
    ------
    InputError, SamplingError
        See :func:`wavesim.targets.usaf.usaf_elements_within`.
    """
    inscribed_mm = 1.0 / math.sqrt(2.0) * patch.field_stop_mm
    return usaf_elements_within(_about_stop(patch), inscribed_mm)


def usaf_charts_of(
    patch: Patch, chart_at_mm: Sequence[tuple[float, float]] = ()
) -> tuple[tuple[UsafElement, ...], ...]:
    """Return the elements of the USAF chart at the field stop's centre, and of additional fine charts.

    Parameters
    ----------
    patch
        Patch of the object plane.
    chart_at_mm
        Centres (x, y) of the additional charts relative to the axis (mm).

    Returns
    -------
    tuple of tuple of UsafElement
        Elements of the central chart, and of each additional chart.

    Raises
    ------
    InputError, SamplingError
        See :func:`usaf_elements_of` and :func:`wavesim.targets.usaf.usaf_elements_beside`.
    """
    charts, (x, y) = [usaf_elements_of(patch)], patch.field_stop_at_mm
    for point in chart_at_mm:
        beside = point[0] - x, point[1] - y
        charts.append(usaf_elements_beside(_about_stop(patch), beside, patch.field_stop_mm, charts))
    return tuple(charts)


def _about_stop(patch: Patch) -> Grid:
    """Return a grid of the same pitch and shape, centred on the field stop."""
    return replace(patch.grid, centre_mm=patch.field_stop_at_mm)


def make_target(
    patch: Patch,
    name: str,
    polarity: Polarity = "bright",
    *,
    numerical_aperture: float,
    seed: int = 0,
    picture_pixel_um: float | None = None,
    picture_width_mm: float | None = None,
    chart_at_mm: Sequence[tuple[float, float]] = (),
    channel: int | None = None,
) -> Target:
    """Return an object on a patch: a chart, a star, a phase target, tissue, a picture, or an empty field.

    The object is centred on the field stop; a star, a phase target and a picture on the sample nearest to the
    stop's centre. Tissue fills the patch.

    Parameters
    ----------
    patch
        Patch of the object plane.
    name
        "usaf", "star", "phase", "tissue", "empty", or the path of a picture whose grey values represent
        intensity.
    polarity
        Bright or dark field of charts and stars.
    numerical_aperture, seed
        Numerical aperture of the tissue's band limit, and seed of its random shapes.
    picture_pixel_um, picture_width_mm
        Side of a picture's pixel on the object, or width of the picture. Default: its corners touch the field
        stop. Pixels finer than the samples are averaged, unless `picture_pixel_um` is given; then they are an
        error.
    chart_at_mm
        Centres (x, y) of additional charts with the fine groups of the USAF chart.
    channel
        Index of the channel of a colour picture (red, green, blue); default: its luma.

    Returns
    -------
    Target
        The object with its transmission.

    Raises
    ------
    InputError
        If there is no such object, or it is larger than the field stop.
    SamplingError
        If the patch's samples are too coarse for it.
    """
    grid, stop_mm = patch.grid, patch.field_stop_mm
    wider, cut = _wider_about_stop(patch)
    elements: tuple[UsafElement, ...] = ()
    if chart_at_mm and name != "usaf":
        raise InputError(f"chart_at_mm: requires object = 'usaf', not {name!r}")
    if name == "usaf":
        elements = tuple(one for chart in usaf_charts_of(patch, chart_at_mm) for one in chart)
        values = usaf_chart(grid, elements, polarity)
    elif name in MAKERS:
        fills = name in ("tissue", "empty")
        made = MAKERS[name](patch if fills else wider, polarity, numerical_aperture, seed)
        values = made if fills else made[cut]
    elif not (Path(name).suffix or Path(name).exists()):
        known = ("usaf", *MAKERS)
        raise InputError(
            f"object = {name!r}: allowed: {', '.join(known)}, or the file of a picture"
            f"{did_you_mean(name, known)}"
        )
    else:
        rows, columns = read_grey(name).shape
        pixel_um = picture_pixel((rows, columns), stop_mm, picture_pixel_um, picture_width_mm)
        finer: Literal["refuse", "average"] = "average" if picture_pixel_um is None else "refuse"
        values = picture_target(name, wider.grid, pixel_um, finer=finer, channel=channel)[cut]
    transmission = Field(grid, np.asarray(values, np.complex64), patch.wavelength_um)
    return Target(name, transmission, elements, polarity)


def _wider_about_stop(patch: Patch) -> tuple[Patch, tuple[slice, slice]]:
    """Return a patch centred on the sample nearest to the stop's centre, and `patch` as slices of it."""
    rows, columns = patch.grid.shape
    across, down = (round(offset / patch.grid.pitch_mm) for offset in patch.field_stop_at_mm)
    shape = rows + 2 * abs(down), columns + 2 * abs(across)
    cut = (
        slice(abs(down) - down, abs(down) - down + rows),
        slice(abs(across) - across, abs(across) - across + columns),
    )
    return replace(patch, grid=replace(patch.grid, shape=shape), field_stop_at_mm=(0.0, 0.0)), cut


def _star(patch: Patch, polarity: Polarity, _aperture: float, _seed: int) -> Any:
    # The inner ends of the spokes are as narrow as the samples can resolve.
    per_pitch = 1.05 / math.sin(0.5 * math.pi / SPOKES)
    inner_mm, radius_mm = per_pitch * patch.grid.pitch_mm, STAR_RADIUS * patch.field_stop_mm
    if inner_mm >= radius_mm:
        width_um = 2e3 * radius_mm * math.sin(0.5 * math.pi / SPOKES)
        raise SettingError(
            f"object star: samples of {1e3 * patch.grid.pitch_mm:.3g} µm cannot represent its {SPOKES} "
            f"spokes, which are {width_um:.3g} µm wide at the rim (without {{object_pitch_um}}, samples "
            f"follow the lens's numerical aperture): give {{object_pitch_um}} below "
            f"{1e3 * radius_mm / per_pitch:.3g}, a patch ({{patch_mm}}) above "
            f"{inner_mm / STAR_RADIUS:.3g} mm, or another object"
        )
    return siemens_star(patch.grid, SPOKES, radius_mm, inner_mm, polarity)


def _phase(patch: Patch, _polarity: Polarity, _aperture: float, _seed: int) -> Any:
    return phase_target(patch.grid, 1e3 * PAD_SHARE * patch.field_stop_mm, PAD_PHASE_RAD, PADS)


def _tissue(patch: Patch, _polarity: Polarity, aperture: float, seed: int) -> Any:
    return tissue_phantom(patch.grid, seed, patch.wavelength_um, aperture)


def _empty(patch: Patch, _polarity: Polarity, _aperture: float, _seed: int) -> Any:
    return np.ones(patch.grid.shape)


MAKERS: dict[str, Callable[[Patch, Polarity, float, int], Any]] = {
    "star": _star,
    "phase": _phase,
    "tissue": _tissue,
    "empty": _empty,
}
"""Functions that make the other built-in objects, by name."""


def make_illumination(
    patch: Patch,
    name: str = "plane",
    *,
    tilt_deg: tuple[float, float] = (0.0, 0.0),
    waist_mm: float | None = None,
    source_distance_mm: float | None = None,
    speckle_na: float | None = None,
    speckle_seed: int = 0,
    pitch_um: float | None = None,
) -> Field:
    """Return the illumination of a patch, limited by its field stop.

    Parameters
    ----------
    patch
        Patch of the object plane.
    name
        "plane", "tilted", "gaussian", "point", "speckle", or the path of a measured field.
    tilt_deg : (x, y)
        Angles of a tilted plane wave (deg).
    waist_mm
        Radius of the Gaussian beam's waist (mm), which lies in the object plane. Default: half the radius of
        the field stop.
    source_distance_mm
        Distance (mm) of a point source before the object plane; negative where its light converges behind
        it. "point" requires it.
    speckle_na, speckle_seed
        Numerical aperture of speckle, and seed of its random waves. "speckle" requires the aperture.
    pitch_um
        Sample pitch (um) of a measured field whose file does not state it.

    Returns
    -------
    Field
        Illumination (complex64).

    Raises
    ------
    InputError
        If there is no such illumination, or a value is out of range.
    SamplingError
        If the samples of the patch are too coarse for the illumination.
    """
    grid, wavelength = patch.grid, patch.wavelength_um
    known = ("plane", "tilted", "gaussian", "point", "speckle")
    if name == "plane":
        light = plane_wave(grid, wavelength)
    elif name == "tilted":
        light = plane_wave(grid, wavelength, tilt_x_deg=tilt_deg[0], tilt_y_deg=tilt_deg[1])
    elif name == "gaussian":
        light = gaussian_beam(grid, wavelength, 0.25 * patch.field_stop_mm if waist_mm is None else waist_mm)
    elif name == "point":
        if source_distance_mm is None:
            raise SettingError("{illumination} point: requires {source_distance_mm}")
        light = point_source(grid, wavelength, source_distance_mm)
    elif name == "speckle":
        if speckle_na is None:
            raise SettingError("{illumination} speckle: requires {speckle_na}")
        light = speckle(grid, wavelength, speckle_na, speckle_seed)
    elif Path(name).suffix or Path(name).exists():
        light = measured_field(name, grid, wavelength, pitch_um)
    else:
        raise InputError(
            f"illumination = {name!r}: allowed: {', '.join(known)}, or the file of a measured field"
            f"{did_you_mean(name, known)}"
        )
    light = light.with_values(light.values.astype(np.complex64))
    stop = field_stop(grid, "disc", patch.field_stop_mm, at_mm=patch.field_stop_at_mm)
    light.values[...] *= stop.astype(np.float32)
    return light


def object_file(wavelength_um: float) -> str:
    """Return the name of the file with an object's transmission at one of several wavelengths."""
    return f"object_{wavelength_um:g}_um.npz"


def read_coloured_object(folder: Path, patch: Patch, wavelengths_um: Sequence[float]) -> tuple[Field, ...]:
    """Read the transmission of an object at several wavelengths, from a folder written by `wavesim image`.

    Parameters
    ----------
    folder
        Folder of frames at several wavelengths at once, or with a subfolder for each wavelength.
    patch
        Patch of the object plane.
    wavelengths_um
        Wavelengths.

    Raises
    ------
    InputError
        If the folder lacks a wavelength, or a file is invalid (:func:`read_object`).
    """
    found = []
    for wavelength in wavelengths_um:
        places = folder / object_file(wavelength), folder / f"{wavelength:g}_um" / OBJECT_FILE
        place = next((one for one in places if one.exists()), None)
        if place is None:
            raise InputError(
                f"{folder}: has no object at {wavelength:g} um: must contain {places[0].name}, or "
                f"{places[1].parent.name}/{OBJECT_FILE}"
            )
        found.append(read_object(place, replace(patch, wavelength_um=wavelength)))
    return tuple(found)


def read_object(path: Path, patch: Patch) -> Field:
    """Read the transmission of an object on a patch from a file.

    Parameters
    ----------
    path
        File (.npz) with `values` and `pitch_um`, or a folder written by `wavesim image`.
    patch
        Patch of the object plane.

    Returns
    -------
    Field
        Transmission on the patch.

    Raises
    ------
    InputError
        If the file cannot be read, covers less than the patch, or contains a region that is not centred on
        the axis.
    """
    place = path / OBJECT_FILE if path.is_dir() else path
    if is_zipfile(place) and (centre_um := read_centre_um(place)) != (0.0, 0.0):
        x_mm, y_mm = (1e-3 * c for c in centre_um)
        raise InputError(f"{place}: is centred at {x_mm:.4g}, {y_mm:.4g} mm; must be centred on the axis")
    return measured_field(place, patch.grid, patch.wavelength_um)


def layer_file(index: int) -> str:
    """Return the name of the file of a layer of an object, counted from 1."""
    return f"layer_{index}.npz"


def lit_patch(lens: Lens, settings: PatchSettings, wavelength_um: float | None = None) -> tuple[Patch, Field]:
    """Return the patch of a design's object plane that settings describe, and its illumination.

    Parameters
    ----------
    lens
        The nominal lens.
    settings
        Settings of the patch and the illumination.
    wavelength_um
        Vacuum wavelength (um). Default: the design's first wavelength.

    Raises
    ------
    InputError, SamplingError
        See :func:`object_patch` and :func:`make_illumination`.
    """
    patch = object_patch(
        lens,
        lens.object.field_diameter_mm if settings.patch_mm is None else settings.patch_mm,
        settings.field_stop_mm,
        wavelength_um=wavelength_um,
        object_pitch_um=settings.object_pitch_um,
        field_stop_at_mm=settings.field_stop_at_mm or (0.0, 0.0),
    )
    return patch, lit(patch, settings)


def lit(patch: Patch, settings: PatchSettings) -> Field:
    """Return the illumination of a patch that settings describe."""
    return make_illumination(
        patch,
        settings.illumination,
        tilt_deg=settings.light_tilt_deg,
        waist_mm=settings.waist_mm,
        source_distance_mm=settings.source_distance_mm,
        speckle_na=settings.speckle_na,
        speckle_seed=settings.speckle_seed,
        pitch_um=settings.light_pitch_um,
    )


def transmission_of(behind_object: Field, illumination: Field) -> Field:
    """Return the transmission of an object from the fields behind it and in front of it, on the same grid.

    The transmission is 0 where the illumination is dark.
    """
    power = np.abs(illumination.values) ** 2
    lit = power > 1e-6 * power.max()
    values = np.where(lit, behind_object.values * illumination.values.conj() / np.where(lit, power, 1.0), 0.0)
    return behind_object.with_values(values.astype(np.complex64))
