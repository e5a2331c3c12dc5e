"""Score test of the bench: whether frames prefer another bench, and which small errors they cannot exclude.

About the object found, the modelled amplitudes change by d_j per unit of parameter j (decenter, tilt,
working distance, shift and distance of a plane, squared width and bandwidth of the source). The object
follows such a change and compensates part of it. Column j of D is the remainder of d_j, found by block
conjugate gradients. With the residuals r and their variances V,

    theta = (D'D)^-1 D'r,    chi^2 = (D'r)' (D'V D)^-1 (D'r)

are the estimated errors of the bench, and their significance. Samples of an amplitude object at a bound, 0
or 1, leave residuals of one sign, whose common effect is subtracted from r first (:func:`_pushes_of_bounds`).
Estimates and significance come from one linear model about the result
(:class:`wavesim.forward.linear_model.LinearModel`). A source that would have to be narrower than a point is
left out.

References
----------
C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Math. Proc. Camb.
Phil. Soc. 44, 50 (1948).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.text import quantity_sentence
from wavesim.engines.eikonal.engine import FlatTiles
from wavesim.engines.eikonal.perturbed_tiles import (
    PerturbedScene,
    PerturbedTiles,
    exit_field_changes_by_engines,
    exit_field_changes_by_rays,
    path_derivatives,
)
from wavesim.engines.registry import engine_on
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.linear_model import FreeSpaceMeasurement, LinearModel, RealArray
from wavesim.metrics.contrast import object_correlation
from wavesim.metrics.goodness_of_fit import Undetected
from wavesim.reconstruction.object_response import eliminated_object, free_samples
from wavesim.reconstruction.source_search import coherent_deg, coherent_nm
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import Kind
from wavesim.scene.source import Source, SourceMode
from wavesim.sensor.measurement import Measurement

MOUNTING = ("decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg", "working_distance_mm")

SOURCE = ("source_deg", "bandwidth_nm")
"""Parameters of the source, whose squares change the amplitudes in proportion."""

CAUSES = {
    "decenter": "mounting",
    "tilt": "mounting",
    "working": "working distance",
    "source": "source",
    "bandwidth": "bandwidth",
}
"""Causes of the parameters by the first word of their names; the others belong to the planes."""

CERTAIN_CHI_SQUARE, CERTAIN_PER_PIXEL = 100.0, 3e-3
"""Chi-square above which frames prefer another bench: a constant, plus an amount for each pixel.

Small model errors and iterations that end early add up over pixels. A bench as designed reaches a third of
this value with most objects, and nearly all of it with a complex object whose planes have little diversity.
"""


LEAST_LOSS, LEAST_LOSS_OF_AMPLITUDE = 0.008, 0.002
"""Loss of correlation above which errors of the bench matter.

