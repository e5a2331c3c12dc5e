"""Score test of the bench: whether frames prefer another one, and which small errors they cannot exclude.

About the object found, modelled amplitudes change by d_j for a unit of parameter j (decenter, tilt, working
distance, shift and distance of a plane). The object follows such a change and takes up what it can; column j
of D is what remains of d_j, found by conjugate gradients. With the residuals r and their variances V,

    theta = (D'D)^-1 D'r,    chi^2 = (D'r)' (D'V D)^-1 (D'r)

are the errors that the frames ask for, and how surely they do. Both come from one linear model about the
result (:class:`wavesim.reconstruction.linear.linearised.Linearised`).

Source: C. R. Rao, "Large sample tests of statistical hypotheses concerning several parameters", Math. Proc.
Camb. Phil. Soc. 44, 50 (1948).
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
from wavesim.metrics.goodness_of_fit import Undetected
from wavesim.reconstruction.forward_model import ForwardModel
from wavesim.reconstruction.from_field import agreement
from wavesim.reconstruction.linear.linearised import Linearised, RealArray
from wavesim.reconstruction.linear.measurement_operator import FreeSpaceMeasurement
from wavesim.scene.engine import Engine
from wavesim.scene.scene import Scene
from wavesim.scene.settings import Kind
from wavesim.sensor.measurement import Measurement, weights_of

MOUNTING = ("decenter_x_mm", "decenter_y_mm", "tilt_x_deg", "tilt_y_deg", "working_distance_mm")

STEP_RAD = 0.12
"""Phase at the rim of the aperture by which a parameter is changed to take a difference quotient."""

ROUNDS = 12
"""Conjugate gradients by which the object follows a change."""

DEVIATIONS = 2.0
"""Standard deviations up to which an error of the bench is within the noise."""

SURE_CHI_SQUARE, SURE_EACH = 60.0, 3e-3
"""Chi-square from which on frames prefer another bench: so much, and so much more for each pixel, since small
errors of the model and iterations that end early add up over pixels. Perfect benches bring a third of it."""

LEAST_LOSS = 0.004
"""Loss of correlation from which on the error that frames ask for matters."""

CAUSES = {"decenter": "mounting", "tilt": "mounting", "working": "working distance"}


@dataclass(frozen=True)
class ScoreTest:
    """What frames say of small errors of the bench.

    Attributes
    ----------
    estimate : mapping
        Errors that the frames ask for, by parameter.
    chi_square : float
        How surely they do: about the number of parameters where the bench is as stated.
    correlation : float
        Of the object found with the one that these errors would give.
    pixels : int
        Of all planes.
    cause : str
        The cause that explains most.
    undetected : tuple of Undetected
        What the frames cannot exclude of decenter, tilt and working distance.
    """

    estimate: Mapping[str, float]
    chi_square: float
    correlation: float
    pixels: int
    cause: str
    undetected: tuple[Undetected, ...]

    @property
    def is_preferred(self) -> bool:
        """Whether frames surely ask for another bench, and the object would be another one."""
        sure = SURE_CHI_SQUARE + SURE_EACH * self.pixels
        return self.chi_square > sure and 1.0 - self.correlation > LEAST_LOSS

    @property
    def explanation(self) -> str:
        """What the frames ask for, in words."""
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
    """Test the bench that was assumed against small errors of it.

    Parameters
    ----------
    engine, light, recorded, kind, fill_factor
        As of :func:`wavesim.reconstruct`; light of a point source.
    transmission : ndarray
        The object found, on the samples of the light.
    scale, fits_scale
        Recorded amplitude for a unit of the model's, and whether it was fitted.
    model_error
        Relative error of amplitudes that engine and pixels may have.
    progress
        Called with what is computed.

    Raises
    ------
    TransferLensError
        Where the scene does not take small displacements.
    """
    model = ForwardModel(engine, light, recorded, scale, fill_factor)
    values = transmission.real if kind == "amplitude" else transmission
    linear = Linearised(model, values, fits_scale)
    model.scale = linear.scale
    columns: dict[str, RealArray] = {}
    for name, scene, step in _displaced(engine.scene):
        progress(f"effect of {name}")
        columns[name] = _of_scene(linear, scene, step)
    columns |= _of_planes(linear)
    free = _free(linear, values)
    followed = []
    for name, column in columns.items():
        progress(f"effect of {name} with the best object")
        followed.append(_follow(linear, column, free, kind == "amplitude"))
        columns[name] = column + linear.of_object(followed[-1])
    left = np.stack([column.ravel() for column in columns.values()])
    residual = linear.residual.ravel()
    weighted = left * _variances(recorded, linear, model_error)
    noise, curvature = (np.asarray(one @ left.T, float) for one in (weighted, left))
    slope = np.asarray(left @ residual, float)
    unit = 1.0 / np.sqrt(np.diag(curvature))  # parameters have units of their own
    curvature, noise, slope = curvature * np.outer(unit, unit), noise * np.outer(unit, unit), slope * unit
    estimate = np.linalg.solve(curvature, slope)
    scores = _scores(tuple(columns), slope, noise)

    def correlation(shift: Array) -> float:
        change = np.tensordot((shift * unit).astype(np.float32), np.stack(followed), 1)
        return agreement([light.with_values(light.values * one) for one in (values, values + change)])

    undetected = []
    for j, name in enumerate(MOUNTING):
        size = DEVIATIONS * math.sqrt(noise[j, j]) + model_error
        one = correlation(size * np.eye(len(columns))[j])
        undetected.append(Undetected(name, float(size * unit[j]), one))
    return ScoreTest(
        dict(zip(columns, (estimate * unit).tolist(), strict=True)),
        float(slope @ np.linalg.solve(noise, slope)),
        correlation(estimate),
        residual.size,
        max(scores, key=lambda cause: scores[cause]),
        tuple(undetected),
    )


def _scores(names: Sequence[str], slope: Array, noise: Array) -> dict[str, float]:
    """Chi-square of the parameters of each cause alone."""
    causes = [CAUSES.get(name.split("_")[0], "distance" if "distance" in name else "shift") for name in names]
    found = {}
    for cause in dict.fromkeys(causes):
        mine = [n for n, one in enumerate(causes) if one == cause]
        found[cause] = float(slope[mine] @ np.linalg.solve(noise[np.ix_(mine, mine)], slope[mine]))
    return found


def _displaced(scene: Scene) -> Iterator[tuple[str, Scene, float]]:
    """Scenes with one displacement each, its name and size."""
    aperture = min(scene.lens.object.numerical_aperture, 0.99)
    across_mm = STEP_RAD / (2.0 * math.pi) * 1e-3 * scene.wavelength_um / aperture
    tilt_deg = math.degrees(3.0 * across_mm / abs(scene.lens.object_z_mm))
    for name, step in zip(MOUNTING, (across_mm, across_mm, tilt_deg, tilt_deg), strict=False):
        pose = replace(scene.pose, **{name: getattr(scene.pose, name) + step})
        yield name, replace(scene, pose=pose), step
    step, grid = 2.0 * across_mm / aperture, scene.object_grid
    yield MOUNTING[-1], replace(scene, object_grid=grid.at(grid.z_mm - step)), step


def _of_scene(linear: Linearised, scene: Scene, step: float) -> RealArray:
    """Change of the modelled amplitudes for a unit of a displacement."""
    engine, lit = linear.model.engine, linear.lit
    assert isinstance(engine, Engine)
    displaced = engine_on(engine, scene)
    after = displaced.forward(replace(lit, grid=scene.object_grid)).values
    return linear.of_exit(((after - engine.forward(lit).values) / step).astype(after.dtype))


def _of_planes(linear: Linearised) -> dict[str, RealArray]:
    """Changes for a um of each plane's shift against the first, and for a mm of its distance."""
    sight = linear.sight
    assert isinstance(sight, FreeSpaceMeasurement)
    found = {}
    for n in range(1, len(linear.model.recorded)):
        for axis, letter in enumerate("xy"):
            found[f"plane_{n + 1}_shift_{letter}_um"] = linear.of_plane(n, sight.by_shift(n, axis))
        found[f"plane_{n + 1}_distance_mm"] = linear.of_plane(n, sight.by_distance(n))
    return found


