"""Scenes of a design: a patch of its object, and the light of the whole field on a plane behind the lens."""

from __future__ import annotations

import math

import scipy.fft

from lensdesign.analysis.exit_beam import footprint, largest_spread_angle
from lensdesign.errors import InputError, SamplingError, validate_positive
from lensdesign.lens.lengths import LensLengths
from lensdesign.lens.lens import Lens
from wavesim.fields.field import Grid
from wavesim.scene.scene import Scene, wavelength_of

OBJECT_FINENESS, EXIT_FINENESS = 0.8, 0.9
"""Pitch of a patch's grids, as fractions of half the period of the finest fringes."""

FIELD_MARGIN = 1.02
"""Largest side of a patch over the design's field diameter. A field stop slightly exceeds the field."""

MOST_SAMPLES = 400_000_000
"""Most samples of one grid. More would not fit into a workstation's memory."""


LONGEST_SIDE = 10_000_000
"""Most samples along one side of an object. The limit exceeds any memory, so that costs can be predicted."""


def patch_scene(
    lens: Lens,
    patch_mm: float,
    field_mm: float = 0.0,
    *,
    plane_distance_mm: float = 2.0,
    wavelength_um: float | None = None,
    meridional: bool = False,
    object_pitch_um: float | None = None,
) -> Scene:
    """Return the scene of a square patch of the object, or of its meridional line.

    The exit grid covers the footprint of the whole field.

    Parameters
    ----------
    lens
        The nominal lens.
    patch_mm
        Side of the patch in mm.
    field_mm
        Height of the patch's centre along y, in mm.
    plane_distance_mm
        Distance from the exit vertex to the exit plane in mm.
    wavelength_um
        Vacuum wavelength in um. Default: the design's first wavelength.
    meridional
        Whether the scene is a line along y instead of a plane.
    object_pitch_um
        Pitch of the object grid in um. Default: 80 % of the pitch that just samples light of the design's
        numerical aperture.

    Returns
    -------
    Scene
        The scene of the nominal lens with the coatings of its design.

    Raises
    ------
    InputError
        If the patch is wider than the field, narrower than two samples, or lies outside the field, or if no
        ray passes the lens.
    SamplingError
        If the patch has more than `LONGEST_SIDE` samples along a side.

    Examples
    --------
    >>> from lensdesign import load_design
    >>> from wavesim import patch_scene
    >>> scene = patch_scene(load_design("designs/paper_singlet.toml"), 0.01, meridional=True)
    >>> scene.object_grid.shape
    (24,)
    """
    wavelength = wavelength_of(lens, wavelength_um)
    _validate_patch(lens, patch_mm, field_mm)
    if object_pitch_um is None:
        object_pitch_um = OBJECT_FINENESS * 0.5 * wavelength / lens.object.numerical_aperture
    validate_positive("object_pitch_um", object_pitch_um)
    pitch = 1e-3 * object_pitch_um
    if not patch_mm >= 2.0 * pitch:
        raise InputError(
            f"patch_mm = {patch_mm:g}: narrower than 2 samples of object_pitch_um = {object_pitch_um:g}; "
            f"give {2.0 * pitch:g} or more"
        )
    if patch_mm / pitch > LONGEST_SIDE:
        raise SamplingError(
            f"object_pitch_um = {object_pitch_um:g}: {patch_mm / pitch:.3g} samples along patch_mm = "
            f"{patch_mm:g}; at most {LONGEST_SIDE} are allowed"
        )
    count = scipy.fft.next_fast_len(math.ceil(patch_mm / pitch))
    dimensions = 1 if meridional else 2
    return Scene(
        lens,
        Grid((count,) * dimensions, pitch, lens.object_z_mm, (0.0, float(field_mm))),
        exit_grid(lens, wavelength, plane_distance_mm, dimensions),
        wavelength,
    )


def exit_grid(lens: Lens, wavelength_um: float, plane_distance_mm: float, dimensions: int) -> Grid:
    """Return a grid that samples the light of the whole field on a plane behind the lens.

    Parameters
    ----------
    lens
        The nominal lens.
    wavelength_um
        Vacuum wavelength.
    plane_distance_mm
        Distance from the exit vertex.
    dimensions
        1 for a meridional line, 2 for a plane.

    Raises
    ------
    InputError
        If no ray passes the lens.
    SamplingError
        If the grid needs more than `MOST_SAMPLES` samples.
    """
    margin = 1.02
    # In air the light is at least as wide as behind a cover glass, which need not fit in front of this plane.
    in_air = lens.without_cover_glass()
    half = margin * footprint(in_air, wavelength_um, plane_distance_mm).radius_mm
    sine = math.sin(math.radians(largest_spread_angle(lens, wavelength_um).spread_deg))
    pitch = EXIT_FINENESS * 0.5e-3 * wavelength_um / (lens.sensor_medium_index(wavelength_um) * sine)
    if (2.0 * half / pitch) ** dimensions > MOST_SAMPLES:
        raise SamplingError(
            f"plane_distance_mm = {plane_distance_mm:g}: the field's light is {2.0 * half:.3g} mm wide and "
            f"needs a pitch of {1e3 * pitch:.3g} µm, which exceeds {MOST_SAMPLES:.3g} samples (the limit)"
        )
    count = scipy.fft.next_fast_len(math.ceil(2.0 * half / pitch))
    return Grid((count,) * dimensions, pitch, lens.exit_vertex_z_mm + plane_distance_mm)


def validate_within_field(lens: Lens, patch_mm: float) -> None:
    """Check that the design's field contains a patch.

    Raises
    ------
    InputError
        If the side is not above 0, or exceeds `FIELD_MARGIN` times the field diameter.
    """
    if not 0.0 < patch_mm <= FIELD_MARGIN * lens.object.field_diameter_mm:
        plausible = LensLengths.of(lens).plausible_mm("patch")
        hint = plausible.hint(patch_mm, "mm") if plausible is not None and patch_mm > 0.0 else ""
        raise InputError(
            f"patch_mm = {patch_mm:g}: must be above 0 and at most {FIELD_MARGIN:g} times the design's "
            f"field_diameter_mm = {lens.object.field_diameter_mm:g}{hint}"
        )


def _validate_patch(lens: Lens, patch_mm: float, field_mm: float) -> None:
    validate_within_field(lens, patch_mm)
    if not abs(field_mm) <= lens.half_field_mm:
        raise InputError(
            f"field height = {field_mm:g} mm: must lie within the half field of {lens.half_field_mm:g} mm"
        )
