"""Fields on tilted planes: rotation of the angular spectrum.

A plane wave is a plane wave on every plane. A rotation of the frame rotates its wave vector and multiplies
the density of the spectrum by the Jacobian kz / kz' (Matsushima, Schimmel and Wyrowski 2003). The rotated
frequencies do not coincide with the samples of the spectrum; a non-uniform Fourier sum evaluates the spectrum
there exactly.

A field on a tilted plane is defined in the plane's own frame. Its origin is the pivot, its axes are rotated
by a right-handed rotation about x, then about the rotated y axis, and its z is 0. The pivot is the centre of
the grid on the untilted plane. On a meridional line only a tilt about x is possible.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import scipy.fft

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from wavesim.fields.chirp_z import chirp_z_transform
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import (
    FADE_ZONES,
    TURN,
    Samples,
    along,
    centres_mm,
    fft_frequencies,
    phasor_of,
)
from wavesim.fields.sampling_checks import EDGE, check_sample_count, report_loss

WIDEST = 4.0
"""Width on the tilted plane, in half-widths of the input window, within which light is followed."""
WAVE_SECONDS, WAVE_BYTES = {True: 2e-6, False: 6.5e-7}, 200
"""Time for each sample of the spectrum of a line and of a plane, measured on two cores, and memory."""


class TiltedSamples:
    """Propagation by a non-uniform Fourier transform, to a tilted plane or from one.

    Parameters
    ----------
    source, target, wavelength_um, index
        As in :class:`wavesim.fields.propagator.FreeSpacePropagator`.
    tilt_deg
        Tilt of the tilted plane about x and y.
    straight
        Whether the source is the untilted plane. Light travels along z of the untilted plane.

    Raises
    ------
    InputError
        If the tilt or the grid is not usable.
    """

    def __init__(
        self,
        source: Grid,
        target: Grid,
        wavelength_um: float,
        index: float,
        tilt_deg: tuple[float, float],
        *,
        straight: bool,
    ) -> None:
        tilted = target if straight else source
        if tilted.z_mm != 0.0:
            raise InputError(
                f"grid z_mm = {tilted.z_mm:g}: must be 0; z of a tilted plane is measured in its own frame"
            )
        rotation = _rotation(tilted, tilt_deg)
        # Columns are the axes of the target.
        self.rotation = rotation if straight else rotation.T
        self.source, self.target = source, target
        self.wavelength_um, self.index = wavelength_um, index
        self.most = 1e3 * index / wavelength_um
        # Centres relative to the pivot, which is the centre of the untilted grid.
        self.centre_in = (0.0,) * len(source.shape) if straight else centres_mm(source)
        self.centre_out = centres_mm(target) if straight else (0.0,) * len(target.shape)
        # Frequency, in the source frame, of the wave along z of the untilted plane.
        along_z = (0.0, 0.0) if straight else (self.rotation[1, 2], self.rotation[0, 2])
        self.carrier = tuple(float(self.most * part) for part in along_z[: len(source.shape)])
        self.frequencies = self._frequencies()
        self.samples = math.prod(f.count for f in self.frequencies)
        check_sample_count([f.count for f in self.frequencies], "propagation to the tilted plane")

    def directions(self, cycles: Sequence[Any], rotation: Array) -> tuple[list[Any], Any, Any]:
        """Return frequencies in the other frame (y, x), and axial ones in this frame and in the other.

        `cycles` are the frequencies in this frame (y, x); the columns of `rotation` are its axes.
        """
        squared = self.most**2 - sum(f**2 for f in cycles)
        axial = np.sqrt(np.clip(squared, 0.0, None))
        parts = dict(zip((1, 0), cycles, strict=False)) | {2: axial}
        turned = [sum(float(rotation[row, column]) * parts[column] for column in parts) for row in parts]
        return turned[:-1], axial, turned[-1]

    def _frequencies(self) -> list[Samples]:
        """Return the frequencies of the target frame that cover the source's band, at the required step."""
        half = 0.5 / self.source.pitch_mm
        # Sampled directions along each axis, from which the bounds of the frequencies follow.
        probes = 33
        probe = np.linspace(-half, half, probes)
        axes = np.meshgrid(*[probe + c for c in self.carrier], indexing="ij")
        cycles, axial, turned = self.directions(axes, self.rotation.T)
        fine = (axial > 0.0) & (turned > 0.0)
        if not fine.any():
            raise InputError(
                "tilt_deg: too large; no light that propagates along +z reaches the tilted plane"
            )
        result = []
        for axis, across in enumerate(cycles):
            spread = (across[fine].max() - across[fine].min()) / (probes - 1)
            low = max(float(across[fine].min() - spread), -self.most)
            high = min(float(across[fine].max() + spread), self.most)
            step = 1.0 / self._period_mm(axis)
            result.append(Samples(0.5 * (low + high), step, math.ceil((high - low) / step) + 1))
        return result

    def _half_field_mm(self, axis: int) -> float:
        """Return the half-width, about the pivot, of the region that is followed on the target plane."""
        half = max(w + abs(c) for w, c in zip(self.source.half_widths_mm, self.centre_in, strict=True))
        cosine = float(self.rotation[2, 2])
        blur = math.sqrt(1e-3 * self.wavelength_um / self.index * half * math.sqrt(1.0 - cosine**2))
        return 0.5 * WIDEST * half / cosine + FADE_ZONES * blur

    def _period_mm(self, axis: int) -> float:
        window = self.target.half_widths_mm[axis] + abs(self.centre_out[axis])
        return self._half_field_mm(axis) + window

    def _weights(self) -> tuple[list[Array], Array]:
        """Return the source frequencies of each target frequency, and the factor of its wave."""
        dimensions = len(self.frequencies)
        cycles = [along(f.points(), axis, dimensions) for axis, f in enumerate(self.frequencies)]
        sources, axial, turned = self.directions(cycles, self.rotation)
        keep = (axial > 0.0) & (turned > 0.0)
        half = 0.5 / self.source.pitch_mm
        for across, carrier in zip(sources, self.carrier, strict=True):
            keep = keep & (across - carrier >= -half) & (across - carrier < half)
        jacobian = np.where(keep, turned / np.where(axial > 0.0, axial, 1.0), 0.0)
        cell = self.source.cell * math.prod(f.step for f in self.frequencies)
        return [np.broadcast_to(across, keep.shape)[keep] for across in sources], jacobian * cell

    def forward(self, values: Any) -> Any:
        sources, factor = self._weights()
        keep = np.asarray(factor > 0.0)
        spectrum = np.zeros(factor.shape, dtype=np.complex128)
        spectrum[keep] = self._nonuniform(values, sources, 2)
        spectrum = spectrum * np.asarray(factor)
        for axis, (f, n) in enumerate(zip(self.frequencies, self.target.shape, strict=True)):
            x = Samples(self.centre_out[axis], self.target.pitch_mm, n)
            spectrum = chirp_z_transform(spectrum, f, x, sign=1, axis=axis)
        return np.asarray(spectrum, dtype=np.result_type(values.dtype, np.complex64))

    def adjoint(self, values: Any) -> Any:
        sources, factor = self._weights()
        result = np.asarray(values, dtype=np.complex128) * (self.target.cell / self.source.cell)
        for axis, (f, n) in enumerate(zip(self.frequencies, self.target.shape, strict=True)):
            x = Samples(self.centre_out[axis], self.target.pitch_mm, n)
            result = chirp_z_transform(result, x, f, sign=-1, axis=axis)
        result = (result * np.asarray(factor))[np.asarray(factor > 0.0)]
        return np.asarray(
            self._nonuniform(result, sources, 1), dtype=np.result_type(values.dtype, np.complex64)
        )

    def _nonuniform(self, values: Any, cycles: list[Array], kind: int) -> Any:
        """Return the Fourier sum from source samples to frequencies (kind 2), or its adjoint (kind 1)."""
        import finufft  # type: ignore[import-untyped]

        pitch = self.source.pitch_mm
        points = [np.remainder(2.0 * math.pi * pitch * f + math.pi, 2.0 * math.pi) - math.pi for f in cycles]
        # The library's samples are offset by half a pitch where their number is even.
        offset = [
            c + (0.5 * pitch if n % 2 == 0 else 0.0)
            for c, n in zip(self.centre_in, self.source.shape, strict=True)
        ]
        phase = sum(2.0 * math.pi * f * x for f, x in zip(cycles, offset, strict=True))
        twiddle = phasor_of(-phase if kind == 2 else phase)
        data = np.ascontiguousarray(values, dtype=np.complex128)
        transform = getattr(finufft, f"nufft{len(points)}d{kind}")
        # Relative accuracy of the non-uniform Fourier sums.
        accuracy = 1e-13
        if kind == 2:
            return np.asarray(transform(*points, data, eps=accuracy, isign=-1) * twiddle)
        shape = self.source.shape if len(points) == 2 else self.source.shape[0]
        return np.asarray(transform(*points, data * twiddle, shape, eps=accuracy, isign=1))

    @property
    def seconds(self) -> float:
        """Predicted time of one use on this machine."""
        return WAVE_SECONDS[self.source.is_line] * self.samples

    @property
    def peak_bytes(self) -> int:
        """Peak memory of one use, without its result."""
        return WAVE_BYTES * self.samples

    def measure(self, values: Any) -> dict[str, float]:
        """Return the fractions of the field's energy that the samples cannot represent, by name."""
        dimensions = len(self.source.shape)
        for axis, (n, carrier) in enumerate(zip(self.source.shape, self.carrier, strict=True)):
            x = Samples(0.0, self.source.pitch_mm, n).offsets()
            values = values * along(phasor_of(-TURN * carrier * x), axis, dimensions)
        power = abs(scipy.fft.fftn(values, workers=-1)) ** 2
        total = float(np.sum(power))
        if not math.isfinite(total):
            raise InputError("the field has values that are not finite")
        base = fft_frequencies(self.source.shape, self.source.pitch_mm)
        cycles = [f + carrier for f, carrier in zip(base, self.carrier, strict=True)]
        turned, axial, forwards = self.directions(cycles, self.rotation.T)
        lost = (axial <= 0.0) | (forwards <= 0.0)
        edge, fine, wide = lost & ~lost, lost & ~lost, lost & ~lost
        cosine = float(self.rotation[2, 2])
        half_in = max(w + abs(c) for w, c in zip(self.source.half_widths_mm, self.centre_in, strict=True))
        for axis, (across, out) in enumerate(zip(base, turned, strict=True)):
            edge = edge | (abs(across) > EDGE * 0.5 / self.source.pitch_mm)
            fine = fine | (abs(out) > 0.5 / self.target.pitch_mm * (1.0 + 1e-9))
            slope = abs(out) / np.where(lost, np.ones_like(forwards), forwards)
            reach = half_in * (1.0 + slope * math.sqrt(1.0 - cosine**2))
            wide = wide | (reach > self._half_field_mm(axis))

        masks = {"edge": edge, "lost": lost, "wide": wide & ~lost, "fine": fine & ~lost}
        none = np.zeros_like(power)
        return {
            name: float(np.sum(np.where(mask, power, none))) / max(total, 1e-300)
            for name, mask in masks.items()
        }

    def check(self, values: Any, coarse_output: bool) -> None:
        """Warn, or raise SamplingError, where the samples cannot represent the field."""
        parts = self.measure(values)
        pitch_in, pitch_out = 1e3 * self.source.pitch_mm, 1e3 * self.target.pitch_mm
        report_loss(
            parts["edge"],
            f"lies at the edge of the Nyquist band of a pitch of {pitch_in:.4g} um",
            "sample the field more finely, or smooth its edges",
        )
        report_loss(
            parts["lost"], "is evanescent, or does not cross the tilted plane forwards", "use a smaller tilt"
        )
        report_loss(
            parts["wide"],
            f"reaches the tilted plane more than {WIDEST / 2:g} half-widths away",
            "use a smaller tilt or a narrower field",
        )
        if not coarse_output:
            report_loss(
                parts["fine"],
                f"has frequencies above the Nyquist limit of the output pitch of {pitch_out:.4g} um",
                f"give a pitch of {1e3 * self._finest_mm():.4g} um or less, or accept coarse samples "
                "(coarse_output=True)",
            )

    def _finest_mm(self) -> float:
        """Return the pitch that samples the whole band of the source."""
        return 0.5 / max(abs(f.centre) + 0.5 * f.step * f.count for f in self.frequencies)


def _rotation(grid: Grid, tilt_deg: tuple[float, float]) -> Array:
    about_x, about_y = tilt_deg
    if not (abs(about_x) < 90.0 and abs(about_y) < 90.0):
        raise InputError(f"tilt_deg = {tilt_deg}: both must lie between -90 and 90 deg")
    if grid.is_line and about_y != 0.0:
        raise InputError(f"tilt_deg = {tilt_deg}: a meridional line has only a tilt about x")
    return rotation_matrix(np.deg2rad(about_x), np.deg2rad(about_y))
