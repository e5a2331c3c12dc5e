"""Priors of a calibration from a tolerance study: expected deviation of each parameter from the design."""

from __future__ import annotations

import math
import os
from typing import NamedTuple

import numpy as np

from lensdesign.analysis.form_error import TEST_WAVELENGTH_UM
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from tolerancing.perturbations.batch import radius_delta_mm
from tolerancing.perturbations.irregularity import INDICES, draw_shape, peak_to_valley
from tolerancing.perturbations.parameters import RADII, Perturbation
from tolerancing.study.files import load_study
from wavesim.calibration.parameters import WORKING_DISTANCE, parameters_by_name


class Priors(NamedTuple):
    """Expected deviations of a lens that was manufactured to a study's tolerances.

    Attributes
    ----------
    deviations : dict of str to float
        Root mean square deviation of each parameter from the design, by the names of a calibration.
    not_sought : tuple of str
        Columns of the study's perturbations that a calibration has no parameter for.
    """

    deviations: dict[str, float]
    not_sought: tuple[str, ...]


def calibration_priors(path: str | os.PathLike[str], lens: Lens) -> Priors:
    """Return the priors of a calibration from a study's perturbations.

    Perturbations of the same parameter add up in squares. A despace of the lens counts as working distance.
    Correlations between perturbations are neglected.

    Parameters
    ----------
    path
        The study file.
    lens
        The calibrated design.

    Raises
    ------
    InputError
        If the file is not a study, or is a study of another design.
    """
    loaded = load_study(path)
    calibrated, studied = (one.model_dump_json(exclude={"title"}) for one in (lens, loaded.lens))
    if calibrated != studied:
        raise InputError(
            f"{path}: is a study of another design, {loaded.study.design}: must be a study of the calibrated "
            "lens"
        )
    names = parameters_by_name(lens)
    squares: dict[str, float] = {}
    unknown = []
    for perturbation in loaded.study.perturbations:
        found = {n: d for n, d in _deviations(perturbation, lens).items() if n in names and d > 0.0}
        for name, deviation in found.items():
            squares[name] = squares.get(name, 0.0) + deviation**2
        if not found:
            unknown.append(perturbation.column)
    return Priors({name: math.sqrt(square) for name, square in squares.items()}, tuple(unknown))


def _deviations(perturbation: Perturbation, lens: Lens) -> dict[str, float]:
    """Return root mean square deviations by possible names of a calibration's parameters."""
    shape, parameter = perturbation.distribution, perturbation.parameter
    size = math.hypot(shape.standard_deviation, shape.centre)
    if perturbation.surface is not None:
        head = f"surface_{perturbation.surface + 1}_"
        if perturbation.is_irregularity:
            terms = _surface_figure_terms(perturbation.parameter)
            return {f"{head}figure_{j}_um": size * term for j, term in terms.items()}
        if RADII.get(parameter) == "radius_mm":
            change = radius_delta_mm(lens, perturbation.surface, parameter, np.array(size))
            return {f"{head}radius_mm": abs(float(change))}
        return {head + parameter: size}
    if (perturbation.target, parameter) in (("lens", "despace_mm"), ("object", WORKING_DISTANCE)):
        return {WORKING_DISTANCE: size}
    if perturbation.target == "lens":
        return {parameter: size}
    if perturbation.target == "sensor" and parameter.startswith("tilt"):
        return {f"sensor_{parameter}": size}
    if perturbation.plane is not None:
        return {parameter: size}
    return {}


def _surface_figure_terms(parameter: str) -> dict[int, float]:
    """Return the root mean square in um of each Zernike term for an irregularity of one wave."""
    generator = np.random.default_rng(0)
    shapes = np.stack([draw_shape(generator) for _ in range(400)])
    if "_pv_" in parameter:
        shapes /= peak_to_valley(shapes)[:, None]
    sizes = TEST_WAVELENGTH_UM * np.sqrt(np.mean(shapes**2, axis=0))
    return dict(zip(INDICES, sizes.tolist(), strict=True))
