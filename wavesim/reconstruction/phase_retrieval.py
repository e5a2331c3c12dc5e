"""The paper's dual-plane phase retrieval: a field from intensities alone (Appendix A).

Every iteration propagates the field at the exit vertex to all planes (A1), replaces its amplitude by the
measured one (A2), propagates it back (A3), smooths it along the gradient of its total variation (A4),
averages it over the planes, and extrapolates it by a weighted feedback (A5). The correlation of amplitudes
at the first plane (A6) measures the agreement with the data. A correlation near 1 does not prove that the
field is right: another field may have almost the same intensities. A plane that was held out is a stronger
test.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from lensdesign.errors import InputError, validate_whole_number
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.appendix_a import (
    AmplitudeMatch,
    Array,
    ComplexArray,
    Plane,
    compare,
    iterate,
    plane_for,
    rows_of,
)
from wavesim.sensor.measurement import Measurement, amplitude_unit

Start = Field | Literal["uniform", "random"]

FEEDBACK = (0.7, 0.5)
"""Weights a and b of A5."""

TV_STEP = 0.05
"""Step t of A4."""

LIT, LARGEST_TV_FRACTION = 1e-4, 2e-2
"""Fraction of the largest amplitude above which a pixel is lit, and limit of the step over the lit
median.
"""

STAGNATION_ITERATIONS, STAGNATION_GAIN = 50, 1e-3
"""Stagnation: over so many iterations, 1 minus the correlation falls by less than the fraction
`STAGNATION_GAIN`.
"""


@dataclass(frozen=True, eq=False)
class Retrieved:
    """A retrieved field, and its agreement with the data.

    Attributes
    ----------
    field : Field
        Field at the plane sought.
    correlation : tuple of float
        Correlation A6 at the first plane, for every iteration.
    residuals : tuple of float
        For each plane, L2 norm of the difference of amplitudes over that of the measured one.
    held_out_residual : float or None
        The same quantity for the plane that was not used.
    stagnated_at : int or None
        Iteration after which the correlation no longer improved; None while it still improved.
    residual_curve : tuple of float
        For every iteration, relative L2 difference of amplitudes at the first plane.
    """

    field: Field
    correlation: tuple[float, ...]
    residuals: tuple[float, ...]
    held_out_residual: float | None
    stagnated_at: int | None
    residual_curve: tuple[float, ...] = ()


@dataclass(frozen=True, eq=False)
class RetrievalState:
    """State of a retrieval after an iteration: all that is needed to resume it.

    Attributes
    ----------
    now, before : ndarray
        Field sought after this iteration, and after the previous one.
    correlation, residual_curve : tuple of float
        Curves of all iterations so far; see :class:`Retrieved`.
    """

    now: ComplexArray
    before: ComplexArray
    correlation: tuple[float, ...]
    residual_curve: tuple[float, ...]


def retrieve(
    grid: Grid,
    wavelength_um: float,
    recorded: Sequence[Measurement],
    start: Start = "uniform",
    *,
    iterations: int = 500,
    feedback: tuple[float, float] = FEEDBACK,
    tv_step: float = TV_STEP,
    held_out: Measurement | None = None,
    seed: int = 0,
    progress: Callable[[int, float], None] | None = None,
    resume: RetrievalState | None = None,
    keep: Callable[[RetrievalState], None] | None = None,
) -> Retrieved:
    """Find the field whose amplitudes were measured on two or more planes in free space.

    The method is the paper's dual-plane phase retrieval (Appendix A, Eqs. A1 to A6), which
    :mod:`wavesim.reconstruction.phase_retrieval` describes.

    Parameters
    ----------
    grid
        Grid of the field sought; the amplitudes have the same samples on their planes.
    wavelength_um
        Vacuum wavelength in um.
    recorded
        Measured amplitudes of two or more planes, with their distances from the grid in mm.
    start
        Initial field on the grid (amplitude and phase of the forward model), or a constant ("uniform") or
        random ("random") phase with the amplitude of the first plane.
    iterations
        Total number of iterations, including those of `resume`.
    feedback
        Weights a and b of A5.
    tv_step
        Step t of A4; 0 disables it. The step changes the field by up to about t, so that t must suit the
        unit of the amplitudes. The paper's step of 0.05 destroys a field whose peak is 1 and whose intensity
        spans five decades. It does not harm the same field with a median of 64 where it is lit.
    held_out
        Measured plane that is not used, to judge the result.
    seed
        Seed of a random start.
    progress
        Callback `progress(index, correlation)`, called after every iteration.
    resume
        State of an interrupted run with the same arguments, which continues from there.
    keep
        Callback `keep(state)`, called after every iteration; `resume` accepts the state. The next iterations
        reuse its arrays: write or copy them before returning.

    Returns
    -------
    Retrieved
        The field, its correlation and residuals.

    Raises
    ------
    InputError
        If shapes, distances or weights are invalid, there are fewer than two planes, the squares of
        amplitudes overflow or vanish, or the total-variation step is too large for these amplitudes.

    Examples
    --------
    A beam with a bump in its phase, from its amplitudes on two planes:

    >>> import numpy as np
    >>> from wavesim import Field, Grid, Measurement, propagate, retrieve
    >>> grid = Grid((64, 64), 2e-3, 0.0)
    >>> bump = np.exp(-((grid.x_mm - 0.01) ** 2 + grid.y_mm[:, None] ** 2) / 0.01**2)
    >>> beam = Field(grid, np.exp(-grid.radius_squared_mm2() / 0.02**2 + 1j * bump), 0.532)
    >>> planes = [Measurement(z, np.abs(propagate(beam, z).values)) for z in (0.2, 0.6)]
    >>> found = retrieve(grid, 0.532, planes, iterations=40, tv_step=0.0)
    >>> round(found.correlation[-1], 3), found.residuals[1] < 0.02
    (1.0, True)
    """
    _validate(grid, recorded, iterations, feedback, tv_step)
    state = (
        _initial_state(grid, start, recorded[0].amplitude, seed)
        if resume is None
        else _copied_state(grid, resume)
    )
    del start, resume  # they have been copied, so that the caller's last reference can be released
    planes = [plane_for(grid, wavelength_um, plane, state.now.dtype) for plane in recorded]
    state = run_iterations(planes, state, iterations, feedback, tv_step, progress, keep)
    field = Field(grid, state.now, wavelength_um)
    correlation, curve = state.correlation, state.residual_curve
    del state, planes
    return Retrieved(
        field,
        correlation,
        tuple(residual(field, plane) for plane in recorded),
        None if held_out is None else residual(field, held_out),
        stagnation(correlation),
        curve,
    )


def _initial_state(grid: Grid, start: Start, amplitude: Array, seed: int) -> RetrievalState:
    """Return the state before the first iteration."""
    dtype: Any = np.complex64 if amplitude.dtype == np.float32 else np.complex128
    if isinstance(start, Field):
        if start.grid != grid:
            raise InputError(f"start: its grid {start.grid} is not that of the field sought, {grid}")
        now = np.array(start.values, dtype, order="C")
    elif start == "uniform":
        now = np.array(amplitude, dtype, order="C")
    elif start == "random":
        rng, now = np.random.default_rng(seed), np.empty(grid.shape, dtype)
        for row, recorded in zip(np.atleast_2d(now), np.atleast_2d(amplitude), strict=True):
            row[:] = recorded * np.exp(1j * rng.uniform(0.0, 2.0 * np.pi, len(row)))
    else:
        raise InputError(f"start = {start!r}: must be a field, 'uniform' or 'random'")
    return RetrievalState(now, np.zeros_like(now), (), ())


def _copied_state(grid: Grid, state: RetrievalState) -> RetrievalState:
    """Return a copy of a state, whose arrays may be overwritten."""
    if state.now.shape != grid.shape or state.before.shape != grid.shape:
        raise InputError(f"resume: its shape {state.now.shape} is not that of the field sought, {grid.shape}")
    now, before = (np.array(values, order="C") for values in (state.now, state.before))
    return RetrievalState(now, before, state.correlation, state.residual_curve)


def run_iterations(
    planes: Sequence[Plane],
    state: RetrievalState,
    iterations: int,
    feedback: tuple[float, float],
    tv_step: float,
    progress: Callable[[int, float], None] | None,
    keep: Callable[[RetrievalState], None] | None,
) -> RetrievalState:
    """Iterate up to a number of iterations; the arrays of `state` are overwritten."""
    for k in range(len(state.correlation), iterations):
        match = iterate(
            planes, rows_of(state.now), rows_of(state.before), None if k < 2 else feedback, tv_step
        )
        state = RetrievalState(
            state.before,
            state.now,
            (*state.correlation, match.correlation),
            (*state.residual_curve, match.residual),
        )
        if progress is not None:
            progress(k, match.correlation)
        if keep is not None:
            keep(state)
    return state


def residual(field: Field, plane: Measurement) -> float:
    """Return the relative L2 difference between a field's amplitude on a plane and the measured one.

    Only valid pixels count.
    """
    return _match_on_plane(field, plane)[0].residual


def residual_and_map(field: Field, plane: Measurement) -> tuple[float, Array]:
    """Return the result of :func:`residual`, and the field's amplitude less the measured one in every
    pixel.
    """
    match, field_on_plane = _match_on_plane(field, plane)
    residual_map = np.abs(field_on_plane)
    residual_map -= plane.amplitude
    return match.residual, residual_map


def _match_on_plane(field: Field, plane: Measurement) -> tuple[AmplitudeMatch, ComplexArray]:
    """Return the agreement of a field with a plane, and the field on that plane."""
    values = rows_of(field.values)
    compared_plane = plane_for(field.grid, field.wavelength_um, plane, values.dtype)
    field_on_plane = compared_plane.propagator.propagate(values, np.empty_like(values))
    return compare(field_on_plane, compared_plane), field_on_plane.reshape(field.values.shape)


def stagnation(correlation: Sequence[float]) -> int | None:
    """Return the first iteration after which the correlation hardly improved, or None if it improved."""
    missing = 1.0 - np.asarray(correlation, float)
    first_stagnant = None
    for k in reversed(range(max(len(missing) - STAGNATION_ITERATIONS, 0))):
        if missing[k + STAGNATION_ITERATIONS] <= (1.0 - STAGNATION_GAIN) * missing[k]:
            break
        first_stagnant = k
    return first_stagnant


def agreement(fields: Sequence[Field]) -> float:
    """Return the smallest correlation of any two fields; it is 1 if they differ only by a factor.

    Parameters
    ----------
    fields
        Results of several starts.

    Raises
    ------
    InputError
        If there are fewer than two fields.

    Examples
    --------
    >>> import numpy as np
    >>> from wavesim import Field, Grid
    >>> from wavesim.reconstruction import agreement
    >>> first = Field(Grid((4,), 1e-3, 0.0), np.array([1.0, 1j, -1.0, 2.0]), 0.5)
    >>> round(agreement([first, first.with_values(1j * first.values)]), 6)
    1.0
    """
    if len(fields) < 2:
        raise InputError(f"agreement of {len(fields)} field(s): needs at least two")
    values = [np.ravel(f.values) / np.linalg.norm(f.values) for f in fields]
    return min(float(abs(np.vdot(u, v))) for i, u in enumerate(values) for v in values[:i])


def validate_planes(recorded: Sequence[Measurement], shape: tuple[int, ...], owner: str) -> None:
    """Check that measured planes fit a grid of a shape; `owner` names the grid in messages.

    Raises
    ------
    InputError
        If a shape, distance, shift, background or standard deviation is invalid, or amplitudes are not
        finite, negative, or all dark.
    """
    for plane_index, plane in enumerate(recorded, start=1):
        if plane.amplitude.shape != shape:
            raise InputError(f"plane {plane_index}: its shape {plane.amplitude.shape} is not {owner} {shape}")
        if not math.isfinite(plane.distance_mm):
            raise InputError(f"plane {plane_index}: distance_mm = {plane.distance_mm!r}: must be finite")
        if not all(map(math.isfinite, plane.shift_mm)):
            raise InputError(f"plane {plane_index}: shift_mm = {plane.shift_mm!r}: must be finite")
        background = plane.background
        if background is not None and (
            background.shape != shape or not np.all((background >= 0.0) & np.isfinite(background))
        ):
            raise InputError(
                f"plane {plane_index}: background must be finite and not negative, of the shape {shape}"
            )
        if not np.all(np.isfinite(plane.amplitude)) or np.any(plane.amplitude < 0.0):
            raise InputError(f"plane {plane_index}: amplitudes must be finite and not negative")
        if not np.any(plane.amplitude > 0.0):
            raise InputError(f"plane {plane_index}: all amplitudes are 0")
        if plane.sigma is not None:
            if plane.sigma.shape != shape or not np.all(plane.sigma > 0.0):
                raise InputError(f"plane {plane_index}: sigma must be above 0, of the shape {shape}")
            if not np.any(np.isfinite(plane.sigma) & (plane.amplitude > 0.0)):
                raise InputError(f"plane {plane_index}: is dark or not known (infinite sigma) in all pixels")


def _validate(
    grid: Grid,
    recorded: Sequence[Measurement],
    iterations: int,
    feedback: tuple[float, float],
    tv_step: float,
) -> None:
    if len(recorded) < 2:
        raise InputError(f"{len(recorded)} plane(s) recorded: needs at least two")
    validate_planes(recorded, grid.shape, "the grid's")
    for plane_index, plane in enumerate(recorded, start=1):
        if any(plane.shift_mm) or plane.background is not None:
            raise InputError(
                f"plane {plane_index}: Appendix A supports neither shifts nor backgrounds; use method object"
            )
    if len({plane.distance_mm for plane in recorded}) < len(recorded):
        raise InputError("two planes have the same distance_mm: they must differ")
    if (unit := amplitude_unit(recorded)) != 1.0:
        raise InputError(
            f"plane 1: amplitudes reach {float(recorded[0].amplitude.max()):.3g}, whose squares overflow or "
            f"vanish: divide planes and start by {unit:.3g}"
        )
    validate_whole_number("iterations", iterations, 1)
    if not (all(map(math.isfinite, feedback)) and math.isfinite(tv_step) and tv_step >= 0.0):
        raise InputError(
            f"feedback = {feedback}, tv_step = {tv_step!r}: must be finite, the step not negative"
        )
    first = recorded[0].amplitude
    typical = float(np.median(first[first > LIT * first.max()]))
    if tv_step > LARGEST_TV_FRACTION * typical:
        raise InputError(
            f"tv_step = {tv_step:g}: would destroy plane 1, whose amplitudes have a median of {typical:.3g} "
            f"where it is lit; scale planes and start by {64.0 / typical:.3g}, or take a smaller step"
        )
