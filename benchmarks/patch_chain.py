"""Wave-level trials: a patch through a perturbed lens and back, on a line and in the plane."""

from __future__ import annotations

import multiprocessing
import time
from functools import partial
from multiprocessing.synchronize import Barrier

import numpy as np

from benchmarks.timing import DESIGNS, Row, interleaved, print_table
from lensdesign import Pose, load_design
from wavesim.pupil.patch_chain import PatchChain, chain_contrast

LINE_WIDTH_UM = 0.775
COUNTS = {True: 400, False: 60}
TARGETS = {True: 50.0, False: 10.0}
PROCESSES = 2
ROUNDS = 3
TILTS_DEG, DECENTERS_MM = (0.0, 0.1, 0.3, 0.5), (0.0, 0.01, 0.03, 0.05)


def main() -> None:
    """Measure and print."""
    for line in (True, False):
        name = "On a line" if line else "In the plane"
        print_table(f"{name}: trials with the perturbed lens's rays, set-up excluded", speeds(line))
    for line in (True, False):
        name = "on a line" if line else "in the plane"
        print_table(f"Contrast of lines across y, {name}, on the axis", contrasts(line))


def chain_of(line: bool) -> PatchChain:
    """The paper's lens on its axis."""
    return PatchChain(load_design(DESIGNS / "paper_singlet.toml"), line=line)


def pose_of(seed: int) -> Pose:
    """A mount's errors, those that leave the meridional plane a plane of symmetry."""
    decenter, tilt = np.random.default_rng(seed).normal(size=2) * [0.01, 0.05]
    return Pose(decenter_y_mm=decenter, tilt_x_deg=tilt)


def speeds(line: bool) -> list[Row]:
    """Trials a second of one and of two processes, and where the time of one goes."""
    start = time.perf_counter()
    chain = chain_of(line)
    setup = time.perf_counter() - start
    trial, bars = chain.perturbed(pose_of(1)), chain.bars(LINE_WIDTH_UM)
    parts = interleaved(
        {
            "the trial": partial(score, chain, 1),
            "  perturbed rays": partial(chain.perturbed, pose_of(1)),
            "  spectrum of the object at p'": partial(trial.spectrum, bars),
            "  there and back, rays excluded": partial(trial.returned, bars, "focus"),
            "  the whole patch's field": partial(field_of, chain, bars),
        },
        21,
    )
    count = COUNTS[line]
    one = max(count / seconds for seconds in (timed(chain, count) for _ in range(ROUNDS)))
    return [
        Row("samples across the stop", chain.rays.base.grid.samples),
        Row("set-up", setup, "s"),
        Row("one process, best", one, "trials/s", at_least=TARGETS[line]),
        Row(f"{PROCESSES} processes, best", together(line), "trials/s", at_least=TARGETS[line]),
        *(Row(f"{name}, processor time", 1e3 * spent.cpu_median, "ms") for name, spent in parts.items()),
    ]


def field_of(chain: PatchChain, bars: np.ndarray) -> object:
    """What comes back on all of the patch's grid."""
    return chain.perturbed(pose_of(1)).returned(bars, "focus").values


def score(chain: PatchChain, seed: int) -> float:
    """One trial: rays, there and back, refocused, contrast."""
    return chain_contrast(chain.perturbed(pose_of(seed)), LINE_WIDTH_UM)


def timed(chain: PatchChain, count: int) -> float:
    """Seconds of many trials."""
    start = time.perf_counter()
    for seed in range(count):
        score(chain, seed)
    return time.perf_counter() - start


def together(line: bool) -> float:
    """Trials a second of processes side by side, from when all have set up to when the last has done."""
    context = multiprocessing.get_context("spawn")
    barrier = context.Barrier(PROCESSES + 1)
    workers = [context.Process(target=_work, args=(line, barrier)) for _ in range(PROCESSES)]
    for worker in workers:
        worker.start()
    best = 0.0
    for _ in range(ROUNDS):
        barrier.wait()
        start = time.perf_counter()
        barrier.wait()
        best = max(best, PROCESSES * COUNTS[line] / (time.perf_counter() - start))
    for worker in workers:
        worker.join()
    return best


def _work(line: bool, barrier: Barrier) -> None:
    chain = chain_of(line)
    timed(chain, 2)
    for _ in range(ROUNDS):
        barrier.wait()
        timed(chain, COUNTS[line])
        barrier.wait()


def contrasts(line: bool) -> list[Row]:
    """Contrast after decenters and tilts about the front vertex, refocused and as they are."""
    chain = chain_of(line)
    poses = {f"decenter_y {d:g} mm": Pose(decenter_y_mm=d) for d in DECENTERS_MM}
    poses |= {f"tilt_x {tilt:g} deg": Pose(tilt_x_deg=tilt) for tilt in TILTS_DEG}
    rows = []
    for name, pose in poses.items():
        trial = chain.perturbed(pose)
        for width in (0.775, 1.55):
            for refocused in (True, False):
                label = f"{name}, {width:g} um, {'refocused' if refocused else 'as it is'}"
                rows.append(Row(label, chain_contrast(trial, width, refocused=refocused)))
    return rows


if __name__ == "__main__":
    main()
