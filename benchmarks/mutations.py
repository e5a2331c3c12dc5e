"""What the tests would notice: one definition changed at a time, and which test says so.

    python -m benchmarks.mutations [--workers 2]

Each mutation changes one line of a copy of the project, where the paper or a standard defines something, and
runs the test files that are nearest to it until one fails. One that no test notices makes the run void (exit
status 1).
Two minutes on two cores.
"""

from __future__ import annotations

import argparse
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from queue import Queue
from tempfile import TemporaryDirectory

ROOT = Path(__file__).resolve().parents[1]
COPIED = ("lensdesign", "wavesim", "tolerancing", "tests", "designs", "pyproject.toml")
DEFINITIONS = "tests/test_definitions.py"


@dataclass(frozen=True)
class Mutation:
    """One line changed.

    Attributes
    ----------
    what
        In words.
    file
        Of the project.
    old, new
        Text that the file holds once, and what takes its place.
    tests
        Files of tests that are run, with spaces between them, the nearest first.
    """

    what: str
    file: str
    old: str
    new: str
    tests: str = DEFINITIONS

    def mutated(self, root: Path) -> str:
        """The file's text with the change.

        Raises
        ------
        ValueError
            If the file does not hold the text just once.
        """
        text = (root / self.file).read_text(encoding="utf-8")
        if text.count(self.old) != 1:
            raise ValueError(f"{self.file} holds {text.count(self.old)} times what is to change: {self.old}")
        return text.replace(self.old, self.new)


