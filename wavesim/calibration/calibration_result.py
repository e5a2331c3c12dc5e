"""Result of a calibration: a bench that explains the frames, and its file."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from pydantic import Field

from lensdesign.common.arrays import Array
from lensdesign.common.frozen_model import Finite, FrozenModel
from lensdesign.common.input_files import read_json
from lensdesign.common.text import name_with_unit, number_with_unit, words_and_unit
from lensdesign.common.toml_files import did_you_mean, validate
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.poses import Pose
from lensdesign.plots.style import BLUE, GREY, ORANGE, in_style, styled_figure
from wavesim.calibration.joint.search import CONVERGED
from wavesim.calibration.object_uncertainty import ObjectUncertainty
from wavesim.calibration.parameters import Parameter, StopShift, Unknowns, parameters_by_name
from wavesim.metrics.goodness_of_fit import BenchUncertainty, GoodnessOfFit
from wavesim.plots.frames import save
from wavesim.reconstruction.calibrated_bench import (
    JUDGED_OBJECT,
    CalibratedBench,
    JudgedObject,
    read_judged_object,
)
from wavesim.reconstruction.field_stop import FieldStop
from wavesim.runtime.result import WritableResult
from wavesim.scene.settings import StopOrigin
from wavesim.scene.state_files import STATE, state_of_file, state_table
from wavesim.scene.system_state import SystemState

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


@dataclass(frozen=True, eq=False, repr=False)
class Calibrated(WritableResult):
    """A calibrated bench, and the quality of the calibration.

    :func:`wavesim.calibrate_frames` returns it. The n parameters are numbers in the unit that their names
    state.

    Attributes
    ----------
    state : SystemState
        The calibrated state of lens, light and camera.
    sought : tuple of Parameter
        The n parameters that were sought.
    values : tuple of float
        Estimate of each parameter.
    deviations : tuple of float or None
        Standard deviation of each estimate, with the prior included; None for a known object, and where they
        were not requested.
    covariance : ndarray of shape (n, n), or None
        Covariance of the estimates, with the prior included. It is also None where frames without an object
        determined the light.
    typical : tuple of float or None
        Expected standard deviation of each parameter (prior).
    misfit_before, misfit : float
        Relative L2 difference between modelled and recorded amplitudes at the start, and with the calibrated
        bench. Each is computed with the object that fits best.
    trail : tuple of (tuple of float, float)
        Values that were tried, and their misfits.
    stopped_because : str
        Reason for the end of the search.
    misfit_of_noise : float or None
        Misfit that the stated noise alone would leave (:func:`wavesim.sensor.measurement.noise_misfit`).
    correlated_with : mapping
        Parameters that the frames do not distinguish from others, each with the names of the others.
    nominal : tuple of str
        Parameters that the frames do not need. The bench has their nominal values instead of the estimates.
    undetermined : tuple of str
        Parameters that were not sought, because a complex object can imitate them.
    applied : mapping or None
        Values that the bench has, by name; None where they are the estimates.
    verdict : GoodnessOfFit or None
        Assessment of the object on this bench by :func:`wavesim.reconstruct_frames`; None if it was not
        requested.
    field_stop_mm : float or None
        Diameter of the field stop of the light in mm.
    field_stop_at_mm : (x, y)
        Center of the field stop in mm.
    field_stop_from : str
        Origin of the field stop: "patch" if nothing was stated, "stated", or "frames" if it was found.
    source_deviations : mapping
        Standard deviations of the widths of the light's source that were found, by name, on this bench. The
        source is part of the state.
    object_uncertainty : ObjectUncertainty or None
        Errors of the object that the covariance allows; None for a known object.
    evidence_key : str
        Digest of frames, light and kind of object (:func:`wavesim.reconstruction.problem.evidence_key`).
    judged : JudgedObject or None
        The object of the verdict.

    Examples
    --------
    A lens that is decentered by 5 um, calibrated with frames of a known object:

    >>> from lensdesign import load_design, scaled
    >>> from wavesim import calibrate_frames, image
    >>> lens = scaled(load_design("designs/paper_singlet.toml"), 1 / 64)
    >>> patch = {"patch_mm": 0.02, "engine": "eikonal", "error": 0.1}
    >>> taken = image(lens, "tissue", planes_mm=(0.03,), decenter_x_mm=0.005, **patch)
    >>> known = taken.target.transmission
    >>> found = calibrate_frames(lens, taken.frames, known=known, parameters="decenter_x_mm", **patch)
    >>> round(found.state.pose.decenter_x_mm, 3), found.misfit < found.misfit_before
    (0.005, True)
    """

    heading, file = "Bench as it is", "calibration.json"

    state: SystemState
    sought: tuple[Parameter, ...]
    values: tuple[float, ...]
    deviations: tuple[float, ...] | None
    typical: tuple[float, ...] | None
    misfit_before: float
    misfit: float
    trail: tuple[tuple[tuple[float, ...], float], ...]
    stopped_because: str
    misfit_of_noise: float | None
    correlated_with: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    nominal: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    applied: Mapping[str, float] | None = None
    verdict: GoodnessOfFit | None = None
    covariance: Array | None = None
    field_stop_mm: float | None = None
    field_stop_at_mm: tuple[float, float] = (0.0, 0.0)
    field_stop_from: StopOrigin = "patch"
    source_deviations: Mapping[str, float] = field(default_factory=dict)
    object_uncertainty: ObjectUncertainty | None = None
    evidence_key: str = ""
    judged: JudgedObject | None = None

    @property
    def parameters(self) -> tuple[str, ...]:
        """Names of the parameters that were sought."""
        return tuple(parameter.name for parameter in self.sought)

    @property
    def bench(self) -> CalibratedBench:
        """The bench for :func:`wavesim.reconstruct_frames`."""
        has_converged = self.deviations is not None and self.stopped_because == CONVERGED
        return CalibratedBench(
            self.state,
            frozenset(self.parameters if has_converged else ()),
            self.evidence_key,
            None if self.object_uncertainty is None else self.object_uncertainty.summary,
            self._judged_with,
        )

    def _judged_with(self, key: str) -> JudgedObject | None:
        return self.judged if self.judged is not None and self.judged.key == key else None

    @property
    def poorly_determined(self) -> tuple[str, ...]:
        """Parameters that the frames hardly determine."""
        if self.deviations is None or self.typical is None:
            return ()
        rows = zip(self.parameters, self.deviations, self.typical, strict=True)
        # Standard deviation over the expected one above which the frames hardly determine a parameter.
        largest_ratio = 0.5
        return tuple(name for name, deviation, typical in rows if deviation > largest_ratio * typical)

    @property
    def field_stop(self) -> FieldStop:
        """Diameter and position of the field stop."""
        assert self.field_stop_mm is not None
        return FieldStop(self.field_stop_mm, self.field_stop_at_mm)

    @property
    def stop_warning(self) -> str:
        """Warning that the position of the field stop is not determined; empty where it is.

        An error of light or lens displaces a field stop together with the object, in a way that frames hardly
        distinguish from other positions. Residuals do not show this.
        """
        if self.field_stop_from != "frames" or self.field_stop_mm is None:
            return ""
        if self.deviations is None and any(isinstance(p, StopShift) for p in self.sought):
            return (
                "how well the frames determine the common position of field stop and object is not known, "
                "since standard deviations were not requested; residuals do not show a displacement"
            )
        deviations_um = [
            1e3 * deviation
            for parameter, deviation in zip(self.sought, self.deviations or (), strict=False)
            if isinstance(parameter, StopShift)
        ]
        # Standard deviation in um above which pictures of the object are displaced visibly.
        largest_um = 0.5
        if not deviations_um:
            return self._warning_of_nominal_stop
        across, down = deviations_um
        if max(across, down) <= largest_um:
            return ""
        return (
            "the frames determine the common position of field stop and object only to "
            f"{across:.2g}, {down:.2g} µm (standard deviations); residuals do not show a displacement"
        )

    @property
    def _warning_of_nominal_stop(self) -> str:
        """Warning that a field stop was found on a bench from which the calibrated one differs."""
        applied = self.applied or dict(zip(self.parameters, self.values, strict=True))
        changed = [p.name for p in self.sought if applied[p.name] and p.displaces]
        if not changed:
            return ""
        most_named = 4
        names = ", ".join(changed[:most_named]) + ", ..." * (len(changed) > most_named)
        return (
            "position and diameter of the field stop were found on the nominal bench, from which the "
            f"calibrated one differs ({names}): stop and object may be displaced together, and residuals do "
            "not show it"
        )

    @property
    def over_noise(self) -> float | None:
        """Residuals over the expected ones, from the verdict; None without a verdict."""
        return None if self.verdict is None else self.verdict.over_noise

    @property
    def explained(self) -> bool | None:
        """True if the frames are explained, from the verdict; None without a verdict."""
        return None if self.verdict is None else self.verdict.explained

    def as_dict(self) -> dict[str, Any]:
        """Return all results as plain values for JSON; :func:`read_calibration` reads them."""
        deviations = self.deviations or (None,) * len(self.parameters)
        is_unknown = self.deviations is None and self.typical is not None  # they were not requested
        stop_parameters = ("field_stop_x_mm", "field_stop_y_mm", "field_stop_mm")
        return {
            STATE: state_table(self.state),
            "values": dict(zip(self.parameters, self.values, strict=True)),
            "applied": dict(self.applied or zip(self.parameters, self.values, strict=True)),
            "deviations": dict(zip(self.parameters, deviations, strict=True)),
            "expected": dict(zip(self.parameters, self.typical or deviations, strict=True)),
            "kept_at_nominal": list(self.nominal),
            "undetermined": [*self.undetermined, *stop_parameters * bool(self.stop_warning)],
            "not_told": None if is_unknown else list(self.poorly_determined),
            "not_told_from": None
            if is_unknown
            else {name: list(others) for name, others in self.correlated_with.items()},
            "parameters": list(self.parameters),
            "sought": sorted(self.bench.sought),
            "misfit_before": self.misfit_before,
            "misfit": self.misfit,
            "misfit_of_noise": self.misfit_of_noise,
            "mountings_tried": len(self.trail),
            "stopped_because": self.stopped_because,
            "over_noise": self.over_noise,
            "explained": self.explained,
            "verdict": None if self.verdict is None else self.verdict.as_dict(),
            "field_stop_mm": self.field_stop_mm,
            "field_stop_at_mm": list(self.field_stop_at_mm),
            "field_stop_from": self.field_stop_from,
            "field_stop_doubt": self.stop_warning,
            "source_deviations": dict(self.source_deviations),
            "evidence_key": self.evidence_key,
            "object_uncertainty": None
            if self.object_uncertainty is None
            else self.object_uncertainty.summary.as_dict(),
        }

    def write(self, folder: str | Path, more: Mapping[str, Any] | None = None) -> dict[str, Any]:
        """Write the bench, its figure, and the object of its verdict.

        A reconstruction of the same frames uses both (:func:`read_bench`).
        """
        summary = super().write(folder, more)
        path = Path(folder) / JUDGED_OBJECT
        with suppress(InputError, OSError):  # it only saves a reconstruction its time
            if self.judged is None:  # one of an earlier run may lie there
                path.unlink(missing_ok=True)
            else:
                self.judged.write(path)
        return summary

    def plot(self) -> Figure:
        """Draw misfit and parameters of all tested benches."""
        return _calibration_figure(self)

    def _write_files(self, folder: Path, summary: Mapping[str, Any]) -> None:
        save(self.plot(), folder / "calibration.png")

    def table(self) -> list[tuple[str, str]]:
        noise = "" if self.misfit_of_noise is None else f", noise alone {self.misfit_of_noise:.4g}"
        rows = [(name, f"{value:.5g}") for name, value in zip(self.parameters, self.values, strict=True)]
        rows.append(("misfit", f"{self.misfit:.4g}, before {self.misfit_before:.4g}{noise}"))
        rows.append(("search", f"{len(self.trail)} mountings, {self.stopped_because}"))
        return rows


def correlated_parameters(names: Sequence[str], covariance: Array) -> dict[str, tuple[str, ...]]:
    """Return, for each parameter that has such, the others with strongly correlated errors."""
    deviations = np.sqrt(np.diag(covariance))
    # Correlation of the errors of two parameters above which the frames do not distinguish them.
    threshold = 0.5
    is_correlated = np.abs(covariance / np.outer(deviations, deviations)) >= threshold
    found = {
        name: tuple(o for o, is_so in zip(names, row, strict=True) if is_so and o != name)
        for name, row in zip(names, is_correlated, strict=True)
    }
    return {name: others for name, others in found.items() if others}


def field_stop_of(path: str | os.PathLike[str]) -> tuple[float, tuple[float, float], str] | None:
    """Return the field stop of a calibration, or None if it is the patch itself.

    Parameters
    ----------
    path
        File calibration.json.

    Returns
    -------
    diameter_mm : float
        Diameter of the field stop.
    centre_mm : (x, y)
        Its centre.
    warning : str
        Warning that the frames do not determine the field stop; empty where they do.

    Raises
    ------
    InputError
        If the file cannot be read, or its field stop is invalid.
    """
    table = read_json(path)
    if table.get("field_stop_from", "patch") == "patch":
        return None
    values = [table.get("field_stop_mm"), *(table.get("field_stop_at_mm") or [])]
    numbers = [v for v in values if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(values) != 3 or len(numbers) != 3 or not all(map(math.isfinite, numbers)) or numbers[0] <= 0.0:
        raise InputError(
            f"{path}: field_stop_mm, field_stop_at_mm = {values!r}: must be a diameter above 0 and a pair of "
            "finite numbers"
        )
    warning = str(table.get("field_stop_doubt") or "")
    return float(numbers[0]), (float(numbers[1]), float(numbers[2])), warning


class _BenchUncertainty(FrozenModel):
    """What the uncertainty of a bench leaves of the object, in calibration files."""

    correlation: Finite
    correlation_without_low_orders: Finite
    phase_waves: dict[str, Finite]
    amplitude: dict[str, Finite] = Field(default_factory=dict)
    position_um: dict[str, Finite] = Field(default_factory=dict)


class _SoughtParameters(FrozenModel):
    """Parameters that a calibration has sought until it converged, and its evidence, in calibration files."""

    sought: tuple[str, ...] = ()
    evidence_key: str = ""


def bench_uncertainty_of(path: str | os.PathLike[str]) -> BenchUncertainty | None:
    """Return what the uncertainty of a calibrated bench leaves of its object; None if a file does not say.

    Parameters
    ----------
    path
        File calibration.json.

    Raises
    ------
    InputError
        If the file cannot be read, or the values are invalid.
    """
    table = read_json(path).get("object_uncertainty")
    if table is None:
        return None
    return BenchUncertainty(**validate(_BenchUncertainty, table, Path(path)).model_dump())


def read_bench(path: str | os.PathLike[str], lens: Lens) -> CalibratedBench:
    """Return the bench that `wavesim calibrate` has found, with the object that it has judged.

    Parameters
    ----------
    path, lens
        See :func:`read_calibration`.

    Returns
    -------
    CalibratedBench
        The bench, as :func:`wavesim.reconstruct_frames` takes it.

    Raises
    ------
    InputError
        If the file cannot be read, contains no state, or belongs to another lens.
    """
    state, table = read_calibration(path, lens), read_json(path)
    stated = {name: table[name] for name in _SoughtParameters.model_fields if name in table}
    parameters = validate(_SoughtParameters, stated, Path(path))
    return CalibratedBench(
        state,
        frozenset(parameters.sought),
        parameters.evidence_key,
        bench_uncertainty_of(path),
        partial(read_judged_object, Path(path).with_name(JUDGED_OBJECT)),
    )


class _Mounting(FrozenModel):
    """Mounting of the lens in files of earlier versions, which have no state."""

    decenter_x_mm: Finite = 0.0
    decenter_y_mm: Finite = 0.0
    tilt_x_deg: Finite = 0.0
    tilt_y_deg: Finite = 0.0
    pivot_z_mm: Finite = 0.0
    working_distance_mm: Finite = 0.0
    plane_distances_mm: tuple[Finite, ...] = ()


def read_calibration(path: str | os.PathLike[str], lens: Lens) -> SystemState:
    """Return the state of the system that `wavesim calibrate` has found.

    Parameters
    ----------
    path
        File calibration.json of this version or an earlier one, or any file with a state
        (:func:`wavesim.write_state`).
    lens
        The design that was calibrated.

    Raises
    ------
    InputError
        If the file cannot be read, contains no state, or belongs to another lens.
    """
    table = read_json(path)
    if STATE in table or not isinstance(table.get("mounting"), dict):
        return state_of_file(table, path, lens)
    mounting = validate(_Mounting, table["mounting"], Path(path)).model_dump()
    planes, farther = mounting.pop("plane_distances_mm"), mounting.pop("working_distance_mm")
    state = SystemState(
        Pose(**mounting), object_shift_mm=(0.0, 0.0, 0.0 - farther), plane_distance_errors_mm=planes
    )
    values = table.get("applied", table.get("values"))
    return state if values is None else Unknowns(state, _numbers(values, path, lens)).state


def _numbers(values: Any, path: str | os.PathLike[str], lens: Lens) -> dict[Parameter, float]:
    """Return the values of parameters that a lens can have; distances of planes are in the mounting."""
    if not isinstance(values, dict):
        raise InputError(f"{path}: values: must be a table of numbers")
    allowed, ignored = parameters_by_name(lens), "plane_distance_1_mm"
    for name, value in values.items():
        if name not in allowed and name != ignored:
            raise InputError(
                f"{path}: values: {name!r}: this lens has no such parameter{did_you_mean(name, allowed)}; "
                "give the design that was calibrated"
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{path}: values: {name} = {value!r}: must be a finite number")
    return {allowed[name]: float(value) for name, value in values.items() if name != ignored}


@in_style
def _calibration_figure(found: Calibrated) -> Figure:
    """Draw misfit and parameters of all tested benches."""
    if found.typical is not None:
        figure = styled_figure(8.0, 2.8 + 0.26 * len(found.parameters))
        above, below = figure.subplots(2, height_ratios=[1.0, 0.12 * len(found.parameters) + 0.2])
        _draw_misfits(above, found)
        _draw_values(below, found)
        return figure
    rows = 1 + (len(found.parameters) + 1) // 2
    figure = styled_figure(8.0, 2.0 * rows)
    cells = figure.add_gridspec(rows, 2)
    above = figure.add_subplot(cells[0, :])
    _draw_misfits(above, found)
    steps = np.arange(1, len(found.trail) + 1)
    for k, name in enumerate(found.parameters):
        axes = figure.add_subplot(cells[1 + k // 2, k % 2], sharex=above)
        label, unit, factor = _label_and_unit(name)
        axes.plot(steps, [factor * values[k] for values, _ in found.trail], ".-", color=BLUE, lw=0.8)
        value = factor * found.values[k]
        axes.axhline(value, color=ORANGE, lw=0.8)
        axes.set_ylabel(name_with_unit(label, unit))
        axes.set_title(number_with_unit(f"estimate: {value:.3f}", unit), fontsize=9, color=ORANGE)
        axes.grid(True)
        axes.set_xlabel("tested bench" if k >= len(found.parameters) - 2 else "")
    return figure


def _draw_misfits(axes: Axes, found: Calibrated) -> None:
    noise = found.misfit_of_noise
    misfits = np.array([misfit for _, misfit in found.trail])
    axes.plot(np.arange(1, len(misfits) + 1), misfits, ".-", color=BLUE, lw=0.8)
    axes.set_yscale("log" if misfits.max() > 5.0 * misfits.min() else "linear")
    axes.set_ylabel("misfit of amplitudes")
    axes.set_xlabel("tested bench")
    axes.grid(True)
    if noise is not None:
        axes.axhline(noise, color=GREY, lw=0.8, ls="--")
        axes.annotate(
            "noise alone", (1.0, noise), xycoords=("axes fraction", "data"), xytext=(-4, 3),
            textcoords="offset points", ha="right", color=GREY, fontsize=8,
        )  # fmt: skip


def _draw_values(axes: Axes, found: Calibrated) -> None:
    """Draw each parameter over its typical size, with its standard deviation; grey if undetermined."""
    assert found.typical is not None
    rows = np.arange(len(found.parameters))[::-1]
    typical, deviations = np.array(found.typical), found.deviations or (None,) * len(rows)
    for row, name, value, deviation, usual in zip(
        rows, found.parameters, found.values, deviations, typical, strict=True
    ):
        color = GREY if name in found.poorly_determined else ORANGE
        bar = None if deviation is None else deviation / usual
        axes.errorbar(value / usual, row, xerr=bar, fmt="o", ms=3.5, lw=1.0, capsize=2, color=color)
        _, unit, factor = _label_and_unit(name)
        uncertainty = "" if deviation is None else f" ± {factor * deviation:.2g}"
        text = number_with_unit(f"{factor * value:.3g}{uncertainty}", unit)
        axes.annotate(
            text, (1.0, row), xycoords=("axes fraction", "data"), xytext=(4, 0), textcoords="offset points",
            va="center", fontsize=7.5, color=color, annotation_clip=False,
        )  # fmt: skip
    axes.set_yticks(rows, [_label_and_unit(name)[0] for name in found.parameters], fontsize=7.5)
    axes.set_ylim(-0.7, len(rows) - 0.3)
    axes.axvline(0.0, color="black", lw=0.6)
    bars = "; error bars: standard deviation; grey: not determined by the frames"
    axes.set_xlabel("value / typical size" + bars * (found.deviations is not None))
    axes.grid(True)


def _label_and_unit(name: str) -> tuple[str, str, float]:
    """Return a parameter's label, its unit, and the factor that converts its value to this unit."""
    words, unit = words_and_unit(name)
    return (words, "um", 1e3) if unit == "mm" else (words, unit, 1.0)
