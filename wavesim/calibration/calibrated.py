"""A bench that explains frames, and its file."""

from __future__ import annotations

import math
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from lensdesign.common.arrays import Array
from lensdesign.common.notebook import html_table
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from wavesim.calibration.parameters import Unknowns, all_names
from wavesim.metrics.goodness_of_fit import GoodnessOfFit
from wavesim.scene.bench import Bench
from wavesim.scene.placement import Placement
from wavesim.scene.settings import StopOrigin
from wavesim.sensor.mounting import mounting_of, mounting_table, read_table

NOT_TOLD = 0.5
"""Share of what is expected of a parameter: with a standard deviation beyond it, frames do not tell."""

ALIKE = 0.5
"""Correlation of two parameters' errors from which on frames do not tell one from the other."""


MOST_NAMED = 4
"""Parameters that a sentence names."""

STOP_PARAMETERS = ("field_stop_x_mm", "field_stop_y_mm", "field_stop_mm")


@dataclass(frozen=True, eq=False)
class Calibrated:
    """A bench that explains the frames, and how well it does.

    Attributes
    ----------
    bench : Bench
        With what was found.
    parameters : tuple of str
        Those that were sought.
    values : tuple of float
        Estimate of each.
    deviations : tuple of float or None
        Standard deviation of each estimate, with what is expected of it before; None where the object was
        known.
    covariance : ndarray of shape (n, n), or None
        Of the estimates, with the prior included; None where the object was known, and where the light comes
        from other frames than the rest.
    typical : tuple of float or None
        What is expected of each.
    misfit_before, misfit : float
        Relative L2 difference of amplitudes at the start and with the bench found, each with the best
        object.
    trail : tuple of (tuple of float, float)
        Values tried, and their misfits.
    at_reach : tuple of str
        Parameters that ended at the border of what was searched.
    stopped_because : str
        What ended the search.
    misfit_of_noise : float or None
        What the stated noise alone would leave (:func:`wavesim.sensor.measurement.noise_misfit`).
    traded : mapping
        Of parameters that frames do not tell from others: names of the others.
    nominal : tuple of str
        Parameters that the frames do not need: the bench has their nominal values, and not the estimates.
    undetermined : tuple of str
        Parameters that were not sought, for an object that is complex itself takes on what they do.
    applied : mapping or None
        Values of the bench, by name; None where they are the estimates.
    verdict : Verdict or None
        How well the object found on this bench explains the frames, as :func:`wavesim.reconstruct_frames`
        judges it; None where that was not asked for.
    field_stop_mm, field_stop_at_mm, field_stop_from : float or None, (x, y), str
        Diameter and middle of the field stop of which the light was taken, and where they come from: "patch"
        where nothing was stated, "stated", or "frames" where they were found.
    """

    bench: Bench
    parameters: tuple[str, ...]
    values: tuple[float, ...]
    deviations: tuple[float, ...] | None
    typical: tuple[float, ...] | None
    misfit_before: float
    misfit: float
    trail: tuple[tuple[tuple[float, ...], float], ...]
    at_reach: tuple[str, ...]
    stopped_because: str
    misfit_of_noise: float | None
    traded: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    nominal: tuple[str, ...] = ()
    undetermined: tuple[str, ...] = ()
    applied: Mapping[str, float] | None = None
    verdict: GoodnessOfFit | None = None
    covariance: Array | None = None
    field_stop_mm: float | None = None
    field_stop_at_mm: tuple[float, float] = (0.0, 0.0)
    field_stop_from: StopOrigin = "patch"

    @property
    def mounting(self) -> Placement:
        """The lens as mounted."""
        return self.bench.placement

    @property
    def not_told(self) -> tuple[str, ...]:
        """Parameters of which the frames say next to nothing."""
        if self.deviations is None or self.typical is None:
            return ()
        told = zip(self.parameters, self.deviations, self.typical, strict=True)
        return tuple(name for name, deviation, typical in told if deviation > NOT_TOLD * typical)

    @property
    def moved(self) -> tuple[str, ...]:
        """Parameters, except backgrounds, in which the bench differs from its nominal values."""
        applied = self.applied or dict(zip(self.parameters, self.values, strict=True))
        return tuple(name for name, value in applied.items() if value and not name.endswith("_background"))

    @property
    def stop_doubt(self) -> str:
        """Why position and diameter of the field stop are not determined; empty where they are.

        A stop that is found is found on the nominal bench. A light that is wrong displaces it, and the
        object with it, by what frames tell hardly from other light: residuals do not show that.
        """
        if self.field_stop_from != "frames" or not self.moved:
            return ""
        names = ", ".join(self.moved[:MOST_NAMED]) + ", ..." * (len(self.moved) > MOST_NAMED)
        return (
            "position and diameter of the field stop were found on the nominal bench, from which the "
            f"calibrated one differs ({names}): stop and object may be displaced together, and residuals do "
            "not show it"
        )

    @property
    def over_noise(self) -> float | None:
        """Residuals over the expected ones, as the verdict states it; None where none was made."""
        return None if self.verdict is None else self.verdict.over_noise

    @property
    def explained(self) -> bool | None:
        """Whether the frames are explained, as the verdict states it; None where none was made."""
        return None if self.verdict is None else self.verdict.explained

    def table(self) -> dict[str, Any]:
        """What :func:`read_calibration` reads, and all figures, ready for JSON."""
        deviations = self.deviations or (None,) * len(self.parameters)
        return {
            "mounting": mounting_table(self.mounting),
            "values": dict(zip(self.parameters, self.values, strict=True)),
            "applied": dict(self.applied or zip(self.parameters, self.values, strict=True)),
            "deviations": dict(zip(self.parameters, deviations, strict=True)),
            "expected": dict(zip(self.parameters, self.typical or deviations, strict=True)),
            "kept_at_nominal": list(self.nominal),
            "undetermined": [*self.undetermined, *STOP_PARAMETERS * bool(self.stop_doubt)],
            "not_told": list(self.not_told),
            "not_told_from": {name: list(others) for name, others in self.traded.items()},
            "parameters": list(self.parameters),
            "misfit_before": self.misfit_before,
            "misfit": self.misfit,
            "misfit_of_noise": self.misfit_of_noise,
            "mountings_tried": len(self.trail),
            "at_reach": list(self.at_reach),
            "stopped_because": self.stopped_because,
            "over_noise": self.over_noise,
            "explained": self.explained,
            "verdict": None if self.verdict is None else self.verdict.as_dict(),
            "field_stop_mm": self.field_stop_mm,
            "field_stop_at_mm": list(self.field_stop_at_mm),
            "field_stop_from": self.field_stop_from,
            "field_stop_doubt": self.stop_doubt,
        }

    def __repr__(self) -> str:
        return f"Calibrated({', '.join(f'{name} {value}' for name, value in self._rows())})"

    def _repr_html_(self) -> str:
        return html_table("Bench as it is", self._rows())

    def _rows(self) -> list[tuple[str, str]]:
        noise = "" if self.misfit_of_noise is None else f", noise alone {self.misfit_of_noise:.4g}"
        told = [(name, f"{value:.5g}") for name, value in zip(self.parameters, self.values, strict=True)]
        told.append(("misfit", f"{self.misfit:.4g}, before {self.misfit_before:.4g}{noise}"))
        told.append(("search", f"{len(self.trail)} mountings, {self.stopped_because}"))
        return told + [("at the border", ", ".join(self.at_reach))] * bool(self.at_reach)


