"""A small patch of the object, carried through a perturbed lens and back through the nominal one.

Both ways go along rays (Eikonal tiles, see :mod:`wavesim.engines.tiles.engine`), for the patch's middle c:
U'(s) = (1/lambda) a'(s) exp(i k V'(s)) times the spectrum of O at p'(s) forward, and back

    O_rec(d) = (1/lambda^2) Int dp |ds/dp| a a' exp(i k (V' - V)) Spectrum[O](p'(s(p))) exp(i k p.d),

the integral over the nominal lens's cosines p. With d no larger than the patch, a regular grid in p whose
period (window) is twice the patch holds the integrand, so that the field on the sensor, thousands of samples
across, is needed at some hundred points s(p) across only. There it is known from rays exactly. Paths of
second order in d enter by their mean over the stop.

Unlike :class:`wavesim.PupilSampler`'s isoplanatic pupil, this has the object's light go where the perturbed
lens sends it: its spectrum is taken at p', with amplitude a' and the perturbed stop. On a meridional line
1/lambda^2 becomes 1/lambda. The way back is the adjoint of :class:`wavesim.Engine`: through an unperturbed
lens, the weight cos(t_obj) / (n cos(t_out)) is left inside the stop.
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
from wavesim.pupil.focus import reach_um, sought
from wavesim.pupil.patch_rays import NominalRays, nominal_rays
from wavesim.pupil.patch_return import PatchGrid, PerturbedPatch, ReturnedPatch
from wavesim.pupil.pupil import ComplexArray, ReconstructionPupil
from wavesim.scene.engine import ErrorTerm
from wavesim.scene.placement import NOMINAL, Placement, placed


@dataclass(frozen=True, eq=False)
class PatchChain:
    """The chain from a patch through perturbed lenses and back through the nominal one.

    Attributes
    ----------
    lens : Lens
        The nominal lens.
    field_mm : (x, y)
        The patch's middle on the object plane; on a line x is 0.
    wavelength_um : float, optional
        The design's first one if left out.
    plane_distance_mm : float
        Of the plane where the field is handed over, from the exit vertex. It stands still when the lens
        moves.
    patch_um : float
        Side of the patch, or its length on a line.
    samples : int, optional
        Of the stop, along each side of the square grid of direction cosines; made odd. Left out, as many as
        the patch needs; more hold larger displacements without registration, and show the stop's rim finer.
    line : bool
        A meridional line along y in place of the plane.

    Raises
    ------
    InputError
        If a value is not usable, or no ray gets through.
    SamplingError
        If `samples` are too few for the patch.
    FoldError
        If the nominal rays fold on the plane.

    Examples
    --------
    >>> chain = PatchChain(lens, field_mm=(0.0, 1.0))                        # doctest: +SKIP
    >>> trial = chain.perturbed(Pose(tilt_x_deg=0.1))                        # doctest: +SKIP
    >>> chain_contrast(trial, line_width_um=0.775)                           # doctest: +SKIP
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
        """The nominal rays of the patch's middle."""
        stop = (self.lens, self.field_mm, self.wavelength_um, self.plane_distance_mm)
        coarse = point_characteristic(*stop, samples=8).grid
        each = self.patch_um * 2.0 * coarse.half_width / coarse.wavelength_um
        # Light displaced by half of this period still misses the patch when it re-enters at the other side.
        least_window = 2.0
        needed = max(math.ceil(least_window * each), 8) | 1
        # Period of the returned field, in widths of the patch, on a line and in the plane. The pupil's phase
        # is represented up to a displacement of half of it. On a line the stop's rim weighs more, and samples
        # cost less.
        window = {True: 6.0, False: 3.0}
        samples = max(math.ceil(window[self.line] * each), 8) if self.samples is None else self.samples
        rays = nominal_rays(*stop, samples | 1 if isinstance(samples, int) else samples, self.line)
        grid = rays.base.grid
        if grid.samples < needed:
            raise SamplingError(
                f"samples = {self.samples}: what comes back repeats after {grid.window_um:.4g} um, but must "
                f"not before {least_window:g} times the patch of {self.patch_um:g} um: raise samples to at "
                f"least {needed}, or take a smaller patch"
            )
        return rays

    @cached_property
    def patch(self) -> PatchGrid:
        """Samples of the object."""
        return PatchGrid(self.patch_um, self.rays.base.grid.wavelength_um, self.line)

    def bars(self, line_width_um: float, orientation: Orientation = "y", bars: int = 5) -> ComplexArray:
        """Bright bars on a dark ground in the patch's middle; edges are shared between samples.

        Bars follow each other along the axis `orientation` (on a line, y), with gaps of their own width, and
        are as long as they are wide together.

        Raises
        ------
        InputError
            If a value is not usable, or the bars do not fit into the patch.
        """
        return self.patch.bars(line_width_um, orientation, bars)

    def perturbed(self, placement: Placement | Pose = NOMINAL) -> PerturbedPatch:
        """The chain through one perturbed lens, its rays traced.

        Parameters
        ----------
        placement
            As of :meth:`wavesim.PupilSampler.pupil`.

        Raises
        ------
        InputError
            If a value is not usable, or no ray arrives through both lenses.
        RayAimError
            If the perturbation is so large that rays cannot be aimed at the nominal sensor points.
        FoldError
            If the perturbed rays fold on the plane.
        """
        base, place = self.rays.base, placed(placement)
        wavelength = base.grid.wavelength_um
        system = compile_system(self.lens, wavelength, place.pose, place.surface_perturbations)
        if system.trials is not None:
            raise InputError(f"a trial is that of one lens: the perturbation holds {system.trials} trials")
        aimed = self.rays.aimed(system, place)
        if place.wavelength_um is not None:
            # What counts is path and direction in waves.
            ratio = wavelength / place.wavelength_um
            aimed = replace(aimed, path_mm=ratio * aimed.path_mm, cosines=ratio * aimed.cosines)
        pupil = ReconstructionPupil(base.grid, aimed.path_mm - base.path_mm, aimed.valid)
        return PerturbedPatch(self.patch, self.rays, aimed, pupil, 1e-3 * self.lens.sensor.pixel_pitch_um)

    def carried(self, object_values: ArrayLike, placement: Placement | Pose = NOMINAL) -> ComplexArray:
        """Return the field that the nominal lens reconstructs on the patch, neither shifted nor refocused.

        Raises as :meth:`perturbed` and :meth:`wavesim.pupil.patch_return.PerturbedPatch.returned`.
        """
        return self.perturbed(placement).returned(object_values).values

    def error_terms(self, displacement_um: float = 0.0) -> tuple[ErrorTerm, ...]:
        """Neglected effects, with estimates of the relative error of the returned field.

        Parameters
        ----------
        displacement_um
            By how much the object comes back displaced. Where it comes back to where it was, what is left
            out on the two ways all but cancels; the estimate leaves that out of account.
        """
        axes = len(self.rays.axes)
        bend = self.rays.bend_deviation_per_mm.reshape(-1, axes * axes)
        edge_mm = np.linspace(-0.5e-3, 0.5e-3, 9) * self.patch_um
        offsets = np.stack(np.meshgrid(*[edge_mm] * axes), axis=-1).reshape(-1, axes)
        offsets[:, -1] += 1e-3 * displacement_um
        products = (offsets[:, :, None] * offsets[:, None, :]).reshape(len(offsets), -1)
        waves = 0.5e3 / self.patch.wavelength_um * products @ bend.T
        rms, largest = float(np.sqrt(np.mean(waves**2))), float(np.max(np.abs(waves)))
        path = (
            f"path of second order over the patch, beyond its mean over the stop: {rms:.2g} waves rms, "
            f"{largest:.2g} at most"
        )
        rim = f"the perturbed stop's rim, finer than one of {self.rays.base.grid.samples} samples"
        return (ErrorTerm(path, 2.0 * math.pi * rms), ErrorTerm(rim, math.nan))


