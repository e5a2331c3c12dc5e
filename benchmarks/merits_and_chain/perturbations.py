"""Perturbations of all kinds for a twin of the paper's lens: one at a time, and mixed."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from lensdesign.lens.lens import Lens
from tolerancing.merits.context import Context, Sampling
from tolerancing.perturbations.batch import PerturbationBatch
from tolerancing.perturbations.parameters import PerturbedParameter


class Kind(NamedTuple):
    """A parameter, what it belongs to, and a size that is felt: about a tenth of a wave on a 1/48 twin."""

    group: str
    target: str
    parameter: str
    size: float


KINDS = (
    Kind("mounting", "lens", "decenter_x_mm", 1.8e-3),
    Kind("mounting", "lens", "decenter_y_mm", 1.8e-3),
    Kind("mounting", "lens", "tilt_x_deg", 0.66),
    Kind("mounting", "lens", "tilt_y_deg", 0.66),
    Kind("mounting", "lens", "despace_mm", 1.4e-3),
    Kind("distances", "object", "working_distance_mm", 1.4e-3),
    Kind("distances", "sensor", "distance_mm", 6e-3),
    Kind("distances", "sensor", "plane_distance_2_mm", 3e-2),
    Kind("sensor", "sensor", "decenter_x_mm", 1.8e-3),
    Kind("sensor", "sensor", "tilt_x_deg", 0.45),
    Kind("radii", "surface 1", "radius_percent", 1.8),
    Kind("radii", "surface 2", "radius_percent", 0.48),
    Kind("radii", "surface 2", "conic", 0.03),
    Kind("thickness", "surface 1", "thickness_mm", 3.7e-3),
    Kind("glass", "surface 1", "index", 2e-3),
    Kind("wedge", "surface 2", "tilt_x_deg", 0.42),
    Kind("wedge", "surface 2", "decenter_y_mm", 2.3e-3),
    Kind("figure", "surface 1", "irregularity_rms_waves", 0.17),
    Kind("figure", "surface 2", "irregularity_rms_waves", 0.2),
    Kind("light", "light", "wavelength_um", 6.7e-3),
)

RELATIVE = ("deg", "percent", "conic", "index", "um")
"""Units of perturbations that act in proportion to the lens's size."""

SIZES = 0.4, 6.0
"""Least and largest, of a kind's size; between them logarithms are even."""

SINGLES, MIXED, MOST_MIXED = 2, 24, 10
"""Trials of each kind, mixtures, and kinds in one."""

MIXED_SHARE = 0.7
REFERENCE = 48.0


def trials(lens: Lens, scale: float, seed: int) -> tuple[Context, PerturbationBatch, list[str]]:
    """Perturbed twins, and the group that each belongs to.

    Parameters
    ----------
    lens
        The twin.
    scale
        How many times smaller than the paper's lens it is.
    seed
        Of sizes, mixtures and figures.
    """
    random = np.random.default_rng(seed)
    parameters = tuple(PerturbedParameter(target=k.target, parameter=k.parameter) for k in KINDS)
    unit = np.array([k.size * (scale / REFERENCE if _is_relative(k) else 1.0) for k in KINDS])
    rows, groups = [], []
    for number, kind in enumerate(KINDS):
        for _ in range(SINGLES):
            row = np.zeros(len(KINDS))
            row[number] = random.choice([-1.0, 1.0]) * _factor(random)
            rows.append(row)
            groups.append(kind.group)
    for _ in range(MIXED):
        row = np.zeros(len(KINDS))
        chosen = random.choice(len(KINDS), random.integers(3, MOST_MIXED + 1), replace=False)
        parts = random.standard_normal(len(chosen))
        row[chosen] = MIXED_SHARE * _factor(random) * parts / np.linalg.norm(parts)
        rows.append(row)
        groups.append("mixed")
    values = np.array(rows) * unit
    heights = [k.parameter.startswith("irregularity") for k in KINDS]
    values[:, heights] = np.abs(values[:, heights])
    sampling = Sampling(plane_distance_mm=lens.sensor.plane_distances_mm[0])
    context = Context(lens, sampling, noise_seed=seed)
    return context, context.perturbed(parameters, values, range(len(values))), groups


def _factor(random: np.random.Generator) -> float:
    return float(np.exp(random.uniform(*np.log(SIZES))))


def _is_relative(kind: Kind) -> bool:
    return kind.parameter.split("_")[-1] in RELATIVE
