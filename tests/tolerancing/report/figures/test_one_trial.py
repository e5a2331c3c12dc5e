"""The picture of one trial."""

from dataclasses import replace
from xml.etree import ElementTree

import pytest

from lensdesign.errors import InputError
from tolerancing.report.figures.one_trial import trial_figure, write_trial_figure
from tolerancing.statistics.trial import single_trial


def test_the_picture_shows_each_field_point(small_store, tmp_path):
    trial = single_trial(small_store, 2)
    figure = trial_figure(trial)
    titles = [axis.get_title() for axis in figure.axes if axis.get_title()]
    assert len(titles) == 3
    assert f"Strehl {trial.again.scores[0, 1]:.3f}" in titles[1]
    low, high = figure.axes[0].images[0].get_clim()
    assert low == -high
    assert [axis.get_xlabel() for axis in figure.axes[:3]] == ["direction cosine L", "x (µm)", "x (µm)"]
    write_trial_figure(trial, tmp_path / "trial.png")
    assert (tmp_path / "trial.png").read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="suffix must be one of"):
        write_trial_figure(trial, tmp_path / "trial.jpeg")
    assert not (tmp_path / "trial.jpeg").exists()


@pytest.mark.parametrize("title", ["$\\frac{ $ </title><script>x</script>", "\x1b]0;owned\x07 \x00 5 $"])
def test_titles_are_drawn_as_they_stand(small_store, tmp_path, title):
    trial = single_trial(small_store, 2)
    study = trial.study.model_copy(update={"title": title})
    write_trial_figure(replace(trial, study=study), tmp_path / "trial.svg")
    root = ElementTree.parse(tmp_path / "trial.svg").getroot()
    assert not [e for e in root.iter() if e.tag.endswith("script")]
