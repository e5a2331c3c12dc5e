"""Quality of a reconstruction: compared with the true object, on charts, and with the recorded frames."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.text import finite_or_none
from wavesim.fields.field import Field
from wavesim.metrics.charts import chart_resolution
from wavesim.metrics.contrast import object_correlation
from wavesim.metrics.displacement import displaced_back, displacement_samples, inside_both
from wavesim.metrics.low_orders import with_low_orders_of
from wavesim.metrics.similarity import psnr_db, ssim
from wavesim.metrics.transmitted_band import transmitted_directions, transmitted_part
from wavesim.runtime.scratch import Scratch
from wavesim.runtime.threads import row_blocks
from wavesim.scene.scene import Scene
from wavesim.targets.patterns import Polarity
from wavesim.targets.usaf import UsafElement


def truth_metrics(
    found: Field,
    true: Field,
    illumination: Field,
    inside: NDArray[np.bool_],
    scene: Scene,
    scratch: Scratch,
    *,
    low_orders: bool = False,
) -> dict[str, float | None]:
    """Return correlation, PSNR and SSIM with the true object, both as the lens transmits them.

    The correlation is that of object fields without the illumination. For PSNR and SSIM of the amplitudes,
    the result is multiplied by the complex factor that fits best. A displaced result is not blurred. Its
    displacement from the true object is therefore stated separately (`displacement_x_um`,
    `displacement_y_um`), with the correlation after its removal (`correlation_registered`). These values are
    None where result and object have too little in common.

    Parameters
    ----------
    found, true
        Complex transmissions on the part of the object that is judged.
    illumination
        Illumination of the same part.
    inside
        Mask of the samples within the field stop.
    scene
        The scene with the actual lens, whose rays determine what it transmits.
    scratch
        Storage of the fields that the lens transmits.
    low_orders
        Whether the correlation without low orders is stated, too (`correlation_without_low_orders`):
        that with the true object times the polynomial of second order that fits best. Frames of a complex or
        phase object do not determine ramp and curvature of its phase if light and mounting are uncertain.

    Returns
    -------
    dict
        Values by name; None where a value is not determined.
    """
    directions = transmitted_directions(scene, found.grid)

    def passed(values: Any) -> Field:
        own = illumination.with_values((illumination.values * values).astype(np.complex64, copy=False))
        there = transmitted_part(own, directions)
        return there.with_values(scratch.held(there.values, "a field within the lens's band"))

    displacement = displacement_samples(found.values, true.values, inside)
    other = passed(true.values)
    metrics: dict[str, float | None] = dict.fromkeys(
        ("object_correlation", "psnr_db", "ssim", "displacement_x_um", "displacement_y_um")
    )
    registered = None
    # Displacement in samples up to which a result lies where the object does.
    tolerance_samples = 0.05
    if displacement is not None and max(map(abs, displacement)) > tolerance_samples:
        there = passed(_displaced_back(found.values, inside, displacement))
        both = inside_both(inside, displacement)
        registered = object_correlation(there, other, passed(np.float32(1.0)), both)
        del there, both
    one = passed(found.values)
    correlation = object_correlation(one, other, passed(np.float32(1.0)), inside)
    metrics["object_correlation"] = correlation
    if displacement is not None:
        for axis, samples in zip("xy", displacement, strict=True):
            metrics[f"displacement_{axis}_um"] = 1e3 * found.grid.pitch_mm * samples
        registered = correlation if registered is None else registered
    metrics["correlation_registered"] = registered
    energy = _product(one.values, one.values, inside).real
    factor = _product(one.values, other.values, inside) / energy if energy > 0.0 else 0.0
    pair = _moduli(one.values, abs(factor)), _moduli(other.values)
    del other
    if low_orders:
        fitted = passed(with_low_orders_of(true, found, inside))
        metrics["correlation_without_low_orders"] = object_correlation(
            one, fitted, passed(np.float32(1.0)), inside
        )
        del fitted
    del one
    brightest = float(pair[1].max(where=inside, initial=0.0))
    metrics |= {
        "psnr_db": psnr_db(*pair, full_scale=brightest, support=inside),
        "ssim": ssim(*pair, full_scale=brightest, support=inside),
    }
    return {name: None if value is None else finite_or_none(value) for name, value in metrics.items()}


def _displaced_back(
    values: Any, inside: NDArray[np.bool_], displacement: tuple[float, float]
) -> NDArray[np.complex64]:
    """Return a transmission without its displacement; it is constant outside the stop, to move no edge."""
    factor = np.mean(values, where=inside, dtype=complex)
    moved = np.where(inside, values, factor).astype(np.complex64, copy=False)
    displaced_back(moved, displacement)
    return moved


def _product(a: Any, b: Any, inside: Any) -> complex:
    """Return the inner product within the field stop, without copies of whole fields."""
    blocks = row_blocks(len(inside))
    return complex(sum(complex(np.vdot(a[rows][inside[rows]], b[rows][inside[rows]])) for rows in blocks))


def _moduli(values: Any, factor: float = 1.0) -> Any:
    """Return moduli in single precision."""
    result = np.empty(values.shape, np.float32)
    for rows in row_blocks(len(values)):
        result[rows] = factor * np.abs(values[rows])
    return result


def chart_metrics(
    transmission: Field,
    elements: Sequence[UsafElement],
    ground: Polarity,
    passed_um: float,
    inside: NDArray[np.bool_] | None = None,
) -> dict[str, Any]:
    """Return the contrasts of a chart's elements in a part of the object, and the finest resolved element.

    The chart is registered first, and its displacement stated. Lines finer than `passed_um` are not
    transmitted by the lens. A result that shows them owes them to the method's assumptions on the object. The
    limit of the finest element is also stated (:class:`wavesim.metrics.charts.ChartResolution`).

    Parameters
    ----------
    transmission, elements, ground, passed_um, inside
        As in :func:`wavesim.metrics.charts.chart_resolution`.
    """
    return chart_resolution(transmission, elements, ground, passed_um, inside).as_dict()


def plane_metrics(amplitude: Any, sigma: Any, error: Any) -> dict[str, float | None]:
    """Return the residual of a plane, the residual of the stated noise alone, and the correlation A6.

    All valid pixels count. The values are None if there are none.

    Parameters
    ----------
    amplitude, sigma
        Measured amplitude and its standard deviation (:class:`wavesim.sensor.measurement.Measurement`).
    error
        Modelled minus measured amplitude.

    Returns
    -------
    dict
        "residual" and "noise" relative to the measured amplitude (L2), and "correlation" of amplitudes.
    """
    count, sums, noise = 0, np.zeros(2), 0.0
    products = np.zeros((2, 2))
    missed = 0.0
    for rows in row_blocks(len(error)):
        known = slice(None) if sigma is None else np.isfinite(sigma[rows])
        recorded = np.ravel(amplitude[rows][known]).astype(float)
        left = np.ravel(error[rows][known]).astype(float)
        pair = np.stack([recorded + left, recorded])
        count += recorded.size
        sums += pair.sum(axis=1)
        products += pair @ pair.T
        missed += float(left @ left)
        if sigma is not None:
            noise += float(np.sum(sigma[rows][known].astype(float) ** 2))
    if count == 0:
        return {"residual": None, "noise": None, "correlation": None}
    size = products[1, 1]
    about_means = products - np.outer(sums, sums) / count
    spread = math.sqrt(max(about_means[0, 0] * about_means[1, 1], 0.0))
    return {
        "residual": math.sqrt(missed / size),
        "noise": None if sigma is None else math.sqrt(noise / size),
        "correlation": float(about_means[0, 1]) / spread if spread > 0.0 else 0.0,
    }
