"""Pictures of measured surfaces: sag-error maps in waves (Fig. 2g)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from lensdesign.analysis.form_error import fitted, pv_rms_waves, terms
from lensdesign.errors import InputError
from lensdesign.files.surface_figures import surface_figure
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from lensdesign.plots.charts import label_axes, title_figure
from lensdesign.plots.style import in_style, styled_figure

if TYPE_CHECKING:
    from matplotlib.figure import Figure


@in_style
def surface_figure_map(lens: Lens, surface: int) -> Figure:
    """Plot the sag-error map of a measured surface without piston and tilt, with PV and RMS (Fig. 2g).

    Parameters
    ----------
    lens
        The lens.
    surface
        Index of the surface, from 0.

    Raises
    ------
    InputError
        If the surface has no measured figure, or it cannot be read.
    """
    own = lens.surfaces[surface]
    figure, semi = surface_figure(own), own.semi_diameter_mm
    if figure is None or semi is None:
        raise InputError(f"surface {surface + 1} has no measured figure")
    axis = np.linspace(-1.0, 1.0, 401)
    x, y = np.meshgrid(axis, axis)
    inside = np.hypot(x, y) <= 1.0
    points = np.stack([x[inside], y[inside]], axis=-1)
    waves = 1e3 / TEST_WAVELENGTH_UM * figure.sag(*(semi * points.T))
    weights = np.full(len(waves), 1.0 / len(waves))
    values = np.full(x.shape, np.nan)
    values[inside] = waves - fitted(waves, points, weights, "tilt") @ terms(points, "tilt")
    pv, rms = pv_rms_waves(figure, semi, "tilt")
    picture = styled_figure(5.6, 4.6)
    axes = picture.add_subplot()
    image = axes.imshow(values, origin="lower", extent=(-semi, semi, -semi, semi), cmap="turbo")
    bar = picture.colorbar(image, ax=axes, shrink=0.9)
    bar.set_label(rf"sag error (waves, $\lambda$ = {1e3 * TEST_WAVELENGTH_UM:.1f} nm)")
    label_axes(axes, "x (mm)", "y (mm)")
    axes.set_title(rf"Surface {surface + 1}: PV {pv:.3f} $\lambda$, RMS {rms:.3f} $\lambda$")
    title_figure(picture, lens)
    return picture
