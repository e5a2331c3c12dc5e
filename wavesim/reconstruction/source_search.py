"""Angular width and bandwidth of the light source, found from the frames of an unknown object.

A source of the width w blurs a plane's intensity by an amount that grows as w^2, whether w is an angle or a
band of wavelengths. An object is sought for some iterations with a source of given widths. About it, a
Gauss-Newton step estimates the squared widths from what the object cannot imitate
(:mod:`wavesim.reconstruction.object_response`). The search for the object continues from there until the
widths converge. Angles blur all parts of a plane alike, and wavelengths blur parts far from the axis most, so
that both can be found together.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from wavesim.fields.field import Field
from wavesim.forward.channel_model import ChannelModel
from wavesim.forward.linear_model import LinearModel, RealArray
from wavesim.forward.stacked_channels import ChannelsMeasurement
from wavesim.reconstruction.object_response import eliminated_object, free_samples
from wavesim.reconstruction.object_solver import Reconstructed, reconstruct
from wavesim.scene.engine import Engine
from wavesim.scene.settings import FramedSettings, Kind, ReconstructionSettings
from wavesim.scene.source import POINT, Source, SourceMode
from wavesim.sensor.measurement import Measurement

MOST_WIDTHS, ITERATIONS, FIRST_ITERATIONS = 12, 6, 40
"""Largest number of sources that are tried, iterations of the object with each, and those before the first.

The first iterations are those of a point source, which take little time. An object that is far from the true
one would make blur of its errors.
"""

BROADEST = 8.0
"""Largest bandwidth that is sought, over the one that shifts the steepest light by a speckle.

Each wavelength needs an engine, and a broader band needs more of them.
"""

WIDEST_DEG = 89.0
"""Largest width of a source that is sought, in deg."""

WIDTHS = "width_deg", "bandwidth_nm"
"""Names of the widths of a source."""


class SourceWarning(UserWarning):
    """A width of the light's source was not determined."""


@dataclass(frozen=True, eq=False)
class FoundSource:
    """A source that was found from frames.

    Attributes
    ----------
    source : Source
        The source.
    deviations : dict
        Standard deviation of each width that was determined, by its name (`WIDTHS`). For a width of 0 it is
        the width up to which the frames cannot exclude a source.
    transmission : Field
        The object found with it.
    at_limit : tuple of str
        Names of the widths at the limit of the search. The source is probably wider.
    has_converged : bool
        Whether the widths converged.
    """

    source: Source
    deviations: dict[str, float]
    transmission: Field
    at_limit: tuple[str, ...] = ()
    has_converged: bool = True


def stated_source(settings: FramedSettings, calibrated: Source = POINT) -> Source:
    """Return the source that settings state; each width that they do not state is that of a calibration.

    Widths that are to be found are 0.
    """
    values = zip(
        (settings.source_deg, settings.bandwidth_nm),
        (calibrated.width_deg, calibrated.bandwidth_nm),
        strict=True,
    )
    return Source(*(known if value is None else 0.0 if value == "find" else value for value, known in values))


def sought_widths(settings: FramedSettings) -> tuple[str, ...]:
    """Return the names of the widths (`WIDTHS`) that settings ask to find."""
    values = settings.source_deg, settings.bandwidth_nm
    return tuple(name for name, value in zip(WIDTHS, values, strict=True) if value == "find")


