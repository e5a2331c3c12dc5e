"""A small patch of the object, propagated through a perturbed lens and back through the nominal lens.

Both propagations use rays from the patch's centre c (:mod:`wavesim.engines.eikonal.engine`). The forward
field is U'(s) = (1/lambda) a'(s) exp(i k V'(s)) times the spectrum of O at p'(s). The reconstruction
is::

    O_rec(d) = (1/lambda^2) Int dp |ds/dp| a a' exp(i k (V' - V)) Spectrum[O](p'(s(p))) exp(i k p.d),

an integral over the cosines p of the nominal lens. Since d is not larger than the patch, a regular grid in p
samples the integrand if its period (window) is twice the patch. The field on the sensor, which has thousands
of samples along a side, is therefore needed at about a hundred points s(p) along a side, where rays give it
exactly. Path terms of second order in d enter as their mean over the stop.

Unlike the isoplanatic pupil of :class:`wavesim.PupilSampler`, this model takes the object's spectrum at the
directions p' of the perturbed rays, with their amplitude a' and the perturbed stop. On a meridional line
1/lambda^2 becomes 1/lambda. The backward propagation is the adjoint of :class:`wavesim.Engine`. An
unperturbed lens therefore leaves the weight cos(t_obj) / (n cos(t_out)) inside the stop.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from lensdesign.errors import InputError, SamplingError, validate_positive
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.raytrace.compiled import compile_system
from wavesim.fields.field import Orientation, axis_of
from wavesim.pupil.characteristic import point_characteristic
from wavesim.pupil.focus import search_maximum, search_range_um
from wavesim.pupil.patch_rays import NominalRays, nominal_rays
from wavesim.pupil.patch_reconstruction import PatchGrid, PerturbedPatch, ReconstructedPatch
from wavesim.pupil.pupil import ComplexArray, ReconstructionPupil
from wavesim.scene.engine import ErrorTerm
from wavesim.scene.system_state import AS_DESIGNED, SystemState, state_of
from wavesim.targets.bars import bar_and_gap_centres, michelson


@dataclass(frozen=True, eq=False)
class PatchReconstructor:
    """Propagation of a patch of the object through perturbed lenses, and back through the nominal lens.

    The nominal rays are traced once. :mod:`wavesim.pupil.patch_reconstructor` describes the model.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    field_mm : (x, y)
        Centre of the patch on the object plane, in mm; on a line x is 0.
    wavelength_um : float, optional
        Vacuum wavelength in um. Default: the design's first wavelength.
    plane_distance_mm : float
        Distance in mm from the exit vertex to the sensor plane. The plane does not move with the lens.
    patch_um : float
        Side of the patch, or its length on a line, in um.
    samples : int, optional
        Samples along each side of the square grid of direction cosines; made odd. Default: as many as the
        patch needs. More samples allow larger displacements without registration, and resolve the stop's rim
        better.
    line : bool
        Whether the patch is a meridional line along y instead of a square.

    Raises
    ------
    InputError
        If a value is out of its range, or no ray passes the lens.
    SamplingError
        If `samples` are too few for the patch.
    FoldError
        If the nominal rays fold on the plane.

    Examples
    --------
    Contrast of lines on a meridian that a tilted lens has recorded:

    >>> from lensdesign import Pose, load_design
    >>> from wavesim import PatchReconstructor
    >>> from wavesim.pupil import patch_bar_contrast
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> reconstructor = PatchReconstructor(lens, field_mm=(0.0, 1.0), patch_um=16.0, line=True)
    >>> round(patch_bar_contrast(reconstructor.perturbed(Pose(tilt_x_deg=0.1)), line_width_um=0.775), 1)
    0.6
    """

    lens: Lens
    field_mm: Sequence[float] = (0.0, 0.0)
    wavelength_um: float | None = None
    plane_distance_mm: float = 3.0
    patch_um: float = 34.0
    samples: int | None = None
    line: bool = False

    def __post_init__(self) -> None:
        validate_positive("patch_um", self.patch_um)
        _ = self.rays

    @cached_property
    def rays(self) -> NominalRays:
        """The nominal rays from the patch's centre."""
        stop = (self.lens, self.field_mm, self.wavelength_um, self.plane_distance_mm)
        coarse = point_characteristic(*stop, samples=8).grid
        each = self.patch_um * 2.0 * coarse.half_width / coarse.wavelength_um
        # Light displaced by half of this period still misses the patch when it re-enters at the other side.
        least_window = 2.0
        needed = max(math.ceil(least_window * each), 8) | 1
        # Period of the reconstructed field, in widths of the patch, on a line and in the plane. The pupil's
        # phase is represented up to a displacement of half of it. On a line the stop's rim weighs more, and
        # samples cost less.
        window = {True: 6.0, False: 3.0}
        samples = max(math.ceil(window[self.line] * each), 8) if self.samples is None else self.samples
        rays = nominal_rays(*stop, samples | 1 if isinstance(samples, int) else samples, self.line)
        grid = rays.base.grid
        if grid.samples < needed:
            raise SamplingError(
                f"samples = {self.samples}: the reconstruction repeats with a period of {grid.window_um:.4g} "
                f"um, which must be at least {least_window:g} times the patch of {self.patch_um:g} µm: raise "
                f"samples to at least {needed}, or use a smaller patch"
            )
        return rays

    @cached_property
    def patch(self) -> PatchGrid:
        """Samples of the patch."""
        return PatchGrid(self.patch_um, self.rays.base.grid.wavelength_um, self.line)

    def bars(self, line_width_um: float, orientation: Orientation = "y", bars: int = 5) -> ComplexArray:
        """Return the transmission of bright bars on a dark ground, at the centre of the patch.

        Gaps are as wide as bars, and the target is square. A sample at the edge of a bar has the fraction of
        its cell that the bar covers.

        Parameters
        ----------
        line_width_um
            Width of a bar and of a gap in um.
        orientation
            Axis along which the bars are repeated; "y" on a line.
        bars
            Number of bars.

        Returns
        -------
        ndarray
            Complex transmission in the shape of the patch.

        Raises
        ------
        InputError
            If a value is out of its range, or the bars do not fit into the patch.
        """
        return self.patch.bars(line_width_um, orientation, bars)

    def perturbed(self, state: SystemState | Pose = AS_DESIGNED) -> PerturbedPatch:
        """Trace one perturbed lens, and return the map from the patch to its reconstruction.

        Parameters
        ----------
        state
            Lens, object, sensor and light; or the pose of the lens alone.

        Returns
        -------
        PerturbedPatch
            Map from an object on the patch to the reconstructed field.

        Raises
        ------
        InputError
            If a value is invalid, or no ray arrives through both lenses.
        RayAimError
            If the perturbation is so large that rays cannot be aimed at the nominal sensor points.
        FoldError
            If the perturbed rays fold on the plane.
        """
        base, place = self.rays.base, state_of(state)
        wavelength = base.grid.wavelength_um
        system = compile_system(self.lens, wavelength, place.pose, place.surface_perturbations)
        if system.trials is not None:
            raise InputError(f"the perturbation has {system.trials} trials: must be that of a single lens")
        aimed = self.rays.aimed(system, place)
        if place.wavelength_um is not None:
            # What counts is path and direction in waves.
            ratio = wavelength / place.wavelength_um
            aimed = replace(aimed, path_mm=ratio * aimed.path_mm, cosines=ratio * aimed.cosines)
        pupil = ReconstructionPupil(base.grid, aimed.path_mm - base.path_mm, aimed.valid)
        return PerturbedPatch(self.patch, self.rays, aimed, pupil, 1e-3 * self.lens.sensor.pixel_pitch_um)

    def reconstruct(self, object_values: ArrayLike, state: SystemState | Pose = AS_DESIGNED) -> ComplexArray:
        """Return the field that the nominal lens reconstructs on the patch, without registration.

        Parameters
        ----------
        object_values
            Complex transmission in the shape of the patch.
        state
            As in :meth:`perturbed`.

        Returns
        -------
        ndarray
            Complex amplitude in the shape of the patch.

        Raises
        ------
        InputError, SamplingError, RayAimError, FoldError
            As :meth:`perturbed` and :meth:`wavesim.pupil.patch_reconstruction.PerturbedPatch.reconstruct`.
        """
        return self.perturbed(state).reconstruct(object_values).values

    def error_terms(self, displacement_um: float = 0.0) -> tuple[ErrorTerm, ...]:
        """Return the neglected effects, with estimates of the relative error of the reconstructed field.

        The neglected terms of both propagations nearly cancel where the object returns without displacement.
        The estimate does not use this.

        Parameters
        ----------
        displacement_um
            Displacement of the reconstructed object in um.
        """
        axes = len(self.rays.axes)
        hessian = self.rays.path_hessian_deviation_per_mm.reshape(-1, axes * axes)
        edge_mm = np.linspace(-0.5e-3, 0.5e-3, 9) * self.patch_um
        offsets = np.stack(np.meshgrid(*[edge_mm] * axes), axis=-1).reshape(-1, axes)
        offsets[:, -1] += 1e-3 * displacement_um
        products = (offsets[:, :, None] * offsets[:, None, :]).reshape(len(offsets), -1)
        waves = 0.5e3 / self.patch.wavelength_um * products @ hessian.T
        rms, largest = float(np.sqrt(np.mean(waves**2))), float(np.max(np.abs(waves)))
        path = (
            f"path of second order over the patch, beyond its mean over the stop: {rms:.2g} waves rms, "
            f"{largest:.2g} at most"
        )
        rim = f"the perturbed stop's rim, finer than one of {self.rays.base.grid.samples} samples"
        return (ErrorTerm(path, 2.0 * math.pi * rms), ErrorTerm(rim, math.nan))


