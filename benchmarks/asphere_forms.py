"""One search in several forms of an asphere: evaluations until three starts agree on the smallest spread.

The specification is `designs/smallest_spread_spec.toml`. The back has a conic with four powers of r, a conic
with four terms of Qcon, or a sphere with four terms of Qbfs.
"""

from __future__ import annotations

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_specification, optimize
from lensdesign.optimization.specification.specification import Specification
from lensdesign.optimization.specification.variables import VariableRange

REACH_MM, TERMS = 8.0, 4


def main() -> None:
    """Search and print."""
    start = load_specification(DESIGNS / "smallest_spread_spec.toml")
    powers = {f"asphere_{n}": 0.5 / REACH_MM**n for n in range(4, 4 + 2 * TERMS, 2)}
    q_terms = {f"q_{m}_mm": 0.5 for m in range(TERMS)}
    q_keys = {"normalization_radius_mm": REACH_MM, "q_mm": (0.0,) * TERMS}
    spherical = start.replaced(variables=tuple(v for v in start.variables if v.parameter != "conic"))
    forms = {
        "powers of r": with_variables(start.with_surface(1, asphere=(0.0,) * TERMS), powers),
        "Qcon": with_variables(start.with_surface(1, shape="Qcon", **q_keys), q_terms),
        "Qbfs": with_variables(spherical.with_surface(1, shape="Qbfs", **q_keys), q_terms),
    }
    for name, specification in forms.items():
        found = optimize(specification)
        rows = [Row("smallest spread", found.goal_value, "deg"), Row("evaluations", found.evaluations)]
        print_table(name, rows)


def with_variables(specification: Specification, limits: dict[str, float]) -> Specification:
    """Return a specification with more variables of the back, each between minus and plus its limit."""
    more = (VariableRange(parameter=name, surface=2, bounds=(-most, most)) for name, most in limits.items())
    return specification.replaced(variables=(*specification.variables, *more))


if __name__ == "__main__":
    main()