MUTATIONS = (
    # Eqs. 1 and 2
    Mutation(
        "Eq. 1: area of the field by its diameter",
        "lensdesign/analysis/space_bandwidth.py",
        "return math.pi * (0.5 * field_diameter_mm) ** 2",
        "return math.pi * field_diameter_mm**2",
    ),
    Mutation(
        "Eq. 1: the sensor's circle by its side",
        "lensdesign/analysis/space_bandwidth.py",
        "math.pi * (0.5 * shortest_side_mm) ** 2",
        "math.pi * shortest_side_mm**2",
    ),
    Mutation(
        "Eq. 2: pixels resolve 1 / pitch",
        "lensdesign/analysis/space_bandwidth.py",
        "return min(1.0, wavelength_um / (2.0 * medium_index * pixel_pitch_um))",
        "return min(1.0, wavelength_um / (medium_index * pixel_pitch_um))",
    ),
    Mutation(
        "Eq. 2: the limit of air in every medium",
        "lensdesign/analysis/space_bandwidth.py",
        "return min(1.0, wavelength_um / (2.0 * medium_index * pixel_pitch_um))",
        "return min(1.0, wavelength_um / (2.0 * pixel_pitch_um))",
    ),
    Mutation(
        "Eq. 2: the angle to one axis only",
        "lensdesign/analysis/exit_beam.py",
        "np.hypot(direction[..., 0], direction[..., 1])",
        "np.abs(direction[..., 1])",
        "tests/lensdesign/analysis/test_exit_beam.py",
    ),
    # Surfaces and rays
    Mutation(
        "a conic constant of 1 for the sphere",
        "lensdesign/lens/shapes/conic.py",
        "return np.asarray((1.0 + k) * c * c)",
        "return np.asarray(k * c * c)",
        "tests/lensdesign/lens/shapes/test_conic.py tests/lensdesign/lens/shapes/test_registry.py",
    ),
    Mutation(
        "asphere coefficients from r^6 on",
        "lensdesign/lens/shapes/even_asphere.py",
        """        power = r2
        for j in range(2, len(terms)):
            gradient = gradient""",
        """        power = r2 * r2
        for j in range(2, len(terms)):
            gradient = gradient""",
        "tests/lensdesign/lens/shapes/test_even_asphere.py tests/lensdesign/lens/shapes/test_registry.py",
    ),
    Mutation(
        "path in front of a surface at the index behind it",
        "lensdesign/raytrace/conic_kernel.py",
        "after[OPL + i] = ray[OPL + i] + n1 * t",
        "after[OPL + i] = ray[OPL + i] + n1 / ratio * t",
        "tests/lensdesign/raytrace/test_rays.py",
    ),
    # Glass, poses, figures
    Mutation(
        "the d line of sodium",
        "lensdesign/lens/catalogues/agf.py",
        "LINE_D_UM = 0.5875618",
        "LINE_D_UM = 0.5892938",
    ),
    Mutation(
        "tilt about y left-handed",
        "lensdesign/lens/poses.py",
        "entries = cy, 0.0, sy, sx * sy, cx, -sx * cy, -cx * sy, sx, cx * cy",
        "entries = cy, 0.0, -sy, -sx * sy, cx, -sx * cy, cx * sy, sx, cx * cy",
    ),
    Mutation(
        "tilts in the other order",
        "lensdesign/lens/poses.py",
        "entries = cy, 0.0, sy, sx * sy, cx, -sx * cy, -cx * sy, sx, cx * cy",
        "entries = cy, sy * sx, sy * cx, 0.0, cx, -sx, -sy, cy * sx, cy * cx",
    ),
    Mutation(
        "Zernike polynomials of norm sqrt(n + 1)",
        "lensdesign/lens/zernikes.py",
        "math.sqrt((n + 1) * (1 if m == 0 else 2))",
        "math.sqrt(n + 1)",
    ),
    Mutation(
        "interferometer at 633 nm",
        "lensdesign/lens/surface_figure_source.py",
        "TEST_WAVELENGTH_UM = 0.6328",
        "TEST_WAVELENGTH_UM = 0.633",
    ),
    Mutation(
        "3MF in inches",
        "lensdesign/manufacture/mesh/writing.py",
        '\'<model unit="millimeter"',
        '\'<model unit="inch"',
        "tests/lensdesign/manufacture/mesh/test_writing.py",
    ),
    Mutation(
        "fringes of ISO 10110-5 at 632.8 nm",
        "lensdesign/manufacture/drawing/tolerances.py",
        "MERCURY_LINE_UM = 0.54607",
        "MERCURY_LINE_UM = 0.6328",
        "tests/lensdesign/manufacture/drawing/test_sheets.py",
    ),
    Mutation(
        "ISO 10110-11: thickness of parts up to 30 mm",
        "lensdesign/analysis/outline.py",
        "30.0: EdgeAllowance(0.5, 0.2,",
        "30.0: EdgeAllowance(0.5, 0.4,",
        "tests/lensdesign/manufacture/drawing/test_sheets.py",
    ),
    # The object
    Mutation(
        "chart: bars four times as long as wide", "wavesim/targets/usaf.py", "LENGTH = 5.0", "LENGTH = 4.0"
    ),
    Mutation(
        "chart: one width between sets",
        "wavesim/targets/usaf.py",
        "GAP = 2.0",
        "GAP = 1.0",
    ),
    Mutation(
        "chart: five elements to the octave",
        "wavesim/targets/usaf.py",
        "(element - 1) / 6.0",
        "(element - 1) / 5.0",
    ),
    Mutation(
        "band limit of half the aperture",
        "wavesim/targets/patterns.py",
        "limit = 1e3 * numerical_aperture / wavelength_um",
        "limit = 0.5e3 * numerical_aperture / wavelength_um",
        "tests/wavesim/targets/test_patterns.py",
    ),
    # Through the lens
    Mutation(
        "Fresnel: TE for TM",
        "lensdesign/lens/coatings/thin_films.py",
        "entrance = front * front / first if is_p else first",
        "entrance = first if is_p else front * front / first",
    ),
    Mutation(
        "an ideal coating that keeps the amplitude",
        "wavesim/rays/interfaces.py",
        "keep = np.sqrt(n1 * incidence / (n2 * refraction))",
        "keep = np.ones_like(incidence)",
    ),
    Mutation(
        "plane waves of the other sign",
        "wavesim/fields/plane_waves.py",
        "np.sin(phase, out=result.imag)",
        "np.sin(-phase, out=result.imag)",
        "tests/wavesim/fields/test_propagator.py",
    ),
    Mutation(
        "the aperture of tubes of rays by paths, not by areas",
        "wavesim/rays/ray_bundles.py",
        "amplitude, path_mm = np.sqrt(spread * ratio), rays.opl",
        "amplitude, path_mm = spread * ratio, rays.opl",
        "tests/wavesim/rays/test_ray_bundles.py",
    ),
    Mutation(
        "Eq. 4: the glass in front of the surface",
        "wavesim/engines/slices/compensation.py",
        "for n in self.ray.indices)",
        "for n in self.ray.indices[::-1])",
        "tests/wavesim/engines/slices/test_engine.py",
    ),
    Mutation(
        "oblique compensation without the cosine",
        "wavesim/engines/slices/compensation.py",
        "(n1 * found.axial_before, n2 * found.axial_after)",
        "(n1 + 0.0 * found.axial_before, n2 + 0.0 * found.axial_after)",
        "tests/wavesim/engines/slices/test_engine.py",
    ),
    # Pupils
    Mutation(
        "Strehl ratio of amplitudes",
        "wavesim/pupil/pupil.py",
        "np.count_nonzero(pupil.valid)) ** 2)",
        "np.count_nonzero(pupil.valid)))",
    ),
    Mutation(
        "transfer of the amplitude",
        "wavesim/pupil/pupil.py",
        "spectrum = np.abs(np.fft.fft(field, 2 * samples, axis=1)) ** 2",
        "spectrum = np.abs(np.fft.fft(field, 2 * samples, axis=1))",
    ),
    # The camera
    Mutation(
        "shot noise of half the electrons",
        "wavesim/sensor/camera_noise.py",
        "electrons = random.poisson(np.minimum(electrons, most)).astype(float)",
        "electrons = 0.5 * random.poisson(2.0 * np.minimum(electrons, most))",
    ),
    Mutation(
        "top count 2^bits",
        "wavesim/sensor/camera_noise.py",
        "full, top = electronics.full_well_electrons, 2**electronics.bits - 1",
        "full, top = electronics.full_well_electrons, 2**electronics.bits",
    ),
    # Reconstruction
    Mutation(
        "A5: weights swapped",
        "wavesim/reconstruction/phase_retrieval.py",
        "FEEDBACK = (0.7, 0.5)",
        "FEEDBACK = (0.5, 0.7)",
    ),
    Mutation(
        "A4: twice the step",
        "wavesim/reconstruction/phase_retrieval.py",
        "TV_STEP = 0.05",
        "TV_STEP = 0.1",
    ),
    Mutation(
        "A5: a and b swapped",
        "wavesim/reconstruction/appendix_a.py",
        "_subtract_feedback(now, previous, a, b)\n    match",
        "_subtract_feedback(now, previous, b, a)\n    match",
        "tests/wavesim/reconstruction/test_phase_retrieval.py",
    ),
    Mutation(
        "A5: feedback one iteration early",
        "wavesim/reconstruction/phase_retrieval.py",
        "if k < 2 else",
        "if k < 1 else",
        "tests/wavesim/reconstruction/test_phase_retrieval.py",
    ),
    Mutation(
        "A4: t in place of t / 2",
        "wavesim/reconstruction/appendix_a.py",
        "step = 0.5 * tv_step * weight",
        "step = tv_step * weight",
        "tests/wavesim/reconstruction/test_phase_retrieval.py",
    ),
    Mutation(
        "Eq. 5: a sum of moduli",
        "wavesim/reconstruction/refocusing.py",
        "modulus = np.sqrt(np.abs(down) ** 2 + np.abs(across) ** 2)",
        "modulus = np.abs(down) + np.abs(across)",
    ),
    Mutation(
        "Eq. 6: a mean over all samples",
        "wavesim/reconstruction/refocusing.py",
        "/ math.sqrt(values.size)",
        "/ values.size",
    ),
    Mutation(
        "A6: a correlation about zero",
        "wavesim/reconstruction/appendix_a.py",
        "(sxy - sx * sy / count) / math.sqrt(x_variance * y_variance)",
        "sxy / math.sqrt(x_variance * y_variance)",
        "tests/wavesim/reconstruction/test_phase_retrieval.py",
    ),
    # Judgement
    Mutation(
        "resolved at half the contrast",
        "wavesim/targets/bars.py",
        "RESOLVED_CONTRAST = 0.2",
        "RESOLVED_CONTRAST = 0.1",
    ),
    Mutation(
        "contrast over the brighter part",
        "wavesim/targets/bars.py",
        "total = bright + dark",
        "total = bright",
        "tests/wavesim/metrics/test_contrast.py",
    ),
    # Tolerances
    Mutation(
        "90 % confidence",
        "tolerancing/statistics/yields.py",
        "CONFIDENCE = 0.95",
        "CONFIDENCE = 0.9",
    ),
    Mutation(
        "fringes of a whole wave",
        "tolerancing/perturbations/grades.py",
        "FRINGE_UM = 0.5 * MERCURY_LINE_UM",
        "FRINGE_UM = MERCURY_LINE_UM",
    ),
    Mutation(
        "radius in fringes of h^2 dR / R^2",
        "tolerancing/perturbations/batch.py",
        "(radius / semi_diameter) ** 2 * value",
        "0.5 * (radius / semi_diameter) ** 2 * value",
        "tests/tolerancing/perturbations/test_batch.py",
    ),
    Mutation(
        "root sum square of variances",
        "tolerancing/statistics/sensitivities.py",
        "np.sqrt(np.sum(sensitivity.standard_deviation**2, axis=0))",
        "np.sum(sensitivity.standard_deviation, axis=0)",
        "tests/tolerancing/statistics/test_sensitivities.py",
    ),
    Mutation(
        "a trial at its limit fails",
        "tolerancing/merits/base.py",
        "return self.margin(scores) >= 0.0",
        "return self.margin(scores) > 0.0",
        "tests/tolerancing/merits/test_registry.py",
    ),
)


