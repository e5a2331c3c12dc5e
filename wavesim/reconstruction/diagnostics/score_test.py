"""Score test of the bench: whether frames prefer another bench, and which small errors they cannot exclude.

About the object found, the modelled amplitudes change by d_j per unit of parameter j (decenter, tilt,
working distance, shift and distance of a plane). The object follows such a change and compensates part of
it. Column j of D is the remainder of d_j, found by conjugate gradients. With the residuals r and their
variances V,

    theta = (D'D)^-1 D'r,    chi^2 = (D'r)' (D'V D)^-1 (D'r)

are the estimated errors of the bench, and their significance. Both come from one linear model about the
result (:class:`wavesim.forward.linear_model.LinearModel`).

References
----------
C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Math. Proc. Camb.
Phil. Soc. 44, 50 (1948).
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.engines.registry import engine_on
from wavesim.fields.field import Field
from wavesim.forward.forward_model import ForwardModel
from wavesim.forward.linear_model import FreeSpaceMeasurement, LinearModel, RealArray
from wavesim.metrics.goodness_of_fit import Undetected
from wavesim.reconstruction.phase_retrieval import agreement
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import Measurement, weights_of

MOUNTING = ("decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg", "working_distance_mm")

CERTAIN_CHI_SQUARE, CERTAIN_PER_PIXEL = 60.0, 3e-3
"""Chi-square above which frames prefer another bench: a constant, plus an amount for each pixel.

Small model errors and iterations that end early add up over pixels. A bench as designed reaches about a
third of this value.
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
    correlation : float
        Correlation between the object found and the one that these errors would give.
    pixels : int
        Number of pixels of all planes.
    cause : str
        The cause that explains most.
    undetected : tuple of Undetected
        Errors of the mounting that the frames cannot exclude.
    """

    estimate: Mapping[str, float]
    chi_square: float
    correlation: float
    pixels: int
    cause: str
    undetected: tuple[Undetected, ...]

    @property
    def is_preferred(self) -> bool:
        """True if frames clearly prefer another bench, and the object would differ."""
        threshold = CERTAIN_CHI_SQUARE + CERTAIN_PER_PIXEL * self.pixels
        # Loss of correlation above which an error of the bench matters.
        least_loss = 0.004
        return self.chi_square > threshold and 1.0 - self.correlation > least_loss

    @property
    def explanation(self) -> str:
        """Sentence that names the errors of the bench."""
        head = {"mounting": ("decenter", "tilt"), "working distance": ("working",)}.get(
            self.cause, ("plane",)
        )
        parts = [
            f"{name.replace('_', ' ')} {value:+.2g}"
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
    progress: Callable[[str], None] = lambda what: None,
) -> ScoreTest:
    """Test the assumed bench against small errors.

    Parameters
    ----------
    engine, light, recorded, kind, fill_factor
        See :func:`wavesim.reconstruct`; the light is that of a point source.
    transmission : ndarray
        The object found, on the samples of the light.
    scale, fits_scale
        Measured amplitude per unit of the modelled amplitude, and whether it was fitted.
    model_error
        Relative error of amplitudes due to engine and pixels.
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
    model = ForwardModel(engine, light, recorded, scale, fill_factor)
    values = transmission.real if kind == "amplitude" else transmission
    linear = LinearModel(model, values, fits_scale)
    model.scale = linear.scale
    columns: dict[str, RealArray] = {}
    for name, scene, step in _displaced_scenes(engine.scene):
        progress(f"effect of {name}")
        columns[name] = _scene_column(linear, scene, step)
    columns |= _plane_columns(linear)
    free_samples = _free_samples(linear, values)
    following_changes = []
    for name, column in columns.items():
        progress(f"effect of {name} with the best object")
        following_changes.append(_following_change(linear, column, free_samples, kind == "amplitude"))
        columns[name] = column + linear.jacobian_times_object(following_changes[-1])
    remaining = np.stack([column.ravel() for column in columns.values()])
    residual = linear.residual.ravel()
    weighted = remaining * _variances(recorded, linear, model_error)
    noise, hessian = (np.asarray(part @ remaining.T, float) for part in (weighted, remaining))
    gradient = np.asarray(remaining @ residual, float)
    unit = 1.0 / np.sqrt(np.diag(hessian))  # parameters have units of their own
    hessian, noise, gradient = hessian * np.outer(unit, unit), noise * np.outer(unit, unit), gradient * unit
    estimate = np.linalg.solve(hessian, gradient)
    scores = _scores(tuple(columns), gradient, noise)

    def correlation(shift: Array) -> float:
        change = np.tensordot((shift * unit).astype(np.float32), np.stack(following_changes), 1)
        return agreement([light.with_values(light.values * one) for one in (values, values + change)])

    undetected = []
    # Standard deviations up to which an error of the bench counts as noise.
    deviations = 2.0
    for j, name in enumerate(MOUNTING):
        size = deviations * math.sqrt(noise[j, j]) + model_error
        detected = correlation(size * np.eye(len(columns))[j])
        undetected.append(Undetected(name, float(size * unit[j]), detected))
    return ScoreTest(
        dict(zip(columns, (estimate * unit).tolist(), strict=True)),
        float(gradient @ np.linalg.solve(noise, gradient)),
        correlation(estimate),
        residual.size,
        max(scores, key=lambda cause: scores[cause]),
        tuple(undetected),
    )


