"""Hypothesis strategies for lenses, poses and perturbations, and random rays to send through them."""

from __future__ import annotations

import numpy as np
from hypothesis import strategies as st
from numpy.typing import NDArray

from lensdesign import Lens, ObjectSpace, Pose, Sensor, Surface, SurfacePerturbation

OBJECT_DISTANCE_MM = 20.0


def numbers(low: float, high: float) -> st.SearchStrategy[float]:
    """Finite floats in a range."""
    return st.floats(low, high, allow_nan=False, allow_infinity=False)


def signed(low: float, high: float) -> st.SearchStrategy[float]:
    """Floats of either sign, with a modulus in a range."""
    return st.builds(lambda sign, size: sign * size, st.sampled_from([-1.0, 1.0]), numbers(low, high))


MATERIALS = st.none() | numbers(1.0, 2.0) | st.just("N-BK7")


@st.composite
def surfaces(draw: st.DrawFn, last: bool, stop: bool) -> Surface:
    """Planes, spheres, conics and even aspheres that end nowhere near their clear aperture."""
    kind = draw(st.sampled_from(["plane", "sphere", "conic", "even asphere"]))
    asphere = ()
    if kind == "even asphere":
        asphere = tuple(draw(st.lists(numbers(-2e-5, 2e-5), min_size=1, max_size=3)))
        asphere = tuple(a * 10.0 ** (-2 * i) for i, a in enumerate(asphere))
    return Surface(
        radius_mm=None if kind == "plane" else draw(signed(9.0, 300.0)),
        conic=draw(numbers(-3.0, 1.5)) if kind in ("conic", "even asphere") else 0.0,
        asphere=asphere,
        thickness_mm=None if last else draw(numbers(4.0, 12.0)),
        material=draw(MATERIALS),
        semi_diameter_mm=draw(numbers(1.0, 4.0)) if stop else draw(st.none() | numbers(1.0, 4.0)),
        stop=stop,
    )


@st.composite
def lenses(draw: st.DrawFn, most_surfaces: int = 4) -> Lens:
    """Lenses of one to a few surfaces with the stop anywhere."""
    count = draw(st.integers(1, most_surfaces))
    stop = draw(st.integers(0, count - 1))
    return Lens(
        title=draw(st.text(max_size=30)),
        wavelengths_um=tuple(draw(st.lists(numbers(0.4, 0.8), min_size=1, max_size=3))),
        object=ObjectSpace(
            field_diameter_mm=draw(numbers(0.1, 4.0)),
            numerical_aperture=draw(numbers(0.01, 0.3)),
            working_distance_mm=OBJECT_DISTANCE_MM,
        ),
        sensor=Sensor(
            pixel_pitch_um=draw(numbers(1.0, 6.0)),
            pixels=(draw(st.integers(1, 10000)), draw(st.integers(1, 10000))),
            plane_distances_mm=tuple(
                sorted(draw(st.sets(st.integers(1, 50).map(float), min_size=1, max_size=3)))
            ),
        ),
        surfaces=tuple(draw(surfaces(i == count - 1, i == stop)) for i in range(count)),
    )


@st.composite
def poses(draw: st.DrawFn, trials: int | None) -> Pose:
    """Poses of one lens, or of as many as there are trials."""
    seed = draw(st.integers(0, 2**32 - 1))
    rng = np.random.default_rng(seed)
    scale = np.array([0.3, 0.3, 0.3, 2.0, 2.0, 5.0])
    values = rng.uniform(-1.0, 1.0, (6, trials or 1)) * scale[:, None]
    values[:, draw(st.lists(st.integers(0, (trials or 1) - 1), max_size=2))] = 0.0
    return Pose(*(v if trials else float(v[0]) for v in values))


@st.composite
def surface_perturbations(draw: st.DrawFn, lens: Lens, trials: int | None) -> dict[int, SurfacePerturbation]:
    """Perturbations of some of the surfaces of a lens."""
    chosen = draw(st.sets(st.integers(0, len(lens.surfaces) - 1), max_size=2))
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    scale = np.array([0.2, 0.2, 0.2, 1.0, 1.0, 0.1, 0.05, 0.1, 0.01])
    result = {}
    for i in chosen:
        values = rng.uniform(-1.0, 1.0, (9, trials or 1)) * scale[:, None]
        values[5] *= lens.surfaces[i].radius_mm is not None
        result[i] = SurfacePerturbation(*(v if trials else float(v[0]) for v in values))
    return result


def random_rays(seed: int, count: int, wild: float = 0.2) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Rays from an object disc to the front of a lens; a share of them goes anywhere ahead."""
    rng = np.random.default_rng(seed)
    origins = np.column_stack([rng.uniform(-2.0, 2.0, (count, 2)), np.full(count, -OBJECT_DISTANCE_MM)])
    targets = np.column_stack([rng.uniform(-2.5, 2.5, (count, 2)), np.zeros(count)])
    directions = targets - origins
    anywhere = rng.random(count) < wild
    directions[anywhere] = rng.normal([0.0, 0.0, 1.0], 1.0, (np.count_nonzero(anywhere), 3))
    return origins, directions / np.linalg.norm(directions, axis=1, keepdims=True)
