"""Merits of rays: the nominal score is the number that the check of the design states."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from lensdesign import load_design
from lensdesign.analysis.exit_beam import footprint, largest_spread_angle
from tolerancing.merits.context import Context, Sampling
from tolerancing.merits.rays import FootprintRadius, LargestSpread, Throughput

ROOT = Path(__file__).parents[3]
DESIGNS = [
    *sorted((ROOT / "tests" / "golden" / "designer_b").glob("[bt]*.toml")),
    *(
        ROOT / "designs" / f"{name}.toml"
        for name in ("paper_singlet", "phone_lens", "moulded_pair", "wide_field")
    ),
]


@pytest.mark.parametrize("design", DESIGNS, ids=lambda path: path.stem)
def test_nominal_spread_and_footprint_are_those_of_the_check(design):
    lens = load_design(design)
    # Few rays on purpose: the extreme rays themselves are added to them.
    context = Context(lens, Sampling(rings=3, arms=8))
    nominal = context.perturbed((), np.zeros((1, 0)))
    spread = LargestSpread(kind="largest_spread_deg", at_most=90.0).scores(context, nominal)
    assert spread == pytest.approx(largest_spread_angle(lens).spread_deg, abs=2e-6)
    for distance in (*lens.sensor.plane_distances_mm, 4.0):
        merit = FootprintRadius(kind="footprint_radius_mm", at_most=90.0, plane_distance_mm=distance)
        found = footprint(lens, plane_distance_mm=distance).radius_mm
        assert merit.scores(context, nominal) == pytest.approx(found, abs=2e-7)


def test_extreme_rays_have_no_weight_in_the_throughput(paper_lens):
    narrow = paper_lens.with_surface(1, semi_diameter_mm=6.0)
    merit = Throughput(kind="throughput", at_least=0.5)
    shares = []
    for arms in (24, 96):
        context = Context(narrow, Sampling(rings=24, arms=arms))
        shares.append(float(merit.scores(context, context.perturbed((), np.zeros((1, 0))))[0]))
    assert 0.1 < shares[0] < 0.99
    assert shares[0] == pytest.approx(shares[1], abs=5e-3)
