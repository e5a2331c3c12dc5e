"""Rules of settings that belong together or contradict each other."""

from __future__ import annotations

import re

import pytest

from lensdesign.errors import InputError
from wavesim.scene.settings import (
    RULES,
    CalibrationSettings,
    ColourSettings,
    FreeSpaceSettings,
    ImageSettings,
    LayerReconstructionSettings,
    ReconstructionSettings,
    Rule,
)

MODELS = (
    CalibrationSettings,
    ColourSettings,
    FreeSpaceSettings,
    ImageSettings,
    LayerReconstructionSettings,
    ReconstructionSettings,
)


@pytest.mark.parametrize("rule", RULES, ids=lambda rule: f"{rule.setting}-{rule.other}")
def test_a_rule_is_for_settings_that_some_model_has(rule: Rule) -> None:
    names = set(re.findall(r"{(\w+)}", rule.message))
    assert names == {rule.setting.split()[0], rule.other.split()[0]}
    assert any(names <= model.model_fields.keys() for model in MODELS)
    assert not any(rule.is_broken(model()) for model in MODELS)


def test_all_broken_rules_are_named() -> None:
    with pytest.raises(InputError) as caught:
        ImageSettings().replaced(waist_mm=0.1, film_index=1.5)
    assert "waist_mm: requires illumination gaussian" in str(caught.value)
    assert "film_index: requires thickness_um" in str(caught.value)


def test_a_source_of_width_0_is_coherent_light_that_the_paper_s_method_assumes() -> None:
    assert ReconstructionSettings(method="paper", source_deg=0.0, bandwidth_nm=0.0).source_deg == 0.0
    with pytest.raises(InputError, match="source_deg: cannot be used with method paper, which assumes"):
        ReconstructionSettings().replaced(method="paper", source_deg=0.1)
