"""A scene: a lens in its position, the object grid, the exit grid, and the wavelength."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from lensdesign.errors import InputError, validate_positive
from lensdesign.lens.coatings.coating import SurfaceCoating
from lensdesign.lens.coatings.compiled import TableCoating
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose, SurfacePerturbation, trial_count
from lensdesign.raytrace.compiled import CompiledSystem, compile_system
from wavesim.fields.field import Field, Grid
from wavesim.scene.polarization import AUTO, is_vector, validate_polarization
from wavesim.scene.system_state import SystemState


@dataclass(frozen=True)
class Scene:
    """A lens, and the two grids between which a field is propagated.

    :func:`wavesim.patch_scene` makes the scene of a patch of the object. All positions of a scene are actual
    ones; :func:`placed_scene` derives them from a nominal scene and a state.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    object_grid, exit_grid : Grid
        Grids in front of the lens and behind it; both lines, or both planes. The field on the exit grid is
        that behind the cover glass of the sensor, if the lens has one. The position of the glass has no
        effect, so that the field on any other plane follows by propagation in air.
    wavelength_um : float
        Vacuum wavelength in um.
    pose, surface_perturbations
        Displacement and manufacturing errors of one lens, as in :func:`lensdesign.trace`. They do not move
        the grids.
    coating : coating of a surface, optional
        Coating of all surfaces, as in :class:`lensdesign.Surface`. Default: the coatings of the design. With
        scalar waves a surface transmits like light across the plane of incidence on a line, and like the mean
        of both polarizations on a plane.
    polarization : str or float
        ``scalar`` waves; ``unpolarized`` or ``circular`` light; or the angle of linear polarization from x
        towards y in degrees. ``auto`` are scalar waves, unless the choice of an engine has to include the
        polarization.

    Raises
    ------
    InputError
        If one grid is a line and the other a plane, a grid lies inside the lens, or the perturbations contain
        several trials.

    Examples
    --------
    A tilted lens between two meridional lines:

    >>> from lensdesign import Pose, load_design
    >>> from wavesim import Grid, Scene, engine_for
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> line, behind = Grid((100,), 2e-4, lens.object_z_mm), Grid((7200,), 3e-3, lens.exit_vertex_z_mm + 2.0)
    >>> scene = Scene(lens, line, behind, wavelength_um=0.532, pose=Pose(tilt_x_deg=0.1))
    >>> engine_for(scene, "eikonal").predicted_error() < 0.1
    True
    """

    lens: Lens
    object_grid: Grid
    exit_grid: Grid
    wavelength_um: float
    pose: Pose = Pose()
    surface_perturbations: Mapping[int, SurfacePerturbation] = field(default_factory=dict)
    coating: SurfaceCoating | None = None
    polarization: str | float = AUTO

    def __post_init__(self) -> None:
        if self.object_grid.is_line != self.exit_grid.is_line:
            raise InputError("object grid and exit grid: both must be lines, or both planes")
        if self.object_grid.z_mm >= 0.0:
            raise InputError(
                f"object grid at z = {self.object_grid.z_mm:g} mm: must lie in front of the front vertex, "
                "z < 0"
            )
        exit_vertex = self.lens.exit_vertex_z_mm
        if self.exit_grid.z_mm < exit_vertex:
            raise InputError(
                f"exit grid at z = {self.exit_grid.z_mm:g} mm: must not lie in front of the exit vertex, "
                f"z >= {exit_vertex:g} mm"
            )
        validate_polarization("polarization", self.polarization)
        if trial_count(self.pose, *self.surface_perturbations.values()) is not None:
            raise InputError(
                "surface_perturbations: hold arrays of trials; a scene has one lens: give numbers"
            )

    @cached_property
    def system(self) -> CompiledSystem:
        """The displaced and perturbed lens as arrays, ready for tracing."""
        lens = self.lens
        if self.coating is not None:
            lens = lens.with_coating(self.coating)
        return compile_system(lens, self.wavelength_um, self.pose, self.surface_perturbations)

    @cached_property
    def stop(self) -> tuple[int, float]:
        """Index of the stop's surface from 0, and the semi-diameter of the stop in mm."""
        return self.lens.stop_index, self.lens.stop_semi_diameter_mm

    def key_text(self) -> str:
        """Return a text that is equal for equal scenes.

        Scalar waves through the coatings of the design have the text of scenes before there were others, so
        that earlier results stay usable.
        """
        # Tables of measured amplitudes count by their content, not by their path.
        tables = [c.table.digest for c in self.system.coatings if isinstance(c, TableCoating)]
        measured = f" {tables}" if tables else ""
        if self.coating is None and not is_vector(self.polarization):
            text = f", coating=None, polarization={self.polarization!r}"
            return repr(self).replace(text, ", coating='ideal'") + measured
        return repr(self) + measured

    @property
    def has_ideal_coatings(self) -> bool:
        """True if all surfaces transmit all light."""
        return all(coating.is_ideal for coating in self.system.coatings)

    @property
    def steepest_sine(self) -> float:
        """Sine of the largest angle to the axis behind the lens; steeper light is omitted."""
        return math.inf

    @property
    def wavenumber_per_mm(self) -> float:
        """Vacuum wavenumber in 1/mm: 2 pi over the vacuum wavelength."""
        return 2e3 * np.pi / self.wavelength_um


