"""What a tolerance study says of the parameters that a calibration seeks: how far each is from the design."""

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
from wavesim.calibration.parameters import all_names
from wavesim.sensor.mounting import RIGID, WORKING_DISTANCE

SHAPES = 400
"""Figures that are drawn to see how much of an irregularity each of its terms is."""


class Priors(NamedTuple):
    """What a calibration expects of a lens that was made to a study's tolerances.

    Attributes
    ----------
    deviations : dict of str to float
        Root mean square of each parameter's deviation from the design, by the names of a calibration.
    not_sought : tuple of str
        Perturbations of the study, by their columns, that a calibration knows nothing of.
    """

    deviations: dict[str, float]
    not_sought: tuple[str, ...]


def calibration_priors(path: str | os.PathLike[str], lens: Lens) -> Priors:
    """What a study's perturbations are to a calibration.

    Perturbations that do the same add up in squares. A despace of the lens counts as working distance.
    Correlations between perturbations are left out.

    Parameters
    ----------
    path
        The study file.
    lens
        The design that is calibrated.

    Raises
    ------
    InputError
        If the file is no study, or one of another design.
    """
    loaded = load_study(path)
    mine, theirs = (one.model_dump_json(exclude={"title"}) for one in (lens, loaded.lens))
    if mine != theirs:
        raise InputError(
            f"{path}: is a study of another design, {loaded.study.design}: must be that of the lens that is "
            "calibrated"
        )
    names = all_names(lens)
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
    """By names as a calibration may have them."""
    shape, parameter = perturbation.distribution, perturbation.parameter
    size = math.hypot(shape.standard_deviation, shape.centre)
    if perturbation.surface is not None:
        head = f"surface_{perturbation.surface + 1}_"
        if perturbation.is_irregularity:
            terms = _figure_terms(perturbation.parameter)
            return {f"{head}figure_{j}_um": size * share for j, share in terms.items()}
        if RADII.get(parameter) == "radius_mm":
            change = radius_delta_mm(lens, perturbation.surface, parameter, np.array(size))
            return {f"{head}radius_mm": abs(float(change))}
        return {head + parameter: size}
    if perturbation.target == "lens" and parameter in RIGID:
        return {parameter: size}
    if (perturbation.target, parameter) in (("lens", "despace_mm"), ("object", WORKING_DISTANCE)):
        return {WORKING_DISTANCE: size}
    if perturbation.target == "sensor" and parameter.startswith("tilt"):
        return {f"sensor_{parameter}": size}
    if perturbation.plane is not None:
        return {parameter: size}
    return {}


def _figure_terms(parameter: str) -> dict[int, float]:
    """Root mean square in um of each Zernike term of an irregularity of one wave."""
    generator = np.random.default_rng(0)
    shapes = np.stack([draw_shape(generator) for _ in range(SHAPES)])
    if "_pv_" in parameter:
        shapes /= peak_to_valley(shapes)[:, None]
    sizes = TEST_WAVELENGTH_UM * np.sqrt(np.mean(shapes**2, axis=0))
    return dict(zip(INDICES, sizes.tolist(), strict=True))
