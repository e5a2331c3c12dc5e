"""The engine that a scene needs, and no more."""

import warnings
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from benchmarks.chooser import object_field
from lensdesign import load_design, scaled
from lensdesign.errors import InputError, SamplingError
from lensdesign.lens.scaling import stopped_down
from wavesim.engines.choosing import affordable_engines, choose, engine_for, predict, predictions
from wavesim.engines.registry import ENGINES
from wavesim.fields.field import relative_error
from wavesim.fields.sampling_checks import SamplingWarning
from wavesim.metrics.comparison import compare, lens_case, reference_for, variants
from wavesim.plots.comparisons import comparison_figure
from wavesim.scene.engine import SAFETY, Cost, Engine, ErrorTerm
from wavesim.scene.patches import patch_scene
from wavesim.scene.scattered_light import Light
from wavesim.scene.scene import Scene
from wavesim.targets.patch import object_patch

PAPER = load_design("designs/paper_singlet.toml")
TWIN = scaled(PAPER, 1 / 16)
SCENE = patch_scene(TWIN, 0.02, plane_distance_mm=0.125, meridional=True)


def test_takes_the_cheapest_that_holds() -> None:
    for error in (1.9, 0.2, 0.03, 0.012):
        choice = choose(SCENE, error)
        holding = [p for p in choice.predictions if p.relative_error <= error and not p.refused]
        assert choice.chosen in holding
        assert choice.chosen.total_seconds(2) == min(p.total_seconds(2) for p in holding)
        assert choice.chosen.label in choice.reason


def test_less_error_is_never_cheaper() -> None:
    seconds = [choose(SCENE, error).chosen.total_seconds(2) for error in (0.5, 0.1, 0.012)]
    assert seconds[0] <= 3.0 * seconds[1] <= 9.0 * seconds[2]


def test_predictions_hold() -> None:
    """A few scenes and objects of the hundreds of benchmarks.chooser, which has the shares."""
    warnings.simplefilter("ignore", SamplingWarning)
    twin = scaled(PAPER, 1 / 32)
    bound, near = [], []
    for (aperture, share, patch, error), thing in zip(
        ((0.5, 0.0, 0.03, 0.2), (0.5, 0.9, 0.01, 0.1), (0.3, 0.5, 0.03, 0.1)),
        ("chart", "phase", "spots"),
        strict=True,
    ):
        lens = stopped_down(twin, aperture)
        height = share * lens.half_field_mm
        scene = patch_scene(lens, patch, height, plane_distance_mm=0.0625, meridional=True)
        truth = reference_for(scene)
        even, own = (object_field(name, scene, 1) for name in ("even", thing))
        for field, light in ((even, None), (own, Light(own))):
            exact = truth.forward(field)
            for prediction in predictions(scene, error, light):
                if prediction.engine not in ("eikonal", "slices", "thin-lens"):
                    continue
                engine = engine_for(scene, prediction.engine, **prediction.settings)
                found = relative_error(engine.forward(field).values, exact.values)
                bound.append(found <= prediction.relative_error)
                if light is None or prediction.engine == "eikonal":  # others look at no rim
                    near.append(prediction.relative_error < 5.0 * found)
    assert len(bound) > 20
    assert np.mean(bound) >= 0.95
    assert np.mean(near) >= 0.75


@pytest.mark.parametrize("thing", ["even", "spots"])
def test_slices_tell_of_light_that_the_rim_turns_aside(thing: str) -> None:
    """With many slices hardly anything else is left."""
    lens = stopped_down(TWIN, 0.35)
    scene = patch_scene(lens, 0.03, plane_distance_mm=0.125, meridional=True)
    field = object_field(thing, scene, 74)
    engine = engine_for(scene, "slices", slices=100, compensation="oblique")
    found = relative_error(engine.forward(field).values, reference_for(scene).forward(field).values)
    assert found <= engine.predicted_error(Light(field)) <= 5.0 * found


def test_prediction_is_the_sum_of_squares() -> None:
    engine = engine_for(SCENE, "slices", slices=100, compensation="oblique")
    parts = [part.relative_error for part in engine.error_terms()]
    assert predict(SCENE, "slices", slices=100, compensation="oblique").relative_error == pytest.approx(
        SAFETY * np.sqrt(np.sum(np.square(parts)))
    )
    assert predict(SCENE, "no-lens").relative_error == np.inf


def test_memory_and_time_allowed_are_kept() -> None:
    free = choose(SCENE, 0.012)
    with pytest.raises(SamplingError, match="GB \\(allowed"):
        choose(SCENE, 0.012, memory_gb=1e-5)
    with pytest.raises(SamplingError, match=r"takes .* s \(allowed"):
        choose(SCENE, 0.012, seconds=1e-9)
    assert free.chosen.peak_bytes > 1e4


