"""Eqs. 3 and 4, Figs. 4 and 11: how the lens is cut into slices, and how light is carried through them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lensdesign import Lens
from paper.drawing import label
from paper.element import Element, Made, Number, Work
from paper.style import BLUE, GLASS, GREEN, GREY, INK, ORANGE, RED, VIOLET, styled_figure
from wavesim import patch_scene
from wavesim.engines.slices.compensation import CentreRays, Oblique, Vertical, centre_rays, slice_of
from wavesim.engines.slices.planes import cutting_planes
from wavesim.engines.surfaces.grids import working_grid

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

PAPER_SLICES = 200
DRAWN_SLICES = 6
SHOWN_RADIUS_MM = 7.0
"""On the exit surface, of the slice that is looked at."""


@dataclass(frozen=True, eq=False)
class Sliced:
    """Cutting planes of the lens, as the engine of slices lays them for light of the axis.

    Attributes
    ----------
    lens
        The lens.
    slices
        Of each surface, on average.
    spacing
        ``equal``, or the ``paper``'s.
    """

    lens: Lens
    slices: int
    spacing: Any = "equal"

    @cached_property
    def _rays(self) -> tuple[CentreRays, ...]:
        return centre_rays(self._scene, (0.0, 0.0), fan=True)

    @cached_property
    def _scene(self) -> Any:
        return patch_scene(self.lens, 0.05, meridional=True)

    @cached_property
    def planes_mm(self) -> list[Array]:
        """Of the entrance and of the exit surface, z rising."""
        heights = working_grid(self._scene).heights_mm
        compensations = [Vertical(ray) for ray in self._rays]
        return cutting_planes(self._scene, compensations, heights, self.slices, self.spacing)

    def radius_mm(self, surface: int, z_mm: Any) -> Array:
        """Radial height at which a surface has a z."""
        own = self.lens.surfaces[surface]
        r = np.linspace(0.0, own.semi_diameter_mm or 0.0, 4001)
        z = self.lens.vertex_z_mm[surface] + own.sag_mm(r)
        order = np.argsort(z)
        return np.asarray(np.interp(z_mm, z[order], r[order]))

    def error_waves(self, surface: int, oblique: bool) -> tuple[Array, Array, Array]:
        """Heights of the rays from the axis, and the least and most by which their slice's phase errs."""
        ray, planes = self._rays[surface], self.planes_mm[surface]
        waves_per_mm = 1e3 / self.lens.wavelengths_um[0]
        thick = np.diff(planes)[slice_of(planes, ray.z_mm)]
        if oblique:
            ends = [np.zeros_like(thick), 0.5 * waves_per_mm * (0.5 * thick) ** 2 * sum(Oblique(ray).drift)]
        else:
            ends = [waves_per_mm * thick * part for part in Vertical(ray).obliquity]
        order = np.argsort(ray.y_mm)
        return ray.y_mm[order], np.minimum(*ends)[order], np.maximum(*ends)[order]


