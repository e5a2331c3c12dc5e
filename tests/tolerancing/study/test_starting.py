"""A study to begin with names its design from where it stands."""

from tolerancing.study.files import load_study
from tolerancing.study.starting import start_study


def test_a_started_study_is_one_of_its_design(paper_design, paper_lens, tmp_path):
    (tmp_path / "studies").mkdir()
    path = tmp_path / "studies" / "first.toml"
    start_study(paper_design, path, "commercial")
    loaded = load_study(path)
    assert loaded.lens == paper_lens
    assert "commercial" in loaded.study.title