def chain_contrast(
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
    """Contrast of bars in what comes back: (bright - dark) / (bright + dark).

    Bright is the mean intensity at the middles of the bars, dark that at the middles of the gaps, on the line
    across the target's centre and where the lines show
    (:meth:`wavesim.pupil.patch_return.ReturnedPatch.displacement_um`), as in
    :func:`wavesim.line_pair_contrast`. Negative where bright and dark trade places.

    Parameters
    ----------
    trial
        The chain through one perturbed lens.
    line_width_um, orientation, bars
        As :meth:`PatchChain.bars`.
    refocused
        Whether defocus is taken out by least squares of the phase; displacement always is.
    best
        Whether the focus is then sought that makes the contrast best, as :func:`wavesim.pupil.best_focus`.
    electrons, rng
        As :meth:`wavesim.pupil.patch_return.PerturbedPatch.returned`.

    Raises
    ------
    InputError, SamplingError
        As :meth:`PatchChain.bars` and :meth:`wavesim.pupil.patch_return.PerturbedPatch.returned`.
    """
    lines = trial.patch.bars(line_width_um, orientation, bars)
    back = trial.returned(lines, "focus" if refocused else "shift", electrons, rng)

    def contrast(distance_um: float) -> float:
        seen = back.moved_along(distance_um) if distance_um else back
        return _contrast_of(seen, line_width_um, orientation, bars)

    return sought(contrast, reach_um(back.rays.base.grid))[1] if best else contrast(0.0)


def _contrast_of(returned: ReturnedPatch, line_width_um: float, orientation: Orientation, bars: int) -> float:
    moved = returned.displacement_um(orientation, 0.75 * returned.patch.wavelength_um / line_width_um)
    count = 2 * bars - 1
    across = np.asarray(line_width_um * (np.arange(count) - 0.5 * (count - 1)) + moved, float)
    centre = np.zeros(1)
    field = returned.at(across, centre) if axis_of(orientation) == 0 else returned.at(centre, across)
    rows = np.abs(field.reshape(count)) ** 2
    bright, dark = rows[0::2].mean(), rows[1::2].mean()
    return float((bright - dark) / (bright + dark)) if bright + dark > 0.0 else 0.0
