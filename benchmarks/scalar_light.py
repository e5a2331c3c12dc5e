"""Predicted against measured error of scalar waves for unpolarized light, over random scenes.

Designs of the gallery at 1/4 to 1/16 of their size, with five coatings, on and off the axis, tilted and
decentered. Measured: flat eikonal tiles with scalar waves against the components of unpolarized light, on
samples that are spread over the footprint. The light is noise that fills the aperture evenly, or that of an
object.
"""

from __future__ import annotations

import argparse
import math
import warnings
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from lensdesign import Coating, CoatingLayer, InputError, Pose, load_design, scaled
from lensdesign.lens.coatings.coating import SurfaceCoating
from wavesim import Field, Grid, Scene, engine_for, patch_scene
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.rays.scalar_light import scalar_light_term
from wavesim.scene.engine import ErrorTerm, upper_bound
from wavesim.scene.settings import ChoiceSettings
from wavesim.targets.patch import lit_patch, make_target

GALLERY = (
    "paper_singlet",
    "feasible_singlet",
    "wide_field",
    "rectangular_sensor",
    "thinnest_singlet",
    "as_built_pair",
    "stock_pair",
    "moulded_pair",
    "phone_lens",
    "q_type_lens",
)
COATINGS = ("ideal", "bare", "mgf2", "broadband", "narrow")
OBJECTS = ("usaf", "phase", "tissue")
OBJECT_MM, OBJECT_PITCH_UM = 0.04, 0.24

DRAWS = 4
"""Noise objects of a scene. The error of a single one of 10 um scatters by several percent."""

SIDE = 160
"""Samples along a side of the exit grid, which need not resolve the field."""


def films(wavelength_um: float, *quarters: tuple[float, float]) -> Coating:
    """Layers of indices and quarter waves, from the air to the glass."""
    layers = tuple(CoatingLayer(index=index, quarter_waves=waves) for index, waves in quarters)
    return Coating(layers=layers, design_wavelength_um=wavelength_um)


def broadband(wavelength_um: float) -> Coating:
    """A quarter, a half and a quarter wave, which reflects little over the visible range."""
    return films(wavelength_um, (1.38, 1.0), (2.05, 2.0), (1.65, 1.0))


def narrow(wavelength_um: float) -> Coating:
    """Two reflectors around a half wave, which pass a narrow band that depends on the angle."""
    high, low = (2.3, 1.0), (1.46, 1.0)
    return films(wavelength_um, low, high, low, (2.3, 2.0), low, high)


@dataclass(frozen=True)
class Case:
    """A scene, with the names of its design and coating."""

    design: str
    coating: str
    scene: Scene


@dataclass(frozen=True)
class Compared:
    """Predicted term and measured error of a scene for one light."""

    case: Case
    light: str
    term: ErrorTerm
    measured: float

    @property
    def ratio(self) -> float:
        """Predicted term over measured error."""
        return self.term.relative_error / self.measured

    @property
    def bound_ratio(self) -> float:
        """Upper bound that users see over measured error."""
        return upper_bound([self.term]) / self.measured


def coating_of(name: str, wavelength_um: float) -> SurfaceCoating:
    """A coating by its name."""
    if name == "broadband":
        return broadband(wavelength_um)
    return narrow(wavelength_um) if name == "narrow" else name  # type: ignore[return-value]


