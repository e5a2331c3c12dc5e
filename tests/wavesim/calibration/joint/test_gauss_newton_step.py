"""Normal equations of object and bench, against dense ones."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from wavesim.calibration.joint import gauss_newton_step
from wavesim.calibration.joint.gauss_newton_step import DAMPING, LEAST_INFORMATION, GaussNewtonStep

OBJECT, PIXELS, PARAMETERS = 6, 80, 4
TYPICAL = np.array([1.0, 0.5, 2.0, 1.0])
VALUES = np.array([0.1, 0.0, -0.3, 0.2])
VARIANCE = 0.02


class Dense:
    """A linear model that is a matrix."""

    def __init__(self, rng: np.random.Generator) -> None:
        self.matrix = rng.standard_normal((PIXELS, OBJECT)) / np.sqrt(PIXELS)
        self.residual = rng.standard_normal(PIXELS)
        self.misfit = float(np.linalg.norm(self.residual))
        self.model = SimpleNamespace(lit=np.ones(OBJECT, bool))
        self.applications = 0

    def without_scale(self, changes: NDArray[Any]) -> NDArray[Any]:
        return changes

    def jacobian_times_object(self, change: NDArray[Any]) -> NDArray[Any]:
        self.applications += 1
        return np.asarray(self.matrix @ change)

    def adjoint_to_object(self, left: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(self.matrix.T @ left)


def step_of(columns: NDArray[Any], linear: Dense, lit: bool = True, **given: Any) -> GaussNewtonStep:
    linear.model.lit[:] = lit
    inside = np.full(OBJECT, 0.5)  # an amplitude that no bound holds
    return GaussNewtonStep(linear, columns, VALUES, TYPICAL, VARIANCE, inside, "amplitude", **given)  # type: ignore[arg-type]


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(5)


def test_the_step_solves_the_dense_equations(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wavesim.calibration.joint.gauss_newton_step.TOLERANCE", 0.0)
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    joint = step_of(columns, linear)
    both = np.hstack([linear.matrix, columns.T])
    normal = both.T @ both
    prior_precision, damping = VARIANCE / TYPICAL**2, DAMPING * linear.misfit**2 / TYPICAL**2
    normal[OBJECT:, OBJECT:] += np.diag(prior_precision + damping)
    right = both.T @ linear.residual
    right[OBJECT:] -= prior_precision * VALUES
    exact = np.linalg.solve(normal, right)[OBJECT:]
    assert joint.solve(20) == pytest.approx(exact, rel=1e-5)


def test_what_an_object_undoes_is_solved_in_few_rounds(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The step is the same in the end: a parameter that an object undoes but for a little goes far."""
    monkeypatch.setattr("wavesim.calibration.joint.gauss_newton_step.TOLERANCE", 0.0)
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    change = rng.standard_normal(OBJECT)
    columns[0] = 10.0 * linear.matrix @ change + 0.3 * rng.standard_normal(PIXELS)
    plain, compensated = step_of(columns, linear), step_of(columns, linear, compensations={0: -10.0 * change})
    exact = plain.solve(30)
    assert compensated.solve(30) == pytest.approx(exact, rel=1e-5)
    off = [float(np.linalg.norm(one.solve(3) - exact)) for one in (plain, compensated)]
    assert off[1] < 0.2 * off[0]


@pytest.mark.parametrize("free", [(True, True, True, True), (True, False, True, False)])
def test_effects_without_the_object_give_the_dense_step(
    rng: np.random.Generator, free: tuple[bool, ...]
) -> None:
    """Also beside given steps of the others. The object, which is not at its optimum, moves to it."""
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    joint, chosen, steps = step_of(columns, linear), np.array(free), np.array([0.3, -0.1, 0.2, 0.4])
    basis, _ = np.linalg.qr(linear.matrix)
    left = columns - (columns @ basis) @ basis.T
    precision = VARIANCE / TYPICAL**2
    normal, right = left @ left.T + np.diag(precision), left @ linear.residual - precision * VALUES
    right = right - normal[:, ~chosen] @ steps[~chosen]
    exact = np.linalg.solve(normal[np.ix_(chosen, chosen)], right[chosen])
    found = joint.step_of_effects(joint.eliminated(20).columns, chosen, steps)
    assert found == pytest.approx(exact, rel=1e-6)


