"""Choosing a solution, and measuring an engine on it, with engines of known error, time and memory."""

import time
import warnings
from typing import Any

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.analytic.registry import ANALYTIC_CASES, analytic_case
from wavesim.engines.registry import ENGINES
from wavesim.fields.field import relative_error
from wavesim.metrics.accuracy import run_analytic_case
from wavesim.scene.engine import Cost, Engine, ErrorTerm
from wavesim.scene.scene import Scene

BALLAST_BYTES = 24_000_000


class Scaled(Engine):
    """The exact beam in free space times a factor; slow, large, and loud."""

    name = "scaled"

    def __init__(self, scene: Scene, factor: float = 1.0, pause_seconds: float = 0.0) -> None:
        super().__init__(scene)
        self.factor, self.pause_seconds = np.float64(factor), pause_seconds
        self.ready = False

    def _forward(self, values: Any) -> Any:
        if not self.ready:
            time.sleep(2.0 * self.pause_seconds)
            self.ready = True
        time.sleep(self.pause_seconds)
        ballast = np.ones(BALLAST_BYTES // 8)
        warnings.warn("too coarse", UserWarning, stacklevel=2)
        return analytic_case("beam").exact.values * self.factor * ballast[0]

    def _adjoint(self, values: Any) -> Any:
        return values

    def cost(self) -> Cost:
        return Cost(self.pause_seconds, 2.0 * self.pause_seconds, BALLAST_BYTES)

    def error_terms(self) -> tuple[ErrorTerm, ...]:
        return ()

    def settings(self) -> dict[str, Any]:
        return {"factor": self.factor, "pause_seconds": self.pause_seconds}


@pytest.fixture
def scaled(monkeypatch: pytest.MonkeyPatch) -> str:
    monkeypatch.setitem(ENGINES, "scaled", f"{__name__}:Scaled")
    return "scaled"


class Clock:
    """Time passes by sleeping alone."""

    def __init__(self) -> None:
        self.seconds = 0.0

    def perf_counter(self) -> float:
        return self.seconds

    def sleep(self, seconds: float) -> None:
        self.seconds += seconds


def test_error_is_not_fitted_and_all_that_was_measured_is_told(
    scaled: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    clock = Clock()
    monkeypatch.setattr(time, "perf_counter", clock.perf_counter)
    monkeypatch.setattr(time, "sleep", clock.sleep)
    result = run_analytic_case(scaled, "beam", factor=0.9, pause_seconds=0.03)
    assert result.relative_error == pytest.approx(0.1)
    assert result.seconds == pytest.approx(0.03)
    assert result.setup_seconds == pytest.approx(0.06)
    assert result.peak_mb == pytest.approx(1e-6 * BALLAST_BYTES, rel=0.1)
    assert result.predicted == Cost(0.03, 0.06, BALLAST_BYTES)
    assert result.settings == {"factor": 0.9, "pause_seconds": 0.03}
    assert type(result.settings["factor"]) is float
    assert result.warnings == ("too coarse",)
    assert (result.engine, result.solution, result.radius_mm) == ("scaled", "beam", None)


def test_a_phase_counts_as_an_error(scaled: str) -> None:
    assert run_analytic_case(scaled, "beam", factor=-1.0).relative_error == pytest.approx(2.0)


@pytest.mark.parametrize("name", ANALYTIC_CASES)
def test_every_solution_has_a_field_on_both_grids_of_its_scene(name: str) -> None:
    case = analytic_case(name)
    assert case.object_field.grid == case.scene.object_grid
    assert case.exact.grid == case.scene.exit_grid
    for field in (case.object_field, case.exact):
        assert np.all(np.isfinite(field.values))
        assert field.wavelength_um == case.scene.wavelength_um
        assert field.energy > 0.0
    assert case.exact.index == case.scene.system.index[0, -1]
    assert 0.0 < case.uncertainty < 2e-4


def test_cases_are_kept_and_cannot_be_spoiled() -> None:
    case = analytic_case("cylinder", radius_mm=0.05)
    assert analytic_case("cylinder", radius_mm=0.05) is case
    assert analytic_case("cylinder", radius_mm=0.06) is not case
    with pytest.raises(ValueError, match="read-only"):
        case.exact.values[0] = 0.0


def test_free_space_without_a_lens_is_exact() -> None:
    assert run_analytic_case("no-lens", "beam").relative_error < 1e-9


def test_radius_is_that_of_the_solution() -> None:
    result = run_analytic_case("no-lens", radius_mm=0.05)
    assert result.solution == "cylinder"
    assert result.radius_mm == 0.05
    assert result.relative_error > 0.5
    exact = analytic_case("cylinder", radius_mm=0.05).exact.values
    assert relative_error(0.0 * exact, exact) == 1.0


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (lambda: run_analytic_case("no-lense", "beam"), "engine = 'no-lense': .*did you mean no-lens"),
        (lambda: run_analytic_case("no-lens", "cylindre"), "solution = 'cylindre': .*did you mean cylinder"),
        (lambda: run_analytic_case("no-lens", "beam", 0.1), r"solution beam: radius_mm = 0.1"),
        (lambda: run_analytic_case("no-lens", "beam", slices=3), "engine no-lens: slices = 3"),
        (lambda: run_analytic_case("no-lens", radius_mm=-1.0), "radius_mm = -1.0"),
        (
            lambda: run_analytic_case("no-lens", "plane", solution_arguments={"incidence_deg": 89.0}),
            "incidence_deg = 89",
        ),
    ],
)
def test_unusable_names_and_values_are_refused(call: Any, message: str) -> None:
    with pytest.raises(InputError, match=message):
        call()