def test_the_whole_plane_of_the_lens_is_not_for_waves() -> None:
    scene = patch_scene(PAPER, 0.02)
    choice = choose(scene, 0.2)
    assert choice.chosen.engine == "eikonal"
    with pytest.raises(SamplingError, match="wpm"):
        choose(scene, 1e-3)


def test_affordable_engines_need_not_meet_the_error() -> None:
    found = affordable_engines(SCENE, (1e-4,), seconds=10.0, runs=4)
    errors = [one.relative_error for one in found]
    assert errors == sorted(errors)
    assert 1e-4 < errors[0] < 0.03
    assert all(one.total_seconds(4) <= 10.0 and not one.refused for one in found)
    assert all(np.isfinite(errors))
    assert not affordable_engines(SCENE, (1e-4,), seconds=1e-9)
    assert not affordable_engines(SCENE, (1e-4,), memory_gb=1e-5)


def test_engine_auto() -> None:
    engine = engine_for(SCENE, "auto", error=0.2)
    chosen = choose(SCENE, error=0.2).chosen
    assert (engine.name, engine.key()) == (
        chosen.engine,
        engine_for(SCENE, chosen.engine, **chosen.settings).key(),
    )
    assert engine_for(SCENE).name == choose(SCENE).chosen.engine
    with pytest.raises(InputError, match="slices"):
        engine_for(SCENE, "auto", slices=3)


@pytest.mark.parametrize(
    "arguments",
    [{"error": 0.0}, {"error": 2.0}, {"error": np.nan}, {"memory_gb": 0.0}, {"seconds": np.nan}, {"runs": 0}],
)
def test_refused(arguments: dict) -> None:
    with pytest.raises(InputError):
        choose(SCENE, **arguments)


def test_patches_are_those_of_imaging() -> None:
    """A field stop is made a little larger than the field: 0.1875 mm here."""
    wider = patch_scene(TWIN, 0.19, plane_distance_mm=0.125, meridional=True)
    assert choose(wider, 0.5).chosen.engine
    for asked in (lambda: patch_scene(TWIN, 0.192), lambda: object_patch(TWIN, 0.192)):
        with pytest.raises(InputError, match=r"patch_mm = 0\.192: .*1\.02 .*field_diameter_mm = 0\.1875"):
            asked()


class Mirror(Engine):
    """All that an engine is: two ways, what they cost, what they leave out, and what is worth trying."""

    name = "mirror"
    gain = 0.9

    def __init__(self, scene: Scene, *, share: float = 1.0) -> None:
        super().__init__(scene)
        self.share = share

    @classmethod
    def candidates(cls, scene: Scene, error: float) -> Iterator[dict[str, Any]]:
        return ({"share": share} for share in (1.0, 0.5, 0.25, 0.24, 0.01))

    @classmethod
    def curves(cls, scene: Scene) -> dict[str, list[dict[str, Any]]]:
        return {"mirror, dim": [{"share": 0.5}, {"share": 0.25}]}

    def _forward(self, values: Any) -> Any:
        return self.share * np.resize(values, self.scene.exit_grid.shape)

    def _adjoint(self, values: Any) -> Any:
        return self.share * np.resize(values, self.scene.object_grid.shape)

    def cost(self) -> Cost:
        return Cost(1e-9, 0.0, 8)

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return (ErrorTerm("the lens", 0.1 * self.share),)

    def settings(self) -> dict[str, Any]:
        return {"share": self.share}


def test_a_new_engine_is_a_class_and_a_line(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ENGINES, "mirror", f"{__name__}:Mirror")
    assert isinstance(engine_for(SCENE, "mirror", share=0.3), Mirror)
    with pytest.raises(InputError, match=r"engine mirror: shares = 1: .*did you mean share"):
        engine_for(SCENE, "mirror", shares=1)
    weighed = [p.settings["share"] for p in choose(SCENE, 0.06).predictions if p.engine == "mirror"]
    assert weighed == [1.0, 0.5, 0.25]  # up to the first that holds
    weighed = [p.settings["share"] for p in choose(SCENE, 0.012).predictions if p.engine == "mirror"]
    assert weighed == [1.0, 0.5, 0.25, 0.24]  # up to the first that brings no gain
    found = engine_for(SCENE, error=0.06)
    assert (found.name, found.settings()) == ("mirror", {"share": 0.25})
    case = lens_case(TWIN, 0.01, plane_distance_mm=0.125)
    rows = compare({"twin": case}, lambda scene: [v for v in variants(scene) if v[1] == "mirror"])
    assert [(row.family, row.setting) for row in rows] == [
        ("mirror, dim", "share 0.5"),
        ("mirror, dim", "share 0.25"),
    ]
    assert all(row.predicted_error < row.relative_error for row in rows)
    assert comparison_figure(rows, "all engines").axes