Estimated errors of a bench that is right are small with an amplitude object, and larger with other objects.
"""


ENLARGEMENT, MOST_ENLARGEMENTS = 1.1, 30
"""Factor by which the size of an error grows until it changes the object enough, and the largest number of
such steps.
"""


@dataclass(frozen=True)
class ScoreTest:
    """Result of the score test.

    Attributes
    ----------
    estimate : mapping
        Estimated errors of the bench, by parameter.
    chi_square : float
        Significance of the errors: about the number of parameters where the bench is as stated.
    fall : float
        Fall of the squared misfit that these errors would explain.
    correlation : float
        Correlation (:func:`wavesim.metrics.contrast.object_correlation`) of the object found with the one
        that these errors would give.
    least_loss : float
        Loss of correlation above which errors of the bench matter.
    pixels : int
        Number of pixels of all planes.
    cause : str
        The cause that explains most; empty if the only errors are sources narrower than a point.
    undetected : tuple of Undetected
        For each tested parameter of mounting and source, the smallest error that the test would report, if it
        were the only one.
    """

    estimate: Mapping[str, float]
    chi_square: float
    fall: float
    correlation: float
    least_loss: float
    pixels: int
    cause: str
    undetected: tuple[Undetected, ...]

    @property
    def is_preferred(self) -> bool:
        """True if frames clearly prefer another bench, and the object would differ."""
        is_certain = self.chi_square > _certain_chi_square(self.pixels)
        return is_certain and 1.0 - self.correlation > self.least_loss

    @property
    def explanation(self) -> str:
        """Sentence that names the errors of the bench."""
        head = tuple(word for word, cause in CAUSES.items() if cause == self.cause) or ("plane",)
        parts = [
            quantity_sentence(name, f"{value:+.2g}")
            for name, value in self.estimate.items()
            if name.startswith(head)
        ]
        return (
            f"frames prefer another bench (chi-square {self.chi_square:.0f}; {', '.join(parts)}), with an "
            f"object whose correlation with this one is {self.correlation:.3f}"
        )


def score_test(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    transmission: NDArray[Any],
    kind: Kind,
    *,
    scale: float,
    fits_scale: bool,
    fill_factor: float,
    model_error: float,
    calibrated: Collection[str] = (),
    progress: Callable[[str], None] = lambda what: None,
) -> ScoreTest:
    """Test the assumed bench against small errors.

    Parameters
    ----------
    engine, light, recorded, kind, fill_factor
        See :func:`wavesim.reconstruct`; the light is that of a coherent source.
    transmission : ndarray
        The object found, on the samples of the light.
    scale, fits_scale
        Measured amplitude per unit of the modelled amplitude, and whether it was fitted.
    model_error
        Relative error of amplitudes due to engine and pixels.
    calibrated
        Names of parameters that a calibration has sought with these frames. They are not tested: the bench
        has the values that the frames prefer, and the calibration states their deviations.
    progress
        Called with a message for each step of the computation.

    Returns
    -------
    ScoreTest
        Estimated errors, their significance, and errors that cannot be excluded.

    Raises
    ------
    TransferLensError
        If rays or samples do not allow small displacements of the scene.
    """
    model = ChannelModel.of_source(engine, light, recorded, scale, fill_factor)
    values = transmission.real if kind == "amplitude" else transmission
    linear = LinearModel(model, values, fits_scale)
    model = model.with_scale(linear.scale)
    columns: dict[str, RealArray] = {}
    progress("effect of the mounting")
    columns |= _mounting_columns(linear, calibrated)
    columns |= _plane_columns(linear, calibrated)
    progress("effect of the source")
    columns |= _source_columns(linear, model, values)
    progress("effects with the best object")
    is_free = free_samples(linear, values)
    pushes = _pushes_of_bounds(linear, is_free, kind, values)
    found = eliminated_object(linear, np.stack([*columns.values(), *pushes]), is_free, kind, values)
    rows = found.columns.reshape(len(found.columns), -1)
    remaining, following_changes = rows[: len(columns)], found.changes[: len(columns)]
    residual = linear.unbiased_residual().ravel()
    if pushes:  # what a common change of all samples at a bound explains is not evidence
        basis = rows[len(columns) :].T
        residual = residual - basis @ np.linalg.lstsq(basis, residual, rcond=None)[0]
    variances = linear.residual_variances(model_error)
    assert variances is not None
    weighted = remaining * variances.ravel()
    noise, hessian = (np.asarray(part @ remaining.T, float) for part in (weighted, remaining))
    gradient = np.asarray(remaining @ residual, float)
    unit = 1.0 / np.sqrt(np.diag(hessian))  # parameters have units of their own
    hessian, noise, gradient = hessian * np.outer(unit, unit), noise * np.outer(unit, unit), gradient * unit
    names = tuple(columns)
    estimate, used = _estimate(names, hessian, gradient)
    scores = _scores([names[j] for j in used], gradient[used], noise[np.ix_(used, used)])

    def correlation(change: NDArray[Any]) -> float:
        found, changed = (light.with_values(light.values * one) for one in (values, values + change))
        between = object_correlation(changed, found, light)
        return 1.0 if math.isnan(between) else between  # of an object that is as even as the light

    least_loss = LEAST_LOSS_OF_AMPLITUDE if kind == "amplitude" else LEAST_LOSS
    threshold, shown = _certain_chi_square(residual.size), linear.shown_fraction().ravel()
    undetected = []
    for j, name in enumerate(names):
        if name not in (*MOUNTING, *SOURCE):
            continue
        change = following_changes[j] * np.float32(unit[j])
        expected = np.asarray(remaining @ (shown * remaining[j]), float) * unit * unit[j]
        size = math.sqrt(threshold / _chi_square(expected, noise))
        for _ in range(MOST_ENLARGEMENTS):
            reached = correlation(np.float32(size) * change)
            if 1.0 - reached >= least_loss:
                break
            size *= ENLARGEMENT
        undetected.append(Undetected(name, _in_unit(name, float(size * unit[j])), reached))
    by_estimate = np.tensordot((estimate * unit).astype(np.float32), following_changes, 1)
    values_by_name = zip(names, (estimate * unit).tolist(), strict=True)
    return ScoreTest(
        {name: _in_unit(name, value) for name, value in values_by_name},
        _chi_square(gradient[used], noise[np.ix_(used, used)]),
        float(gradient @ estimate),
        correlation(by_estimate),
        least_loss,
        residual.size,
        max(scores, key=lambda cause: scores[cause], default=""),
        tuple(undetected),
    )


def _pushes_of_bounds(
    linear: LinearModel, is_free: NDArray[np.bool_], kind: Kind, values: NDArray[Any]
) -> list[RealArray]:
    """Return the changes of the amplitudes for a common change of all samples at each bound.

    Noise would lift about half of such samples of an amplitude object beyond their bound, and the total
    variation lowers contrast. The bound holds all of them on the same side, and what remains adds up to the
    effect of a bench that is wrong by many standard deviations.
    """
    if kind != "amplitude":
        return []
    held = linear.model.lit & ~is_free
    at_bounds = held & (values >= 1.0), held & (values <= 0.0)
    return [linear.jacobian_times_object(one.astype(values.dtype)) for one in at_bounds if np.any(one)]


def _in_unit(name: str, value: float) -> float:
    """Return a parameter in the unit of its name."""
    return math.sqrt(max(value, 0.0)) if name in SOURCE else value


def _estimate(names: Sequence[str], hessian: Array, gradient: Array) -> tuple[Array, list[int]]:
    """Return the estimated errors and the indices of those that count.

    A squared width below 0 is none: it is 0, and the others are estimated without it.
    """
    used = list(range(len(names)))
    while True:
        estimate = np.zeros(len(names))
        estimate[used] = np.linalg.solve(hessian[np.ix_(used, used)], gradient[used])
        negative = [j for j in used if names[j] in SOURCE and estimate[j] < 0.0]
        if not negative:
            return estimate, used
        used.remove(min(negative, key=lambda j: estimate[j]))


def _certain_chi_square(pixels: int) -> float:
    """Return the chi-square above which frames prefer another bench."""
    return CERTAIN_CHI_SQUARE + CERTAIN_PER_PIXEL * pixels


def _chi_square(gradient: Array, noise: Array) -> float:
    return float(gradient @ np.linalg.solve(noise, gradient))


def _scores(names: Sequence[str], gradient: Array, noise: Array) -> dict[str, float]:
    """Return the chi-square of the parameters of each cause alone; that of blur counts for less.

    Blur also takes away much of the misfit that a displacement of many depths of focus causes.
    """
    # Ratio of both for displacements on benches whose errors are known (`benchmarks/verdicts`).
    blur_factor = 2.5
    causes = [CAUSES.get(name.split("_")[0], "distance" if "distance" in name else "shift") for name in names]
    scores = {}
    for cause in dict.fromkeys(causes):
        indices = [n for n, name_of_cause in enumerate(causes) if name_of_cause == cause]
        scores[cause] = _chi_square(gradient[indices], noise[np.ix_(indices, indices)])
        if cause in ("source", "bandwidth"):
            scores[cause] /= blur_factor
    return scores


def _displaced_scenes(scene: Scene) -> dict[str, PerturbedScene]:
    """Return the scene with a small step of each parameter of the mounting."""
    aperture = min(scene.lens.object.numerical_aperture, 0.99)
    # Phase in rad at the rim of the aperture that a finite step of a parameter causes.
    step_rad = 0.12
    across_mm = step_rad / (2.0 * math.pi) * 1e-3 * scene.wavelength_um / aperture
    tilt_deg = math.degrees(3.0 * across_mm / abs(scene.lens.object_z_mm))
    scenes = {}
    for name, step in zip(MOUNTING, (across_mm, across_mm, tilt_deg, tilt_deg), strict=False):
        pose = replace(scene.pose, **{name: getattr(scene.pose, name) + step})
        scenes[name] = PerturbedScene(replace(scene, pose=pose), step)
    step, grid = 2.0 * across_mm / aperture, scene.object_grid
    scenes[MOUNTING[-1]] = PerturbedScene(replace(scene, object_grid=grid.at(grid.z_mm - step)), step)
    return scenes


def _mounting_columns(linear: LinearModel, without: Collection[str]) -> dict[str, RealArray]:
    """Return the changes of the modelled amplitudes per unit of each parameter of the mounting but some.

    They follow from the paths of displaced rays, or, for engines without rays, from displaced engines.
    """
    engine, lit = linear.model.engine, linear.lit
    assert isinstance(engine, Engine)
    scenes = {name: one for name, one in _displaced_scenes(engine.scene).items() if name not in without}
    displaced = list(scenes.values())
    if not displaced:
        return {}
    if isinstance(engine, FlatTiles):
        changes = exit_field_changes_by_rays(
            engine, lit, path_derivatives(engine, lit.values.dtype, displaced)
        )
    else:
        changes = exit_field_changes_by_engines(
            engine, lit, displaced, lambda scene: engine_on(engine, scene)
        )
    return dict(zip(scenes, map(linear.jacobian_times_exit_field, changes), strict=True))


def _plane_columns(linear: LinearModel, without: Collection[str]) -> dict[str, RealArray]:
    """Return changes per um of each plane's shift against the first plane, and per mm of its distance, but
    some.
    """
    measurement = linear.measurement
    assert isinstance(measurement, FreeSpaceMeasurement)
    columns = {}
    for n in range(1, len(linear.model.recorded)):
        for axis, letter in enumerate("xy"):
            name = f"plane_{n + 1}_shift_{letter}_um"
            if name not in without:
                columns[name] = linear.amplitude_change_on_plane(n, measurement.by_shift(n, axis))
        name = f"plane_distance_{n + 1}_mm"
        if name not in without:
            columns[name] = linear.amplitude_change_on_plane(n, measurement.by_distance(n))
    return columns


def _source_columns(linear: LinearModel, model: ChannelModel, values: NDArray[Any]) -> dict[str, RealArray]:
    """Return changes per squared width of the source, and per squared bandwidth of its light."""
    light = model.illumination
    coherent = [amplitude**2 for amplitude in model.amplitudes(values)]
    # Small enough for three wavelengths, and large enough for single precision.
    width_deg, bandwidth_nm = 0.5 * coherent_deg(light), 0.5 * coherent_nm(light)
    sources = (width_deg, Source(width_deg)), (bandwidth_nm, Source(0.0, bandwidth_nm))
    columns = {}
    for name, (width, source) in zip(SOURCE, sources, strict=True):
        changes = [-intensity for intensity in coherent]
        for mode in source.few_modes(light.wavelength_um):
            for change, amplitude in zip(changes, _amplitudes_of(mode, model, values), strict=True):
                change += change.dtype.type(mode.weight) * amplitude**2
        per_square = 0.5 / (model.scale * width) ** 2
        columns[name] = linear.amplitude_changes([change * np.float32(per_square) for change in changes])
    return columns


def _amplitudes_of(mode: SourceMode, model: ChannelModel, values: NDArray[Any]) -> list[RealArray]:
    """Return the amplitudes of one direction and wavelength; its engine exists only meanwhile."""
    assert isinstance(model.engine, Engine)
    engine = _at_similar_wavelength(model.engine, mode.wavelength_um)
    return ChannelModel.of_source(
        engine, mode.on(model.illumination), model.recorded, model.scale, model.fill_factor
    ).amplitudes(values)


def _at_similar_wavelength(engine: Engine, wavelength_um: float) -> Engine:
    """Return the engine for a different wavelength, of the same tiles if it has tiles and differs little."""
    change = abs(wavelength_um / engine.scene.wavelength_um - 1.0)
    if change == 0.0:
        return engine
    # Relative change for which tiles of the same amplitudes are accurate to a few percent of the effect.
    largest_change = 5e-3
    if change <= largest_change and type(engine) is FlatTiles and engine.plane.beyond is None:
        return PerturbedTiles(engine, replace(engine.scene, wavelength_um=wavelength_um))
    return engine.at_wavelength(wavelength_um)