def _free(linear: Linearised, values: NDArray[Any]) -> NDArray[np.bool_]:
    """Samples that may follow: lit, and not held at a limit."""
    free = linear.model.lit
    if np.iscomplexobj(values):
        return free
    slope = linear.to_object(linear.residual).real
    stuck = ((values <= 0.0) & (slope < 0.0)) | ((values >= 1.0) & (slope > 0.0))
    return np.asarray(free & ~stuck)


def _follow(linear: Linearised, column: RealArray, free: NDArray[np.bool_], is_real: bool) -> NDArray[Any]:
    """Change x of the transmission with the least |column + J x|, by conjugate gradients (CGLS)."""

    def slope(left: RealArray) -> NDArray[Any]:
        back = linear.to_object(left)
        return np.asarray((back.real if is_real else back) * free)

    left = column.copy()
    direction = -slope(left)
    found, energy = np.zeros_like(direction), float(np.vdot(direction, direction).real)
    for _ in range(ROUNDS):
        seen = linear.of_object(direction)
        size = float(np.vdot(seen, seen))
        if size <= 0.0 or energy <= 0.0:
            break
        length = np.float32(energy / size)
        found += length * direction
        left += length * seen
        descent = -slope(left)
        before, energy = energy, float(np.vdot(descent, descent).real)
        direction = descent + np.float32(energy / before) * direction
    return found


def _variances(recorded: Sequence[Measurement], linear: Linearised, model_error: float) -> RealArray:
    """Of the weighted residuals."""
    found = []
    for plane, weight in zip(recorded, weights_of(recorded), strict=True):
        assert plane.sigma is not None
        assert weight is not None
        sigma = np.where(np.isfinite(plane.sigma), plane.sigma, 0.0)
        found.append(weight * (sigma**2 + np.float32(model_error**2) * plane.amplitude**2))
    return np.asarray(np.stack(found).ravel() / np.float32(linear.size**2))
