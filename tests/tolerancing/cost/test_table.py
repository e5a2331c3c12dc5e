"""Tables of costs: that of the package, and faults of others."""

import pytest

from lensdesign.errors import DesignError
from tolerancing.cost.table import QUANTITIES, RELATIVE, load_costs


def test_the_supplied_table_tells_its_sources_and_prices_all_of_a_part():
    table = load_costs()
    assert set(table.processes) == {"polished_glass", "moulded_glass", "moulded_plastic", "turned_mount"}
    assert all(process.source for process in table.processes.values())
    for name in ("polished_glass", "moulded_glass", "moulded_plastic"):
        assert set(QUANTITIES) - set(table.processes[name].prices) == {
            "roll_deg",
            "distance_mm",
            "roughness_rms_nm",
            "coating_thickness_percent",
        }


def test_halving_all_tolerances_of_a_part_makes_it_half_as_dear_again():
    """What the shares are made for."""
    prices = load_costs().processes["polished_glass"].prices
    six = (
        "radius_percent",
        "irregularity_pv_waves",
        "thickness_mm",
        "tilt_deg",
        "decenter_mm",
        "index",
        "abbe_percent",
    )
    commercial = sum(prices[name].share for name in six)
    assert (1.0 + 2.0 * commercial) / (1.0 + commercial) == pytest.approx(1.5, abs=0.01)


@pytest.mark.parametrize(
    ("old", "new", "message"),
    [
        ('default = "polished_glass"', 'default = "cast"', "default = 'cast'"),
        ('mount = "turned_mount"', 'mount = "glued"', "mount = 'glued'"),
        ("radius_percent = { reference = 0.2,", "radius_percent = { reference = -1.0,", "reference"),
        (
            "radius_percent = { reference = 0.2",
            "radius_mm = { reference = 0.2",
            "radius_mm: unknown; allowed",
        ),
        ('title = "relative costs"', "colour = 1", "colour"),
    ],
)
def test_faults_are_named(tmp_path, old, new, message):
    path = tmp_path / "costs.toml"
    text = RELATIVE.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    with pytest.raises(DesignError, match=message):
        load_costs(path)


def test_a_process_without_a_source_is_refused(tmp_path):
    (tmp_path / "costs.toml").write_text('default = "a"\nmount = "a"\n[process.a]\n')
    with pytest.raises(DesignError, match="source"):
        load_costs(tmp_path / "costs.toml")


def test_elements_are_named_by_their_numbers(tmp_path):
    (tmp_path / "costs.toml").write_text(RELATIVE.read_text() + '\n[elements]\n2 = "moulded_plastic"\n')
    table = load_costs(tmp_path / "costs.toml")
    assert [table.process_of(n) for n in range(3)] == ["polished_glass", "moulded_plastic", "polished_glass"]