def eliminated(columns: NDArray[Any], linear: Dense) -> NDArray[Any]:
    """Return the exact curvature of the parameters with the object eliminated."""
    basis, _ = np.linalg.qr(linear.matrix)
    left = columns - (columns @ basis) @ basis.T
    return np.asarray(left @ left.T + np.diag(VARIANCE / TYPICAL**2))


def curvature(joint: GaussNewtonStep, iterations: int) -> NDArray[Any]:
    left = joint.eliminated(iterations).columns
    return np.asarray(left @ left.T + np.diag(VARIANCE / TYPICAL**2))


def test_the_object_is_eliminated(rng: np.random.Generator) -> None:
    """What the object can make is no information; more iterations never leave more."""
    linear = Dense(rng)
    columns = np.stack([linear.matrix @ rng.standard_normal(OBJECT) for _ in range(PARAMETERS)])
    columns += 0.5 * rng.standard_normal(columns.shape)
    joint = step_of(columns, linear)
    found = [curvature(joint, iterations) for iterations in range(4)]
    assert found[0] == pytest.approx(columns @ columns.T + np.diag(VARIANCE / TYPICAL**2))
    assert found[3] == pytest.approx(eliminated(columns, linear), rel=1e-6)
    for more, fewer in zip(found[1:], found[:-1], strict=True):
        assert np.linalg.eigvalsh(fewer - more).min() > -1e-9


@pytest.mark.parametrize("iterations", [0, 1, 2, 20])
def test_the_object_makes_what_is_eliminated(rng: np.random.Generator, iterations: int) -> None:
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    left = step_of(columns, linear).eliminated(iterations)
    assert columns + left.changes @ linear.matrix.T == pytest.approx(left.columns, abs=1e-6)


def deviation_error(seed: int) -> tuple[float, int]:
    """The largest relative error of a standard deviation, and how often operators were applied.

    The effects of the object's directions differ a hundred times.
    """
    rng = np.random.default_rng(seed)
    linear, size = Dense(rng), 30
    left, _ = np.linalg.qr(rng.standard_normal((PIXELS, size)))
    linear.matrix = left @ np.diag(np.geomspace(1.0, 0.01, size))
    linear.model.lit = np.ones(size, bool)
    columns = rng.standard_normal((PARAMETERS, size)) @ left.T
    columns += 0.05 * rng.standard_normal((PARAMETERS, PIXELS))
    exact = np.sqrt(np.diag(np.linalg.inv(eliminated(columns, linear))))
    inside = np.full(size, 0.5)
    joint = GaussNewtonStep(linear, columns, VALUES, TYPICAL, VARIANCE, inside, "amplitude")  # type: ignore[arg-type]
    linear.applications = 0
    found = np.sqrt(np.diag(np.linalg.inv(curvature(joint, 20))))
    return float(np.max(np.abs(found / exact - 1.0))), linear.applications