def find_source(
    engine: Engine,
    light: Field,
    recorded: Sequence[Measurement],
    settings: ReconstructionSettings,
    progress: Callable[[str], None],
    *,
    known: Source = POINT,
    start: Field | None = None,
) -> FoundSource:
    """Return the source of the light, and the object found with it.

    Parameters
    ----------
    engine, light, recorded
        See :func:`wavesim.reconstruct`; the planes have standard deviations.
    settings
        Settings of the reconstruction. `source_deg`, `bandwidth_nm` or both are "find".
    progress
        Called with a message for each source that is tried.
    known
        Source with the width that is known; widths that are sought are ignored.
    start
        Object with which the search starts; default: an even one.

    Warns
    -----
    SourceWarning
        If a width reaches the limit of the search, or the widths do not converge.
    """
    sought = sought_widths(settings)
    units = {"width_deg": coherent_deg(light), "bandwidth_nm": coherent_nm(light)}
    largest = {"width_deg": WIDEST_DEG, "bandwidth_nm": BROADEST * units["bandwidth_nm"]}
    source = replace(known, **{name: min(units[name], largest[name]) for name in sought})
    transmission = start or light.with_values(np.ones_like(light.values))
    # Relative change of a width at which the search ends.
    tolerance = 0.02
    # Largest factors by which a width decreases and increases at a time.
    least_factor, largest_factor = 0.25, 2.0
    # Smallest width over that at which half of the object is lit coherently. Narrower sources are points.
    least_width = 0.1
    deviations = dict[str, float]()
    at_limit, has_converged = set[str](), False

    def improved(transmission: Field, iterations: int) -> Reconstructed:
        return reconstruct(
            engine,
            light,
            recorded,
            kind=settings.kind,
            tv_weight=settings.tv_weight,
            iterations=iterations,
            scale=settings.scale,
            start=transmission,
            fill_factor=settings.fill_factor,
            modes=modes_on(light, source),
        )

    if start is None:
        widths = source
        source = replace(known, **dict.fromkeys(sought, 0.0))
        progress("object in light of a point source")
        transmission = improved(transmission, FIRST_ITERATIONS).transmission
        source = widths
    for _ in range(MOST_WIDTHS):
        names = [name for name in sought if getattr(source, name)]
        if not names:
            has_converged = True
            break
        progress(_source_text(source, names))
        found = improved(transmission, ITERATIONS)
        transmission = found.transmission
        model = ChannelModel.of_source(
            engine, light, recorded, found.scale, settings.fill_factor, modes=modes_on(light, source)
        )
        is_real = settings.kind == "amplitude"
        values = transmission.values.real if is_real else transmission.values
        linear = LinearModel(model, values, settings.scale is None)
        squares, variances = squared_widths(linear, source, names, settings.kind, values)
        has_converged = True
        for name, square, variance in zip(names, squares.tolist(), variances.tolist(), strict=True):
            width = getattr(source, name)
            new = math.sqrt(max(square, (least_factor * width) ** 2))
            new = min(new, largest_factor * width)
            at_limit.discard(name)
            if new >= largest[name]:
                new = largest[name]
                at_limit.add(name)
            # Deviations of the square up to which a source counts as a point.
            deviation, point_deviations = math.sqrt(variance), 2.0
            is_point = square < point_deviations * deviation or new < least_width * units[name]
            if is_point and new < 0.5 * units[name]:
                new, deviations[name] = 0.0, math.sqrt(max(square, 0.0) + point_deviations * deviation)
            else:
                deviations[name] = deviation / (2.0 * new)
            has_converged = has_converged and abs(new - width) < tolerance * width
            source = replace(source, **{name: new})
        if has_converged:
            break
    _warn_of_undetermined(source, sought, at_limit, has_converged)
    known_deviations = {
        name: deviation for name, deviation in deviations.items() if has_converged and name not in at_limit
    }
    return FoundSource(source, known_deviations, transmission, tuple(sorted(at_limit)), has_converged)


def _warn_of_undetermined(
    source: Source, sought: Sequence[str], at_limit: Collection[str], has_converged: bool
) -> None:
    """Warn if a width is at the limit of the search, or if the widths did not converge."""
    for name in at_limit:
        message = (
            f"{_source_text(source, (name,))} is the limit of the search, so that it is not determined: "
            "the source is probably wider; state it if it is known"
        )
        if name == "bandwidth_nm":
            message += ", use a narrower filter, or light a smaller patch"
        warnings.warn(message, SourceWarning, stacklevel=3)
    if not has_converged:
        warnings.warn(
            f"{_source_text(source, sought)}: the search did not converge with {MOST_WIDTHS} sources, so "
            "that this is not determined; state it if it is known",
            SourceWarning,
            stacklevel=3,
        )


