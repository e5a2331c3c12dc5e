"""The optimizer: how good the lenses are that it finds, how surely, and how fast."""

from __future__ import annotations

import os
import subprocess
import sysconfig
import tempfile
import time
from pathlib import Path

from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from lensdesign.optimization.result import OptimizationResult
from lensdesign.optimization.search import optimize
from lensdesign.optimization.specification.specification import Specification, load_specification

ROUNDS = 7
SEEDS = (0, 1, 2)
STARTS = 20


def main() -> None:
    """Measure and print."""
    spread = load_specification(DESIGNS / "smallest_spread_spec.toml")
    thinnest = load_specification(DESIGNS / "thinnest_singlet_spec.toml")
    feasible = load_specification(DESIGNS / "feasible_singlet_spec.toml")
    phone = load_specification(DESIGNS / "phone_lens_spec.toml")
    rows = in_new_process() + in_this_process("same process", spread, "deg", at_most=4.585)
    print_table("Smallest spread from a plate", rows)
    rows = []
    for seed in SEEDS:
        rows += from_random_starts(f"smallest spread, seed {seed}", spread, seed, "deg", at_least=STARTS - 1)
    for seed in SEEDS:
        rows += from_random_starts(f"thinnest lens, seed {seed}", thinnest, seed, "mm")
    print_table(f"{STARTS} random starts; at the best: those within 0.1 % of it", rows)
    rows = in_this_process("thinnest lens", thinnest, "mm")
    rows += in_this_process("feasible singlet, largest spread", feasible, "deg")
    rows += in_this_process("phone lens, three wavelengths", phone, "mm")
    print_table("Other specifications, from a plate", rows)


def in_new_process() -> list[Row]:
    """Time the command that looks for the smallest spread, and the same on its very first run."""
    timing = interleaved({"command": run_command}, ROUNDS)["command"]
    with tempfile.TemporaryDirectory() as empty:
        start = time.perf_counter()
        run_command(os.environ | {"NUMBA_CACHE_DIR": empty})
        first = time.perf_counter() - start
    return [
        Row("new process, best", timing.best, "s", at_most=2.0),
        Row("new process, median", timing.median, "s", at_most=2.0),
        Row("very first run, which compiles the kernels", first, "s"),
    ]


def run_command(environment: dict[str, str] | None = None) -> None:
    """Run `lensdesign optimize` to its end."""
    command = Path(sysconfig.get_path("scripts")) / "lensdesign"
    with tempfile.TemporaryDirectory() as folder:
        output = Path(folder) / "found.toml"
        arguments = ["optimize", str(DESIGNS / "smallest_spread_spec.toml"), "-o", str(output)]
        subprocess.run([command, *arguments], check=True, capture_output=True, env=environment)


def in_this_process(
    name: str, specification: Specification, unit: str, at_most: float | None = None
) -> list[Row]:
    """Time a search with everything imported and compiled."""
    timing = interleaved({name: lambda: optimize(specification)}, ROUNDS)[name]
    found = optimize(specification)
    validate_feasible(name, found)
    return [
        Row(f"{name}: found", found.goal_value, unit, at_most=at_most),
        Row(f"{name}: best time", timing.best, "s"),
        Row(f"{name}: median time", timing.median, "s"),
    ]


def from_random_starts(
    name: str, specification: Specification, seed: int, unit: str, at_least: float | None = None
) -> list[Row]:
    """Search from random starts."""
    settings = specification.optimize.replaced(start="random", starts=STARTS, agreeing=STARTS)
    found = optimize(specification.model_copy(update={"optimize": settings}), seed=seed)
    validate_feasible(name, found)
    return [
        Row(f"{name}: best", found.goal_value, unit),
        Row(f"{name}: at the best", found.starts_at_best, f"of {found.starts}", at_least=at_least),
        Row(f"{name}: time for all", found.seconds, "s"),
    ]


def validate_feasible(name: str, found: OptimizationResult) -> None:
    """End the program where a constraint is not met: the goal's value then means nothing."""
    if not found.feasible:
        raise SystemExit(f"void: {name} is not feasible: {'; '.join(found.violations)}")


if __name__ == "__main__":
    main()
