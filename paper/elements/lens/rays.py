"""Figs. 2b to 2d: rays through the lens, where they land, and under which angles."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lensdesign import Lens
from lensdesign.analysis import rms_spot_diameter, spread_limit_sine
from lensdesign.analysis.arrival_angles import arrival_angles
from lensdesign.plots.layout import layout_figure
from lensdesign.plots.plots import spot_figure
from lensdesign.raytrace import compile_system, trace_compiled
from lensdesign.raytrace.paths import FIELD_FRACTIONS
from paper.element import Element, Made, Number, Work
from paper.style import BLUE, INK, ORANGE, RED, styled_figure

Array = NDArray[np.floating[Any]]

OBSERVED_MM = 3.0
"""From the exit vertex to the plane of Figs. 2c and 2d."""

POINTS_MM = (0.0, 3.0, 7.0, 9.0)
HALF_WIDTHS_MM = (0.5, 0.15, 0.08, 0.05)
"""Of the rings about the axis that stand for the points; the first is a disc."""

REACH_DEG, BINS = 5.2, 45
BLOCK = 500_000


def figure_2b(work: Work) -> Made:
    """The layout."""
    picture = work.picture(
        layout_figure(work.lens), "The lens of Table 1 to scale, with rays of three field heights."
    )
    difference = (
        "The figure agrees with the paper's. It also shows the stop, the planes of the sensor and a scale."
    )
    return Made((), ("lensdesign draw designs/paper_singlet.toml -o DIR",), difference, (picture,))


def figure_2c(work: Work) -> Made:
    """Spots 3 mm behind the exit vertex."""
    lens = work.lens
    heights = [share * lens.half_field_mm for share in FIELD_FRACTIONS]
    numbers = tuple(
        Number(
            f"RMS spot diameter, field height {height:.3g} mm",
            rms_spot_diameter(lens, field_mm=height, plane_distance_mm=OBSERVED_MM).rms_diameter_mm,
            "mm",
            14.0,
            0.5,
        )
        for height in heights
    )
    picture = work.picture(
        spot_figure(lens, (OBSERVED_MM,)),
        "Rays of three field heights on the plane 3 mm behind the exit vertex; the frame is the sensor.",
    )
    difference = (
        "The diameters agree. They are twice the root mean square distance of the rays from their "
        "centroid, with a uniformly filled stop."
    )
    return Made(numbers, ("lensdesign check designs/paper_singlet.toml",), difference, (picture,))


class Arrived(NamedTuple):
    """Rays near one point of the plane, all turned about the axis onto (0, y).

    Attributes
    ----------
    radiance : ndarray, shape (BINS, BINS)
        By direction, rows along y, over that of the source along its axis.
    rays : int
        How many.
    """

    radiance: Array
    rays: int

    @property
    def middle(self) -> float:
        """Mean radiance in the middle third of the directions."""
        third = slice(BINS // 3, BINS - BINS // 3)
        return float(self.radiance[third, third].mean())


def arrived(lens: Lens, rays: int, seed: int = 1) -> tuple[Arrived, ...]:
    """Rays of an even, isotropic disc source, by direction, at the points of the plane.

    The lens is one of revolution: all rays that meet the ring of a point's distance from the axis are turned
    onto it. Of the source's directions those are drawn that can reach the stop.
    """
    rng = np.random.default_rng(seed)
    system = compile_system(lens, lens.wavelengths_um[0])
    plane_z_mm = lens.exit_vertex_z_mm + OBSERVED_MM
    widest = lens.half_field_mm + lens.stop_semi_diameter_mm
    least_cosine = math.cos(math.atan2(widest, -lens.object_z_mm))
    counts = np.zeros((len(POINTS_MM), BINS, BINS))
    for done in range(0, rays, BLOCK):
        origins, directions = _emitted(rng, min(BLOCK, rays - done), lens, least_cosine)
        found = trace_compiled(system, origins, directions, plane_z_mm)
        position, direction = found.position[found.ok, :2], found.direction[found.ok]
        away = np.hypot(*position.T)
        for count, point, half in zip(counts, POINTS_MM, HALF_WIDTHS_MM, strict=True):
            near = np.abs(away - point) < half
            count += _by_direction(position[near], direction[near], away[near])
    # Rays over area and solid angle that the source sends along its axis.
    sent = rays / (math.pi * lens.half_field_mm**2 * 2.0 * math.pi * (1.0 - least_cosine))
    edges = np.tan(np.deg2rad(np.linspace(-REACH_DEG, REACH_DEG, BINS + 1)))
    solid = np.diff(edges)[:, None] * np.diff(edges)
    areas = [
        math.pi * ((point + half) ** 2 - max(point - half, 0.0) ** 2)
        for point, half in zip(POINTS_MM, HALF_WIDTHS_MM, strict=True)
    ]
    return tuple(
        Arrived(count / (solid * area * sent), int(count.sum()))
        for count, area in zip(counts, areas, strict=True)
    )


def _emitted(rng: np.random.Generator, count: int, lens: Lens, least_cosine: float) -> tuple[Array, Array]:
    """Points spread evenly over the object disc, directions evenly over the solid angle of a cone."""
    radius = lens.half_field_mm * np.sqrt(rng.random(count))
    around, azimuth = 2.0 * np.pi * rng.random((2, count))
    cosine = 1.0 - (1.0 - least_cosine) * rng.random(count)
    sine = np.sqrt(1.0 - cosine**2)
    height = np.full(count, lens.object_z_mm)
    origins = np.column_stack([radius * np.cos(around), radius * np.sin(around), height])
    return origins, np.column_stack([sine * np.cos(azimuth), sine * np.sin(azimuth), cosine])


def _by_direction(position: Array, direction: Array, away: Array) -> Array:
    """Counts over the angles to the yz and xz planes, of rays turned so that they land on the y axis."""
    away = np.maximum(away, 1e-12)
    sine, cosine = position.T / away
    x, y = direction[:, 0], direction[:, 1]
    angles = np.rad2deg(np.arctan2([x * cosine - y * sine, x * sine + y * cosine], direction[:, 2]))
    return np.histogram2d(angles[1], angles[0], BINS, [[-REACH_DEG, REACH_DEG]] * 2)[0]


def figure_2d(work: Work) -> Made:
    """Intensity against angle at four points."""
    lens = work.lens
    found = arrived(lens, work.settings["rays"])
    limit = math.degrees(math.asin(spread_limit_sine(lens.wavelengths_um[0], lens.sensor.pixel_pitch_um)))
    numbers = []
    for point, one in zip(POINTS_MM, found, strict=True):
        exact = arrival_angles(lens, (0.0, point), OBSERVED_MM)
        numbers += [
            Number(f"largest angle at (0, {point:g}) mm", exact.largest_deg, "°", 4.8, 0.05, "<="),
            Number(
                f"radiance at (0, {point:g}) mm, over the source's along its axis",
                one.middle,
                remark=f"{one.rays} rays",
            ),
        ]
    picture = work.picture(
        _intensities(found, limit),
        "Radiance by direction at four points 3 mm behind the exit vertex, from a uniform isotropic disc "
        "of 3 mm; below, cuts through the middle of each. Red: the limit of Eq. 2.",
    )
    difference = (
        "No light arrives above 4.8°, to the last digit. At 9 mm the largest angle is 4.80°, where the "
        "pixels' limit is 4.77°. The light fills a disc at points that light of the whole field reaches; "
        "elsewhere the edge of the stop cuts it off. Radiance is conserved: it is 1 / cos of the angle "
        "at which this light left the isotropic source. Because the lens is a body of revolution, all "
        "rays on a thin ring through a point are counted for that point. The paper does not state its "
        "program or its number of rays."
    )
    return Made(tuple(numbers), ("python -m paper --only figure-2d",), difference, (picture,))


def _intensities(found: tuple[Arrived, ...], limit_deg: float) -> Any:
    figure = styled_figure(10.0, 5.2)
    maps, cuts = figure.subplots(2, len(found), height_ratios=(1.6, 1.0), sharex=True)
    middles = np.linspace(-REACH_DEG, REACH_DEG, 2 * BINS + 1)[1::2]
    turn = np.linspace(0.0, 2.0 * np.pi, 181)
    for number, (point, one) in enumerate(zip(POINTS_MM, found, strict=True)):
        relative = one.radiance
        above, below = maps[number], cuts[number]
        extent = (-REACH_DEG, REACH_DEG, -REACH_DEG, REACH_DEG)
        drawn = above.imshow(relative, origin="lower", extent=extent, cmap="inferno", vmin=0.0, vmax=1.3)
        above.plot(limit_deg * np.cos(turn), limit_deg * np.sin(turn), color=RED, lw=1.2)
        above.grid(visible=False)
        above.set_title(f"(0, {point:g}) mm")
        middle = slice(BINS // 2 - 1, BINS // 2 + 2)
        below.plot(middles, relative[middle].mean(axis=0), color=BLUE, lw=1.4, label=r"along $\theta_x$")
        below.plot(middles, relative[:, middle].mean(axis=1), color=ORANGE, lw=1.4, label=r"along $\theta_y$")
        for side in (-limit_deg, limit_deg):
            below.axvline(side, color=RED, lw=1.2)
        below.set(xlabel="angle (°)", ylim=(0.0, 1.4))
        if number == 0:
            above.set_ylabel(r"$\theta_y$ (°)")
            below.set_ylabel("radiance, relative")
        else:
            above.set_yticklabels([])
            below.set_yticklabels([])
    figure.colorbar(drawn, ax=list(maps), fraction=0.02, pad=0.01, label="radiance, relative")
    handles, labels = cuts[0].get_legend_handles_labels()
    handles += [cuts[0].lines[-1]]
    figure.legend(handles, [*labels, f"limit {limit_deg:.2f}°"], loc="outside lower center", ncols=3)
    maps[0].tick_params(color=INK)
    return figure


ELEMENTS = (
    Element(
        "figure-2b",
        "Fig. 2b: rays through the lens",
        "Rays of the axial and of two other field points, traced to the observation plane.",
        figure_2b,
    ),
    Element(
        "figure-2c",
        "Fig. 2c: spots on the observation plane",
        "3 mm behind the exit surface the RMS spot diameter of three field points is around 14 mm: no image "
        "is formed.",
        figure_2c,
    ),
    Element(
        "figure-2d",
        "Fig. 2d: intensity against angle",
        "According to non-sequential ray tracing, light from a circular isotropic source of 3 mm reaches "
        "the points (0, 0), (0, 3), (0, 7) and (0, 9) of the observation plane at no more than 4.8°.",
        figure_2d,
        settings={"small": {"rays": 1_000_000}, "quick": {"rays": 40_000_000}, "full": {"rays": 400_000_000}},
        seconds={"quick": 10.0, "full": 100.0},
    ),
)