def squared_widths(
    linear: LinearModel, source: Source, names: Sequence[str], kind: Kind, values: NDArray[Any]
) -> tuple[Array, Array]:
    """Return the estimates of squared widths of a source, and their variances.

    Parameters
    ----------
    linear
        Linear model about an object in light of the source.
    source
        The source; the widths that are estimated are not 0.
    names
        Names of the widths (`WIDTHS`).
    kind, values
        Kind of the object, and its transmission, which is real for an amplitude object.
    """
    columns = np.stack(source_columns(linear, source, names))
    left = eliminated_object(linear, columns, free_samples(linear, values), kind, values)
    columns = left.columns.reshape(len(columns), -1)
    residual = linear.unbiased_residual().ravel()
    noise = linear.residual_variances(0.0)
    assert noise is not None
    # A misfit beyond the noise is an error of the model, which limits the information like noise.
    excess = max(1.0, float(np.vdot(residual, residual)) / float(noise.sum(dtype=float)))
    hessian = np.asarray(columns @ columns.T, float)
    power = np.asarray((columns * noise.ravel()) @ columns.T, float) * excess
    inverse = np.linalg.inv(hessian)
    widths = np.array([getattr(source, name) for name in names])
    steps = inverse @ np.asarray(columns @ residual, float)
    return widths**2 + steps, np.diag(inverse @ power @ inverse)


def source_columns(linear: LinearModel, source: Source, names: Sequence[str]) -> list[RealArray]:
    """Return the changes of the modelled amplitudes per squared width of the source, by its modes.

    Parameters
    ----------
    linear
        Linear model in light of the source.
    source
        The source; the widths that change are not 0.
    names
        Names of the widths (`WIDTHS`).
    """
    measurement, light = linear.measurement, linear.model.illumination
    assert isinstance(measurement, ChannelsMeasurement)
    changes = source.few_mode_changes(light.wavelength_um, samples=max(light.grid.shape))
    factors = dict(zip(WIDTHS, changes, strict=True))
    return [
        linear.amplitude_changes(
            [np.float32(0.5) * each for each in measurement.weighted_intensities(factors[name])]
        )
        for name in names
    ]


def _source_text(source: Source, names: Sequence[str]) -> str:
    texts = {
        "width_deg": f"width of the source: {source.width_deg:.3g}°",
        "bandwidth_nm": f"bandwidth of the light: {source.bandwidth_nm:.3g} nm",
    }
    return ", ".join(texts[name] for name in names)


def modes_on(light: Field, source: Source) -> list[SourceMode]:
    """Return the few modes of a source that a reconstruction uses for the light on an object."""
    return source.few_modes(light.wavelength_um, samples=max(light.grid.shape))


def coherent_deg(light: Field) -> float:
    """Return the source width in deg whose light is coherent over about half of the lit object.

    It is the wavelength over the diameter of the lit area.
    """
    return math.degrees(1e-3 * light.wavelength_um / _diameter_mm(light))


def coherent_nm(light: Field) -> float:
    """Return the bandwidth in nm over which the steepest light shifts on the sensor by one speckle.

    Light of all directions that the samples hold forms about D / (2 p) speckles from the axis to the rim, for
    samples of the pitch p over the diameter D of the lit area. A relative change of the wavelength stretches
    the picture by the same factor.
    """
    return 1e3 * light.wavelength_um * 2.0 * light.grid.pitch_mm / _diameter_mm(light)


def _diameter_mm(light: Field) -> float:
    lit = np.abs(light.values) > 1e-3 * np.abs(light.values).max()
    return 2.0 * math.sqrt(np.count_nonzero(lit) * light.grid.cell / math.pi)