def traded(names: Sequence[str], covariance: Array) -> dict[str, tuple[str, ...]]:
    """For each parameter that has such, those with which its error goes along or against it."""
    size = np.sqrt(np.diag(covariance))
    alike = np.abs(covariance / np.outer(size, size)) >= ALIKE
    found = {
        name: tuple(o for o, is_so in zip(names, row, strict=True) if is_so and o != name)
        for name, row in zip(names, alike, strict=True)
    }
    return {name: others for name, others in found.items() if others}


def field_stop_of(path: str | os.PathLike[str]) -> tuple[float, tuple[float, float]] | None:
    """Diameter and middle of the field stop of a calibration; None where it had none but the patch's sides.

    Parameters
    ----------
    path
        Its calibration.json.

    Raises
    ------
    InputError
        If the file cannot be read, or states a field stop that is none.
    """
    table = read_table(path)
    if table.get("field_stop_from", "patch") == "patch":
        return None
    values = [table.get("field_stop_mm"), *(table.get("field_stop_at_mm") or [])]
    numbers = [v for v in values if isinstance(v, int | float) and not isinstance(v, bool)]
    if len(values) != 3 or len(numbers) != 3 or not all(map(math.isfinite, numbers)) or numbers[0] <= 0.0:
        raise InputError(
            f"{path}: field_stop_mm, field_stop_at_mm = {values!r}: must be a diameter above 0 and a pair of "
            "finite numbers"
        )
    return float(numbers[0]), (float(numbers[1]), float(numbers[2]))


def stop_doubt_of(path: str | os.PathLike[str]) -> str:
    """Why the field stop of a calibration is not determined; empty where it is.

    Parameters
    ----------
    path
        Its calibration.json.

    Raises
    ------
    InputError
        If the file cannot be read.
    """
    return str(read_table(path).get("field_stop_doubt") or "")


def read_calibration(path: str | os.PathLike[str], lens: Lens) -> Bench:
    """The bench that `wavesim calibrate` has found.

    Parameters
    ----------
    path
        Its calibration.json; one that holds a mounting alone does too.
    lens
        The design that was calibrated.

    Raises
    ------
    InputError
        If the file cannot be read, holds no calibration, or one of another kind of lens.
    """
    table = read_table(path)
    mounting, values = mounting_of(table["mounting"], path), table.get("applied", table.get("values"))
    if values is None:
        return Bench(mounting)
    if not isinstance(values, dict):
        raise InputError(f"{path}: values: must be a table of numbers")
    allowed = all_names(lens)
    mounted = [name for name in values if name not in allowed and name.startswith("plane_distance_")]
    for name, value in values.items():
        if name not in allowed and name not in mounted:
            raise InputError(
                f"{path}: values: {name!r}: this lens has no such parameter{did_you_mean(name, allowed)}; "
                "give the design that was calibrated"
            )
        if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
            raise InputError(f"{path}: values: {name} = {value!r}: must be a finite number")
    kept = {name: float(value) for name, value in values.items() if name not in mounted}
    return Unknowns(lens, Bench(mounting), kept).bench