def random_case(number: int, random: np.random.Generator) -> Case:
    """A random scene; designs and coatings take turns."""
    design = GALLERY[number % len(GALLERY)]
    coating = COATINGS[(number + number // len(GALLERY)) % len(COATINGS)]
    lens = scaled(load_design(DESIGNS / f"{design}.toml"), 2.0 ** -random.uniform(2.0, 4.0))
    field_mm, radius_mm = lens.object.field_diameter_mm, lens.stop_semi_diameter_mm
    patch_mm = random.uniform(0.01, 0.06)
    # Patches, and objects in their place, lie within the field, from its centre to its edge.
    room_mm = 0.5 * (field_mm - max(patch_mm, OBJECT_MM))
    height, angle = random.uniform(0.0, room_mm), random.uniform(0.0, 2.0 * math.pi)
    plane_mm = lens.sensor.plane_distances_mm[int(random.integers(2))]
    decenter_mm = 0.02 * radius_mm * random.uniform(-1.0, 1.0, 2)
    tilt_deg = random.uniform(-1.0, 1.0, 2)
    scene = patch_scene(lens, patch_mm, plane_distance_mm=plane_mm)
    start, end = scene.object_grid, scene.exit_grid
    scene = replace(
        scene,
        object_grid=replace(start, centre_mm=(height * math.cos(angle), height * math.sin(angle))),
        exit_grid=Grid((SIDE, SIDE), end.pitch_mm * end.shape[0] / SIDE, end.z_mm),
        pose=Pose(
            decenter_x_mm=float(decenter_mm[0]),
            decenter_y_mm=float(decenter_mm[1]),
            tilt_x_deg=float(tilt_deg[0]),
            tilt_y_deg=float(tilt_deg[1]),
        ),
        coating=coating_of(coating, scene.wavelength_um),
    )
    return Case(design, coating, scene)


def noise(scene: Scene, draws: int, random: np.random.Generator) -> list[Field]:
    """Light of all directions."""
    values = random.standard_normal((draws, 2, *scene.object_grid.shape))
    return [
        Field(scene.object_grid, real + 1j * imaginary, scene.wavelength_um) for real, imaginary in values
    ]


def with_object(scene: Scene, name: str) -> tuple[Scene, Field]:
    """The scene with the samples of an object, and the light behind it."""
    settings = ChoiceSettings(patch_mm=OBJECT_MM, object_pitch_um=OBJECT_PITCH_UM)
    patch, light = lit_patch(scene.lens, settings, scene.wavelength_um)
    target = make_target(patch, name, "bright", numerical_aperture=scene.lens.object.numerical_aperture)
    grid = replace(patch.grid, centre_mm=scene.object_grid.centre_mm)
    values = light.values * target.transmission.values
    return replace(scene, object_grid=grid), Field(grid, values, scene.wavelength_um)


def measured_error(scene: Scene, lights: list[Field]) -> float:
    """Error of scalar waves for unpolarized light, relative to the whole field.

    Both engines have the same tiles, at least two along a side, since matrices of a tile's centre count.
    """
    width_mm = engine_for(scene, "eikonal", hierarchical=False).settings()["tile_width_mm"]
    width_mm = min(width_mm, 0.51 * scene.object_grid.pitch_mm * max(scene.object_grid.shape))
    scalar_engine, engine = (
        engine_for(replace(scene, polarization=kind), "eikonal", hierarchical=False, tile_width_mm=width_mm)
        for kind in ("scalar", "unpolarized")
    )
    different = total = 0.0
    for light in lights:
        scalar = math.sqrt(0.5) * scalar_engine.forward(light).values
        for index, field in enumerate(engine.forward_components(light)):
            expected = scalar if index % 2 == 0 else 0.0
            different += float(np.sum(np.abs(field.values - expected) ** 2))
            total += float(np.sum(np.abs(field.values) ** 2))
    return math.sqrt(different / total)


def compare(case: Case, number: int, random: np.random.Generator) -> list[Compared]:
    """Predicted and measured errors of a scene: noise first, then one of the objects.

    Raises
    ------
    InputError
        If the rays of the scene are too rough for tiles.
    """
    term = scalar_light_term(case.scene)
    assert term is not None
    even = measured_error(case.scene, noise(case.scene, DRAWS, random))
    name = OBJECTS[number % len(OBJECTS)]
    scene, light = with_object(case.scene, name)
    own = measured_error(scene, [light])
    return [Compared(case, "even", term, even), Compared(case, name, term, own)]


def compare_all(scenes: int, seed: int) -> tuple[list[Compared], int]:
    """Compare a number of scenes; also return how many others no tile can propagate."""
    random, found, refused, number = np.random.default_rng(seed), list[Compared](), 0, 0
    while len(found) < 2 * scenes:
        case = random_case(number, random)
        try:
            found += compare(case, number, random)
        except InputError as problem:
            refused += 1
            print(f"refused: {case.design}, {case.coating}: {str(problem)[:120]}", flush=True)
        else:
            even, own = found[-2:]
            print(
                f"{case.design:20} {case.coating:10} predicted {even.term.relative_error:.2e}  measured "
                f"{even.measured:.2e} even, {own.measured:.2e} {own.light}",
                flush=True,
            )
        number += 1
    return found, refused


def rows_of(name: str, found: list[Compared]) -> list[Row]:
    """Summary of the comparisons of one light."""
    ratios, bounds = (np.array([getattr(one, key) for one in found]) for key in ("ratio", "bound_ratio"))
    wanted = name == "even"
    return [
        Row(f"{name}: scenes", len(found)),
        Row(
            f"{name}: term is an upper bound",
            float(np.mean(ratios >= 1.0)),
            at_least=0.95 if wanted else None,
        ),
        Row(
            f"{name}: term within a factor 2",
            float(np.mean((ratios >= 0.5) & (ratios <= 2.0))),
            at_least=0.95 if wanted else None,
        ),
        Row(f"{name}: term over measured, smallest", float(ratios.min())),
        Row(f"{name}: term over measured, median", float(np.median(ratios))),
        Row(f"{name}: term over measured, largest", float(ratios.max())),
        Row(f"{name}: bound of users is an upper bound", float(np.mean(bounds >= 1.0)), at_least=0.95),
        Row(f"{name}: bound of users over measured, median", float(np.median(bounds))),
    ]


def milliseconds(case: Case) -> float:
    """Time of the prediction."""
    return 1e3 * interleaved({"term": lambda: scalar_light_term(case.scene)}, rounds=5)["term"].median


def draw(found: list[Compared], output: Path) -> None:
    """Predicted terms over measured errors, with the light that fills the aperture apart."""
    from lensdesign.plots.style import SERIES, styled_figure
    from tolerancing.report.figures.style import chart_style, write_figure

    with chart_style():
        figure = styled_figure(6.4, 4.2)
        axis = figure.subplots()
        for coating, colour in zip(COATINGS, SERIES, strict=False):
            for is_even in (True, False):
                own = [c for c in found if c.case.coating == coating and (c.light == "even") is is_even]
                axis.scatter(
                    [one.measured for one in own],
                    [one.term.relative_error for one in own],
                    s=22 if is_even else 14,
                    marker="o" if is_even else "x",
                    color=colour,
                    label=coating if is_even else None,
                )
        ends = np.array([5e-5, 0.2])
        axis.plot(ends, ends, color="0.4", linewidth=1.0, label="equal")
        axis.plot(ends, 2.0 * ends, color="0.4", linewidth=1.0, linestyle=":", label="factor 2")
        axis.set(xscale="log", yscale="log", xlim=tuple(ends), ylim=(5e-4, 0.2))
        axis.set_xlabel("measured relative error (dots: even light, crosses: objects)")
        axis.set_ylabel("predicted term")
        figure.legend(loc="outside right upper")
    write_figure(figure, output)


def main() -> None:
    """Print the comparison, and draw it."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--scenes", type=int, default=50, help="random scenes (default 50)")
    parser.add_argument("--seed", type=int, default=1, help="seed of the scenes and of the noise")
    parser.add_argument("-o", "--output", type=Path, help="chart to draw")
    given = parser.parse_args()
    warnings.simplefilter("ignore", SamplingWarning)
    found, refused = compare_all(given.scenes, given.seed)
    even = [one for one in found if one.light == "even"]
    rows = rows_of("even", even)
    for name in OBJECTS[: given.scenes]:
        rows += rows_of(name, [one for one in found if one.light == name])
    rows.append(
        Row("prediction of one scene, median", float(np.median([milliseconds(c.case) for c in even])), "ms")
    )
    rows.append(Row("further scenes whose rays are too rough for tiles", refused))
    print_table("Error of scalar waves for unpolarized light: predicted term and measured error", rows)
    if given.output is not None:
        draw(found, given.output)


if __name__ == "__main__":
    main()
