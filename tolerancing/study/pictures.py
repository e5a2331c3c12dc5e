"""Pictures of line pairs as a perturbed lens and a nominal reconstruction leave them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from tolerancing.study.results import Picture

if TYPE_CHECKING:
    from tolerancing.merits.context import Context
    from tolerancing.merits.pupil import Axis
    from tolerancing.perturbations.batch import PerturbationBatch
    from tolerancing.study.series import LinePairSection

PICTURE_POINTS = 121


def line_pair_pictures(
    context: Context, section: LinePairSection, batch: PerturbationBatch
) -> tuple[Picture, ...]:
    """Of each line width of a sweep, refocused and not, along the worse axis."""
    from wavesim import line_pair_contrast, line_pair_image

    axes: tuple[Axis, ...] = ("x", "y") if section.orientation == "worse" else (section.orientation,)
    pictures = []
    for merit in section.line_pairs():
        (pupil,) = context.pupils(batch, section.field_mm, merit.wavelength_um, merit.refocus, True)
        contrast = {axis: line_pair_contrast(pupil, merit.line_width_um, axis) for axis in axes}
        axis = min(axes, key=contrast.__getitem__)
        coordinates, intensity = line_pair_image(pupil, merit.line_width_um, axis, points=PICTURE_POINTS)
        pictures.append(
            Picture(
                line_width_um=merit.line_width_um,
                orientation=axis,
                refocused=merit.refocus,
                half_width_um=float(coordinates[-1]),
                intensity=intensity.astype(np.float32),
            )
        )
    return tuple(pictures)