def figure_4(work: Work) -> Made:
    """The lens in slices, one slice from the front and from the side, and what its compensation errs by."""
    lens = work.lens
    cut = Sliced(lens, PAPER_SLICES)
    far = np.flatnonzero(cut.radius_mm(1, cut.planes_mm[1]) > SHOWN_RADIUS_MM)[-1]
    high, low = cut.planes_mm[1][far + 1], cut.planes_mm[1][far]
    inner, outer = (float(cut.radius_mm(1, z)) for z in (high, low))
    index = lens.indices(lens.wavelengths_um[0])[1]
    gained = (index - 1.0) * (high - low) / (1e-3 * lens.wavelengths_um[0])
    vertex = lens.exit_vertex_z_mm
    largest = {oblique: _largest(Sliced(lens, PAPER_SLICES), oblique) for oblique in (False, True)}
    numbers = (
        Number("slices of each surface", len(cut.planes_mm[1]) - 1, "", PAPER_SLICES),
        Number(
            "thickness of a slice of the entrance surface", 1e3 * float(np.diff(cut.planes_mm[0])[0]), "µm"
        ),
        Number("thickness of a slice of the exit surface", 1e3 * float(high - low), "µm"),
        Number("slice p of the picture, counted from the exit vertex", PAPER_SLICES - int(far), ""),
        Number("its plane z_p, from the exit vertex", float(high - vertex), "mm", digits=5),
        Number("its plane z_(p+1), from the exit vertex", float(low - vertex), "mm", digits=5),
        Number("inner radius R_p of its annulus", inner, "mm", digits=5),
        Number("outer radius R_(p+1) of its annulus", outer, "mm", digits=5),
        Number("compensation over it: glass in place of air", float(gained), "waves"),
        Number("largest error of vertical compensation in one slice", largest[False], "waves"),
        Number("largest error of oblique compensation in one slice", largest[True], "waves"),
    )
    picture = work.picture(
        _figure_4(lens, cut, far),
        f"The lens in {DRAWN_SLICES} slices a surface; the annulus of one of {PAPER_SLICES} slices and its "
        f"side view; the error of vertical compensation for rays from the axis. All from the engine's own "
        f"planes.",
    )
    difference = (
        "Eq. 4 assumes that light runs along the axis within a slice. Rays of NA 0.5 do not. With 200 "
        "slices of equal thickness its phase has an error of a wave and more in each slice near the "
        "edge. The error is a sawtooth, whose mean refocusing removes in part. With the local angle of "
        "the light (oblique compensation) the error vanishes. The paper spaces planes by the radius of "
        "curvature but does not state the rule. Thickness in proportion to the local radius (`--spacing "
        "paper`) makes slices of the entrance surface even thicker."
    )
    command = (
        "wavesim resolve-lines designs/paper_singlet.toml --engine slices --slices 200 "
        "--compensation vertical --linewidths-um 1.55,0.775,0.532"
    )
    return Made(numbers, (command,), difference, (picture,))


def _largest(cut: Sliced, oblique: bool) -> float:
    return max(float(np.max(cut.error_waves(surface, oblique)[2])) for surface in (0, 1))


def _figure_4(lens: Lens, cut: Sliced, which: int) -> Figure:
    figure = styled_figure(10.0, 7.6)
    grid = figure.add_gridspec(2, 2)
    _perspective(figure.add_subplot(grid[0, 0], projection="3d"), Sliced(lens, DRAWN_SLICES))
    _front(figure.add_subplot(grid[0, 1]), cut, which)
    _side(figure.add_subplot(grid[1, 0]), cut, which)
    _errors(figure.add_subplot(grid[1, 1]), lens)
    return figure


def _perspective(axes: Any, cut: Sliced) -> None:
    from matplotlib.colors import to_rgba

    turn = np.linspace(0.0, 2.0 * np.pi, 91)
    colours = [to_rgba(BLUE), to_rgba(GLASS), to_rgba(GREEN)]
    for surface in (0, 1):
        planes = cut.planes_mm[surface]
        z = np.concatenate([np.linspace(*ends, 8) for ends in pairwise(planes)])
        r = cut.radius_mm(surface, z)[:, None]
        which = np.repeat(np.arange(len(planes) - 1), 8)
        rows = np.array([colours[2 if surface and slice_ == 2 else slice_ % 2] for slice_ in which])
        axes.plot_surface(
            z[:, None] + 0.0 * turn,
            r * np.cos(turn),
            r * np.sin(turn),
            facecolors=np.repeat(rows[:, None], len(turn), axis=1),
            rcount=len(z),
            ccount=len(turn),
            lw=0.0,
            antialiased=False,
        )
        for z_mm in planes:
            y = np.array([-11.0, 11.0, 11.0, -11.0, -11.0])
            axes.plot(np.full(5, z_mm), y, np.roll(y, 1), color=GREY, lw=0.6)
    axes.set_box_aspect((12.0, 11.0, 11.0), zoom=1.25)
    axes.view_init(elev=16.0, azim=-40.0)
    axes.set_axis_off()
    axes.set_title(f"cutting planes, here {len(cut.planes_mm[1]) - 1} slices a surface")