def patch_bar_contrast(
    trial: PerturbedPatch,
    line_width_um: float,
    orientation: Orientation = "y",
    bars: int = 5,
    *,
    refocused: bool = True,
    best: bool = False,
    electrons: float | None = None,
    rng: np.random.Generator | None = None,
) -> float:
    """Return the contrast of bars in the reconstructed field: (bright - dark) / (bright + dark).

    "bright" is the mean intensity at the centres of the bars, and "dark" that at the centres of the gaps, as
    in :func:`wavesim.line_pair_contrast`. Both are taken at the displaced lines
    (:meth:`wavesim.pupil.patch_reconstruction.ReconstructedPatch.displacement_um`). Reversed lines have a
    negative contrast.

    Parameters
    ----------
    trial
        The patch through one perturbed lens.
    line_width_um, orientation, bars
        As in :meth:`PatchReconstructor.bars`.
    refocused
        Whether to remove defocus by a least-squares fit to the phase. Displacement is always removed.
    best
        Whether to search the focus with the highest contrast afterwards, as :func:`wavesim.pupil.best_focus`.
    electrons, rng
        As in :meth:`wavesim.pupil.patch_reconstruction.PerturbedPatch.reconstruct`.

    Raises
    ------
    InputError, SamplingError
        As :meth:`PatchReconstructor.bars` and
        :meth:`wavesim.pupil.patch_reconstruction.PerturbedPatch.reconstruct`.
    """
    lines = trial.patch.bars(line_width_um, orientation, bars)
    reconstructed = trial.reconstruct(lines, "focus" if refocused else "shift", electrons, rng)

    def contrast(distance_um: float) -> float:
        refocused = reconstructed.refocused_by(distance_um) if distance_um else reconstructed
        return _contrast_of(refocused, line_width_um, orientation, bars)

    return (
        search_maximum(contrast, search_range_um(reconstructed.rays.base.grid))[1] if best else contrast(0.0)
    )


def _contrast_of(
    reconstructed: ReconstructedPatch, line_width_um: float, orientation: Orientation, bars: int
) -> float:
    moved = reconstructed.displacement_um(
        orientation, 0.75 * reconstructed.patch.wavelength_um / line_width_um
    )
    across, centre = bar_and_gap_centres(line_width_um, bars) + moved, np.zeros(1)
    field = (
        reconstructed.at(across, centre) if axis_of(orientation) == 0 else reconstructed.at(centre, across)
    )
    intensity = np.abs(field.ravel()) ** 2
    return michelson(float(intensity[:bars].mean()), float(intensity[bars:].mean()))