def placed_scene(nominal: Scene, state: SystemState) -> Scene:
    """Return the scene with lens, object and wavelength of a state; the exit grid does not move."""
    wavelength = state.wavelength_um or nominal.wavelength_um
    same = wavelength == nominal.wavelength_um
    return replace(
        nominal,
        lens=nominal.lens if same else _with_indices_of(nominal.lens, nominal.wavelength_um),
        object_grid=placed_object(nominal.object_grid, state),
        wavelength_um=wavelength,
        pose=state.pose,
        surface_perturbations=state.surface_perturbations,
    )


def placed_object(nominal: Grid, state: SystemState) -> Grid:
    """Return the object grid at its actual position."""
    x, y, z = state.object_shift_mm
    centre = nominal.centre_mm[0] + x, nominal.centre_mm[1] + y
    return replace(nominal, z_mm=nominal.z_mm + z, centre_mm=centre)


def placed_light(nominal: Field, state: SystemState) -> Field:
    """Return the illumination with its errors, on the displaced object; it moves with the object."""
    nominal, wavelength = state.light.on(nominal), state.wavelength_um or nominal.wavelength_um
    return Field(placed_object(nominal.grid, state), nominal.values, wavelength, nominal.index)


def _with_indices_of(lens: Lens, wavelength_um: float) -> Lens:
    """Return the lens with its indices at one wavelength. Their change with wavelength is a perturbation."""
    indices = lens.indices(wavelength_um)[1:].tolist()
    surfaces = (
        surface if surface.material is None else surface.replaced(material=index)
        for surface, index in zip(lens.surfaces, indices, strict=True)
    )
    sensor, glass = lens.sensor, lens.sensor.cover_glass
    if glass is not None:
        sensor = sensor.replaced(cover_glass=glass.replaced(material=lens.cover_glass_index(wavelength_um)))
    return lens.replaced(surfaces=tuple(surfaces), sensor=sensor)


def wavelength_of(lens: Lens, wavelength_um: float | None) -> float:
    """Return the given wavelength, or the design's first one where none is given.

    Raises
    ------
    InputError
        If it is not finite and above 0.
    """
    wavelength = lens.wavelengths_um[0] if wavelength_um is None else wavelength_um
    validate_positive("wavelength_um", wavelength)
    return wavelength


def diffraction_limit_um(lens: Lens, wavelength_um: float) -> float:
    """Return the width in um of the finest lines that the aperture transmits, wavelength / 2 NA."""
    return 0.5 * wavelength_um / lens.object.numerical_aperture
