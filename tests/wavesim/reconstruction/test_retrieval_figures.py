"""Pictures of reconstructions."""

from __future__ import annotations

import numpy as np
import pytest

from lensdesign.errors import InputError
from wavesim.fields.field import Field, Grid
from wavesim.reconstruction.phase_retrieval import Retrieved, stagnation
from wavesim.reconstruction.retrieval_figures import convergence_figure, starts_figure

GRID = Grid((24, 32), 1e-3, 0.0, (0.01, 0.0))


def run(gain: float) -> Retrieved:
    cc = tuple(1.0 - 0.5 * gain ** min(k, 30) for k in range(100))
    residuals = tuple(np.sqrt(1.0 - np.asarray(cc)))
    found = Field(GRID, np.ones(GRID.shape, complex), 0.532)
    return Retrieved(found, cc, (0.1, 0.1), None, stagnation(cc), residuals)


def objects() -> dict[str, Field]:
    rng = np.random.default_rng(1)
    return {
        name: Field(GRID, rng.standard_normal(GRID.shape) + 1j * rng.standard_normal(GRID.shape), 0.532)
        for name in ("forward model", "even", "random")
    }


def test_convergence_shows_what_is_lacking_to_1(tmp_path) -> None:
    runs = {"forward model": run(0.8), "even": run(0.9)}
    figure = convergence_figure(runs)
    lacking, left = figure.axes
    curves = {line.get_label(): line.get_ydata() for line in lacking.lines}
    for name, one in runs.items():
        np.testing.assert_allclose(curves[name], 1.0 - np.asarray(one.correlation))
    dots = [line for line in left.lines if line.get_marker() == "o"]
    assert [int(np.ravel(dot.get_xdata())[0]) for dot in dots] == [one.stagnated_at for one in runs.values()]
    assert lacking.get_yscale() == "log"
    figure.savefig(tmp_path / "convergence.png")


def test_starts_side_by_side_with_their_agreement(tmp_path) -> None:
    made = objects()
    figure = starts_figure(made, dict.fromkeys(made, 0.9999))
    pictures = [axes for axes in figure.axes if axes.images]
    assert len(pictures) == 6
    titles = [axes.get_title() for axes in pictures if axes.get_title()]
    assert all(name in title and "0.999900" in title for name, title in zip(made, titles, strict=True))
    assert "agreement of all starts 0." in figure.get_suptitle()
    amplitude = next(axes for axes in pictures if axes.get_title().startswith("even"))
    np.testing.assert_allclose(amplitude.images[0].get_array(), np.abs(made["even"].values))
    assert amplitude.images[0].get_extent() == pytest.approx([-6.0, 26.0, -12.0, 12.0])
    figure.savefig(tmp_path / "starts.png")


def test_refused() -> None:
    with pytest.raises(InputError, match="runs: "):
        convergence_figure({})
    with pytest.raises(InputError, match=r"objects: .*plane grid"):
        starts_figure({})
    other = Field(GRID.at(1.0), np.ones(GRID.shape, complex), 0.532)
    with pytest.raises(InputError, match=r"objects: .*plane grid"):
        starts_figure(objects() | {"other": other})