def _scores(names: Sequence[str], gradient: Array, noise: Array) -> dict[str, float]:
    """Return the chi-square of the parameters of each cause alone."""
    cause_of_prefix = {"decenter": "mounting", "tilt": "mounting", "working": "working distance"}
    causes = [
        cause_of_prefix.get(name.split("_")[0], "distance" if "distance" in name else "shift")
        for name in names
    ]
    scores = {}
    for cause in dict.fromkeys(causes):
        indices = [n for n, name_of_cause in enumerate(causes) if name_of_cause == cause]
        scores[cause] = float(
            gradient[indices] @ np.linalg.solve(noise[np.ix_(indices, indices)], gradient[indices])
        )
    return scores


def _displaced_scenes(scene: Scene) -> Iterator[tuple[str, Scene, float]]:
    """Yield the name of each displacement, the displaced scene, and the size of the step."""
    aperture = min(scene.lens.object.numerical_aperture, 0.99)
    # Phase in rad at the rim of the aperture that a finite step of a parameter causes.
    step_rad = 0.12
    across_mm = step_rad / (2.0 * math.pi) * 1e-3 * scene.wavelength_um / aperture
    tilt_deg = math.degrees(3.0 * across_mm / abs(scene.lens.object_z_mm))
    for name, step in zip(MOUNTING, (across_mm, across_mm, tilt_deg, tilt_deg), strict=False):
        pose = replace(scene.pose, **{name: getattr(scene.pose, name) + step})
        yield name, replace(scene, pose=pose), step
    step, grid = 2.0 * across_mm / aperture, scene.object_grid
    yield MOUNTING[-1], replace(scene, object_grid=grid.at(grid.z_mm - step)), step


def _scene_column(linear: LinearModel, scene: Scene, step: float) -> RealArray:
    """Return the change of the modelled amplitudes per unit of a displacement."""
    engine, lit = linear.model.engine, linear.lit
    assert isinstance(engine, Engine)
    displaced = engine_on(engine, scene)
    after = displaced.forward(replace(lit, grid=scene.object_grid)).values
    return linear.jacobian_times_exit_field(((after - engine.forward(lit).values) / step).astype(after.dtype))


def _plane_columns(linear: LinearModel) -> dict[str, RealArray]:
    """Return changes per um of each plane's shift against the first plane, and per mm of its distance."""
    measurement = linear.measurement
    assert isinstance(measurement, FreeSpaceMeasurement)
    columns = {}
    for n in range(1, len(linear.model.recorded)):
        for axis, letter in enumerate("xy"):
            columns[f"plane_{n + 1}_shift_{letter}_um"] = linear.amplitude_change_on_plane(
                n, measurement.by_shift(n, axis)
            )
        columns[f"plane_{n + 1}_distance_mm"] = linear.amplitude_change_on_plane(
            n, measurement.by_distance(n)
        )
    return columns


def _free_samples(linear: LinearModel, values: NDArray[Any]) -> NDArray[np.bool_]:
    """Return lit samples of the object that are not at a bound."""
    free_samples = linear.model.lit
    if np.iscomplexobj(values):
        return free_samples
    gradient = linear.adjoint_to_object(linear.residual).real
    is_at_bound = ((values <= 0.0) & (gradient < 0.0)) | ((values >= 1.0) & (gradient > 0.0))
    return np.asarray(free_samples & ~is_at_bound)


def _following_change(
    linear: LinearModel, column: RealArray, free_samples: NDArray[np.bool_], is_real: bool
) -> NDArray[Any]:
    """Return the change x of the transmission with the least |column + J x|, by CGLS."""

    def gradient(remaining: RealArray) -> NDArray[Any]:
        on_object = linear.adjoint_to_object(remaining)
        return np.asarray((on_object.real if is_real else on_object) * free_samples)

    remaining = column.copy()
    direction = -gradient(remaining)
    change_of_object, energy = np.zeros_like(direction), float(np.vdot(direction, direction).real)
    # Iterations of conjugate gradients by which the object follows a change.
    following_iterations = 12
    for _ in range(following_iterations):
        change = linear.jacobian_times_object(direction)
        size = float(np.vdot(change, change))
        if size <= 0.0 or energy <= 0.0:
            break
        length = np.float32(energy / size)
        change_of_object += length * direction
        remaining += length * change
        descent = -gradient(remaining)
        before, energy = energy, float(np.vdot(descent, descent).real)
        direction = descent + np.float32(energy / before) * direction
    return change_of_object


def _variances(recorded: Sequence[Measurement], linear: LinearModel, model_error: float) -> RealArray:
    """Return the variances of the weighted residuals."""
    variances = []
    for plane, weight in zip(recorded, weights_of(recorded), strict=True):
        assert plane.sigma is not None
        assert weight is not None
        sigma = np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
        variances.append(weight * (sigma**2 + np.float32(model_error**2) * plane.amplitude**2))
    return np.asarray(np.stack(variances).ravel() / np.float32(linear.size**2))
