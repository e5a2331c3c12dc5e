"""Run every benchmark, each in a process of its own, and say what was left out."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

from benchmarks.others import HOW_TO_GET, missing_packages

SCRIPTS = (
    "trace_speed",
    "asphere_forms",
    "asphere_speed",
    "trace_limit",
    "as_built",
    "q_type_yield",
    "wavefronts",
    "budgets",
    "starter_studies",
    "monte_carlo_speed",
    "optimizer",
    "limits",
    "stock_search",
    "pupil_trial",
    "eikonal_speed",
    "terms_transform",
    "full_field",
    "interpolation_limit",
    "field_scaling",
    "large_field",
    "full_plane_slices",
    "rim",
    "chooser",
    "scalar_light",
    "broad_light",
    "polarized_frames",
    "reconstruction",
    "perfect_benches",
    "whole_field",
    "colours",
    "cover_glass",
    "iterations",
    "layers",
    "single_exposure",
    "phase_retrieval",
    "refocusing",
    "uncertainty",
    "roughness",
    "single_exposure_lenses",
    "verdicts",
    "plan_outcomes",
    "oversampling_chart",
    "calibration_errors",
    "known_object",
    "photographs",
    "bench_sets",
    "focus_rule",
    "merits_and_chain",
    "goals_and_chain",
    "whole_chain",
    "long_commands",
    "tilt_and_slices",
    "study_speed",
    "study_faults",
    "attack",
    "control_variates",
    "interval_coverage",
    "temperature",
    "exchange",
    "lens_files",
    "step_export",
    "import_time",
    "workbench",
    "mutations",
)


def main() -> None:
    """Run them one after the other; exit with status 1 if one was void."""
    root = Path(__file__).resolve().parents[1]
    void = []
    for script in SCRIPTS:
        print(f"== {script}", flush=True)
        if subprocess.run([sys.executable, "-m", f"benchmarks.{script}"], cwd=root).returncode:
            void.append(script)
    missing = missing_packages()
    if missing:
        print(f"left out, not installed: comparisons with {', '.join(missing)} ({HOW_TO_GET})")
    if void:
        raise SystemExit(f"void or failed: {', '.join(void)}")


if __name__ == "__main__":
    main()