@contextmanager
def copies(count: int) -> Iterator[Queue[Path]]:
    """Copies of the project to change, with its compiled kernels."""
    with TemporaryDirectory() as folder:
        free: Queue[Path] = Queue()
        for number in range(count):
            copy = Path(folder) / str(number)
            for name in COPIED:
                target = copy / name
                if (ROOT / name).is_dir():
                    shutil.copytree(ROOT / name, target)
                else:
                    shutil.copy2(ROOT / name, target)
            free.put(copy)
        yield free


def caught_by(mutation: Mutation, root: Path) -> str | None:
    """The first test that fails in a copy; None where all pass."""
    path = root / mutation.file
    kept, times = path.read_bytes(), path.stat()
    path.write_text(mutation.mutated(root), encoding="utf-8")
    try:
        done = subprocess.run(
            [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *mutation.tests.split()],
            cwd=root,
            env=os.environ | {"PYTHONPATH": str(root), "OPENBLAS_NUM_THREADS": "1"},
            capture_output=True,
            text=True,
        )
    finally:
        path.write_bytes(kept)
        os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    found = re.search(r"^(?:FAILED|ERROR) (\S+)", done.stdout, re.MULTILINE)
    if done.returncode and found is None:
        raise RuntimeError(f"{mutation.what}: {done.stdout[-2000:]}{done.stderr[-2000:]}")
    return found and found.group(1)


def main() -> None:
    """Mutate, test and print."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--workers", type=int, default=2)
    workers: int = parser.parse_args().workers
    with copies(workers) as free, ThreadPoolExecutor(workers) as pool:

        def one(mutation: Mutation) -> str | None:
            root = free.get()
            try:
                return caught_by(mutation, root)
            finally:
                free.put(root)

        found = []
        for mutation, test in zip(MUTATIONS, pool.map(one, MUTATIONS), strict=True):
            print(f"{mutation.what:45} {mutation.file:52} {test or 'NOT CAUGHT'}", flush=True)
            found.append(test)
    missed = found.count(None)
    print(f"{len(found) - missed} of {len(found)} mutations caught")
    if missed:
        raise SystemExit(1)


if __name__ == "__main__":
    main()