def test_elimination_converges_where_parts_of_the_object_hardly_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Combinations of parameters that have converged cost nothing more, and are as accurate as with all
    followed. Few stiff problems need more than 20 iterations, which depends on their random numbers.
    """
    errors, applications = np.array([deviation_error(seed) for seed in range(40)]).T
    monkeypatch.setattr(gauss_newton_step, "LOSS_ITERATIONS", 20)
    followed = np.array([deviation_error(seed)[0] for seed in range(40)])
    assert np.median(errors) < 0.01
    assert np.mean(errors < 0.03) > 0.6
    assert errors.mean() < followed.mean() + 0.01
    assert applications.mean() < 0.75 * 20 * PARAMETERS


def test_an_object_that_cannot_move_takes_nothing(rng: np.random.Generator) -> None:
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    joint = step_of(columns, linear, lit=False)
    assert joint.eliminated(2).columns == pytest.approx(joint.eliminated(0).columns)


def test_what_tells_nothing_beside_the_prior_is_not_followed(rng: np.random.Generator) -> None:
    linear = Dense(rng)
    asked: list[int] = []
    forward = linear.jacobian_times_object
    linear.jacobian_times_object = lambda change: (asked.append(1), forward(change))[1]  # type: ignore[method-assign]
    columns = rng.standard_normal((PARAMETERS, PIXELS))
    faint = np.sqrt(0.5 * LEAST_INFORMATION * VARIANCE / PIXELS)
    columns[1:] *= faint / TYPICAL[1:, None]
    step_of(columns, linear).eliminated(1)
    assert len(asked) == 1


def test_equations_of_some_parameters_are_those_without_the_others(rng: np.random.Generator) -> None:
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    chosen = np.arange(PARAMETERS) != 1
    inside = np.full(OBJECT, 0.5)
    alone = GaussNewtonStep(
        linear,  # type: ignore[arg-type]
        columns[chosen],
        VALUES[chosen],
        TYPICAL[chosen],
        VARIANCE,
        inside,
        "amplitude",
    )
    restricted = step_of(columns, linear).restricted(chosen)
    assert restricted.descent == pytest.approx(alone.descent)
    assert restricted.solve(20) == pytest.approx(alone.solve(20), rel=1e-6)


def test_after_a_step_of_one_parameter_the_others_find_the_optimum_beside_it(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As dense equations do, in which the parameter has its new value."""
    monkeypatch.setattr("wavesim.calibration.joint.gauss_newton_step.TOLERANCE", 0.0)
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    step, others = np.array([0.0, -0.7, 0.0, 0.0]), np.arange(PARAMETERS) != 1
    found = step_of(columns, linear).after(step).restricted(others).solve(20)
    linear.residual = linear.residual - step @ columns
    prior = VARIANCE / TYPICAL[others] ** 2
    both = np.hstack([linear.matrix, columns[others].T])
    normal = both.T @ both
    normal[OBJECT:, OBJECT:] += np.diag(prior + DAMPING * linear.misfit**2 / TYPICAL[others] ** 2)
    right = both.T @ linear.residual
    right[OBJECT:] -= prior * VALUES[others]
    assert found == pytest.approx(np.linalg.solve(normal, right)[OBJECT:], rel=1e-5)


def displaced_problem(rng: np.random.Generator) -> tuple[Dense, NDArray[Any], NDArray[Any]]:
    """A linear model, columns, and two displacements that undo a part of them."""
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    displacements = rng.standard_normal((2, OBJECT))
    columns[:2] += 3.0 * displacements @ linear.matrix.T
    return linear, columns, displacements


def test_displacements_are_eliminated_at_once_even_of_samples_at_a_bound(rng: np.random.Generator) -> None:
    """An object that cannot move otherwise takes what its displacements undo, and nothing else."""
    linear, columns, displacements = displaced_problem(rng)
    joint = step_of(columns, linear, lit=False, displacements=displacements)
    basis = np.linalg.qr(linear.matrix @ displacements.T)[0]
    assert joint.eliminated(0).columns == pytest.approx(columns - columns @ basis @ basis.T)
    effects = displacements @ linear.matrix.T
    assert columns + joint.following @ effects == pytest.approx(joint.columns)
    direction = np.array([1.0, -2.0, 0.5, 0.0])
    followed = joint.followed_by_object(direction, joint.eliminated(0).changes)
    assert followed == pytest.approx(direction @ joint.following @ displacements)