def _front(axes: Axes, cut: Sliced, which: int) -> None:
    from matplotlib.patches import Annulus, Circle

    planes = cut.planes_mm[1]
    inner, outer = (float(cut.radius_mm(1, planes[number])) for number in (which + 1, which))
    semi = cut.lens.surfaces[1].semi_diameter_mm or 0.0
    axes.add_patch(Circle((0.0, 0.0), semi, facecolor=GLASS, edgecolor=INK, lw=0.8))
    for z in planes[::20]:
        axes.add_patch(Circle((0.0, 0.0), float(cut.radius_mm(1, z)), fill=False, edgecolor=GREY, lw=0.4))
    axes.add_patch(Annulus((0.0, 0.0), outer, outer - inner, color=GREEN))
    axes.annotate(
        f"p: {inner:.4f} to {outer:.4f} mm",
        (inner * math.cos(0.6), inner * math.sin(0.6)),
        (0.0, 0.0),
        ha="center",
        arrowprops={"arrowstyle": "->", "color": INK, "lw": 0.8},
    )
    axes.set(xlim=(-10.5, 10.5), ylim=(-10.5, 10.5), aspect="equal", xlabel="x (mm)", ylabel="y (mm)")
    axes.set_title("annuli p₁ = p₂ of slice p (every 20th border drawn)")


def _side(axes: Axes, cut: Sliced, which: int) -> None:
    """Heights over the slice and its neighbours; lengths along the axis in µm, across in mm."""
    before, low, high, after = cut.planes_mm[1][which - 1 : which + 3]
    at_um = np.linspace(1e3 * (before - low), 1e3 * (after - low), 200)
    r = cut.radius_mm(1, low + 1e-3 * at_um)
    inner, outer, width = float(cut.radius_mm(1, high)), float(cut.radius_mm(1, low)), 1e3 * (high - low)
    axes.fill_betweenx(r, at_um, at_um.min(), color=GLASS, lw=0.0)
    axes.plot(at_um, r, color=INK, lw=1.4)
    for z in (before, low, high, after):
        axes.axvline(1e3 * (z - low), color=GREY, lw=0.8, ls="--")
    for x, name, plane, side in (
        (width, " $p_1$, in air", "$z_p$", "left"),
        (0.0, "$p_2$, in glass ", "$z_{p+1}$", "right"),
    ):
        axes.plot([x, x], [inner, outer], color=GREEN, lw=4.0, solid_capstyle="butt")
        axes.text(x, outer - 0.004, name, va="center", ha=side, color=GREEN)
        label(axes, (x, float(r.max()) + 0.006), plane)
    line = 0.5 * (inner + outer)
    meets = float(np.interp(line, r[::-1], at_um[::-1]))
    for start, end, colour, name, side in (
        (width, meets, ORANGE, "  $k\\,[g - z_p]$", "left"),
        (meets, 0.0, RED, "$k\\,n_1\\,[z_{p+1} - g]$  ", "right"),
    ):
        axes.annotate("", (end, line), (start, line), arrowprops={"arrowstyle": "-|>", "color": colour})
        axes.text(width if side == "left" else 0.0, line, name, color=colour, ha=side, va="center")
    axes.set(xlabel="$z - z_{p+1}$ (µm)", ylabel="radial height (mm)")
    axes.set_ylim(float(r.min()), float(r.max()) + 0.012)
    axes.grid(visible=False)
    axes.set_title("slice p from the side; light goes back, to the left")


def _errors(axes: Axes, lens: Lens) -> None:
    """Between which values a slice's phase errs, against the height at which rays from the axis meet it."""
    for surface, colour, name in ((0, BLUE, "entrance"), (1, ORANGE, "exit")):
        height, least, most = Sliced(lens, PAPER_SLICES).error_waves(surface, oblique=False)
        axes.fill_between(
            height,
            least,
            most,
            color=colour,
            alpha=0.5,
            lw=0.8,
            label=f"{name}, {PAPER_SLICES} slices, vertical",
        )
    height, least, most = Sliced(lens, 30).error_waves(1, oblique=True)
    axes.fill_between(height, least, most, color=VIOLET, lw=1.2, label="exit, 30 slices, oblique")
    axes.set(
        xlabel="height on the surface (mm)", ylabel="error of the phase in a slice (waves)", xlim=(0.0, 9.6)
    )
    axes.legend(loc="upper left")
    axes.set_title("what compensation errs by, rays from the axis")


ELEMENTS = (
    Element(
        "figure-4",
        "Eqs. 3 and 4, Fig. 4: the lens in slices",
        "Both surfaces are cut into 200 slices by planes across the axis, closer where the radius of "
        "curvature is smaller. Light on the annulus p₁ in air gains k[g − z_p] to the surface and k "
        "n₁[z_(p+1) − g] behind it, to the annulus p₂ in glass.",
        figure_4,
        seconds={"quick": 3.0, "full": 3.0},
    ),
)
