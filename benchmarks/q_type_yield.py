"""As-built yields: a lens with Q-type aspheres, and the best lens with conics of the same thickness.

Both lenses come from searches for the smallest spread: `designs/q_type_lens_spec.toml` and
`designs/conic_phone_lens_spec.toml`, the same task with conics alone. Fresh trials of
`designs/q_type_lens_tolerances.toml`, which no search used, count the lenses whose light the pixels sample.
"""

from __future__ import annotations

from benchmarks.timing import DESIGNS, Row, print_table
from lensdesign import load_design, load_specification, optimize
from lensdesign.optimization.as_built import as_built_by

TRIALS, FRESH_SEED = 10_000, 4711


def main() -> None:
    """Search, try and print."""
    lens = load_design(DESIGNS / "q_type_lens.toml")
    conic = optimize(load_specification(DESIGNS / "conic_phone_lens_spec.toml"))
    study = as_built_by(str(DESIGNS / "q_type_lens_tolerances.toml"), lens)
    tried = study.trials([("Q-type aspheres", lens), ("conics", conic.lens)], TRIALS, FRESH_SEED)
    rows = []
    for one in tried.rows:
        rows += [
            Row(f"{one.name}: yield", 100.0 * one.good, "%"),
            Row(f"{one.name}: 95 % interval, from", 100.0 * one.low, "%"),
            Row(f"{one.name}: 95 % interval, to", 100.0 * one.high, "%"),
        ]
    gain = 100.0 * (tried.rows[0].good - tried.rows[1].good)
    rows.append(Row("Q-type aspheres, more lenses than conics", gain, "points", at_least=5.0))
    print_table(f"{TRIALS} trials, {lens.exit_vertex_z_mm:g} mm thick", rows)


if __name__ == "__main__":
    main()