def test_the_step_of_bench_and_object_is_the_same_with_displacements(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("wavesim.calibration.joint.gauss_newton_step.TOLERANCE", 0.0)
    linear, columns, displacements = displaced_problem(rng)
    plain = step_of(columns, linear).solve(30)
    assert step_of(columns, linear, displacements=displacements).solve(30) == pytest.approx(plain, rel=1e-5)


def test_the_bench_follows_a_displacement_by_the_step_that_changes_the_frames_least(
    rng: np.random.Generator,
) -> None:
    linear, columns, displacements = displaced_problem(rng)
    follows = np.array([True, True, False, True])
    steps = step_of(columns, linear, displacements=displacements).steps_with_displacements(follows)
    chosen, prior = columns[follows], np.diag(VARIANCE / TYPICAL[follows] ** 2)
    effects = displacements @ linear.matrix.T
    exact = -np.linalg.solve(chosen @ chosen.T + prior, chosen @ effects.T).T
    assert steps[:, follows] == pytest.approx(exact)
    assert not steps[:, ~follows].any()


def test_an_even_object_has_no_displacement(rng: np.random.Generator) -> None:
    """Rounding of its derivatives is no change that the object can make."""
    linear, columns = Dense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    rounding = 1e-6 * rng.standard_normal((2, OBJECT))
    joint = step_of(columns, linear, displacements=rounding)
    assert joint.columns == pytest.approx(columns)
    assert not joint.following.any()
    assert not joint.steps_with_displacements(np.ones(PARAMETERS, bool)).any()


def test_displacements_of_unlike_sizes_are_all_eliminated(rng: np.random.Generator) -> None:
    """Laplacians are far larger than displacements, or far smaller."""
    linear, columns, displacements = displaced_problem(rng)
    sizes = np.array([[1.0], [3e3]])
    alike, unlike = (step_of(columns, linear, displacements=one * displacements) for one in (1.0, sizes))
    assert unlike.columns == pytest.approx(alike.columns)
    assert unlike.following * sizes.T == pytest.approx(alike.following)


class ComplexDense(Dense):
    """A linear model that is a matrix between complex samples and real amplitudes."""

    def __init__(self, rng: np.random.Generator) -> None:
        super().__init__(rng)
        self.matrix = self.matrix + 1j * rng.standard_normal((PIXELS, OBJECT)) / np.sqrt(PIXELS)

    def jacobian_times_object(self, change: NDArray[Any]) -> NDArray[Any]:
        return np.asarray((self.matrix @ change).real)

    def adjoint_to_object(self, left: NDArray[Any]) -> NDArray[Any]:
        return np.asarray(self.matrix.conj().T @ left)


def test_a_phase_object_follows_with_its_phase_alone(
    rng: np.random.Generator, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Steps and remaining effects of the bench are those of dense equations for the phases of the samples."""
    monkeypatch.setattr("wavesim.calibration.joint.gauss_newton_step.TOLERANCE", 0.0)
    linear, columns = ComplexDense(rng), rng.standard_normal((PARAMETERS, PIXELS))
    values = np.exp(1j * rng.uniform(-3.0, 3.0, OBJECT))
    joint = GaussNewtonStep(linear, columns, VALUES, TYPICAL, VARIANCE, values, "phase")  # type: ignore[arg-type]
    by_phase = (linear.matrix * (1j * values)).real
    both = np.hstack([by_phase, columns.T])
    normal, prior = both.T @ both, np.diag(joint.prior_precision)
    normal[OBJECT:, OBJECT:] += prior + np.diag(joint.damping)
    descent = both.T @ linear.residual
    descent[OBJECT:] -= joint.prior_precision * VALUES
    assert joint.solve(60) == pytest.approx(np.linalg.solve(normal, descent)[OBJECT:], rel=1e-4)
    basis = np.linalg.qr(by_phase)[0]
    expected = columns - columns @ basis @ basis.T
    left = joint.eliminated(20)
    assert left.columns == pytest.approx(expected, abs=1e-4)
    assert columns + (left.changes @ linear.matrix.T).real == pytest.approx(left.columns, abs=1e-6)
    assert (left.changes / (1j * values)).imag == pytest.approx(np.zeros((PARAMETERS, OBJECT)), abs=1e-9)
