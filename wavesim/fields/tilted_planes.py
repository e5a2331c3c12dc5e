"""Free space to and from tilted planes, by two methods.

:class:`RotatedSpectrum` is for any tilt and any light. A plane wave is a plane wave on every plane. A
rotation of the frame rotates its wave vector and multiplies the density of the spectrum by the Jacobian
kz / kz' (Matsushima, Schimmel and Wyrowski 2003). The rotated frequencies do not coincide with the samples of
the spectrum; a non-uniform Fourier sum evaluates the spectrum there exactly.

A field on a tilted plane is defined in the plane's own frame. Its origin is the pivot, its axes are rotated
by a right-handed rotation about x, then about the rotated y axis, and its z is 0. The pivot is the centre of
the grid on the untilted plane. On a meridional line only a tilt about x is possible.

:class:`TiltedPropagator` is for tilts of some degrees, and light within the pixels' band. It is fast enough
for reconstructions. A tilt by a small angle displaces each point of a plane along nearly the axis, in
proportion to its distance from the axis of rotation. The field on the tilted plane follows from the fields on
a few planes that are shifted along this direction, by Lagrange interpolation in the displacement. Once the
phase that all waves have in common is removed, waves within some degrees of each other differ by a fraction
of a radian over it. Two successive tilts also rotate the plane about its own normal, by half their product.
One further plane, shifted within itself, accounts for this rotation. The approximation is accurate to 1e-3
while the product of both tilts is below 7 square degrees.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import DTypeLike, NDArray

from lensdesign.common.arrays import Array
from lensdesign.errors import InputError
from lensdesign.lens.poses import rotation_matrix
from wavesim.fields.angular_spectrum import TransferFunction
from wavesim.fields.chirp_z import chirp_z_transform
from wavesim.fields.field import Grid
from wavesim.fields.plane_waves import FADE_ZONES, Samples, along, centres_mm, phasor_of

ComplexArray = NDArray[np.complexfloating[Any, Any]]

WIDEST = 4.0
"""Width on the tilted plane, in half-widths of the input window, within which light is followed."""
WAVE_SECONDS, WAVE_BYTES = {True: 2e-6, False: 6.5e-7}, 200
"""Time for each sample of the spectrum of a line and of a plane, measured on two cores, and memory."""
MOST_PLANES = 15
"""Most parallel planes that :class:`TiltedPropagator` interpolates."""


class RotatedSpectrum:
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
        self.counts = tuple(f.count for f in self.frequencies)
        self.samples = math.prod(self.counts)

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

    def half_field_mm(self, axis: int) -> float:
        """Return the half-width, about the pivot, of the region that is followed on the target plane."""
        half = max(w + abs(c) for w, c in zip(self.source.half_widths_mm, self.centre_in, strict=True))
        cosine = float(self.rotation[2, 2])
        blur = math.sqrt(1e-3 * self.wavelength_um / self.index * half * math.sqrt(1.0 - cosine**2))
        return 0.5 * WIDEST * half / cosine + FADE_ZONES * blur

    def _period_mm(self, axis: int) -> float:
        window = self.target.half_widths_mm[axis] + abs(self.centre_out[axis])
        return self.half_field_mm(axis) + window

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

    @property
    def finest_pitch_mm(self) -> float:
        """Return the pitch that samples the whole band of the source."""
        return 0.5 / max(abs(f.centre) + 0.5 * f.step * f.count for f in self.frequencies)


def _rotation(grid: Grid, tilt_deg: tuple[float, float]) -> Array:
    about_x, about_y = tilt_deg
    if not (abs(about_x) < 90.0 and abs(about_y) < 90.0):
        raise InputError(f"tilt_deg = {tilt_deg}: both must lie between -90 and 90°")
    if grid.is_line and about_y != 0.0:
        raise InputError(f"tilt_deg = {tilt_deg}: a meridional line has only a tilt about x")
    return rotation_matrix(np.deg2rad(about_x), np.deg2rad(about_y))


class TiltedPropagator:
    """Free space to a plane that is tilted about the centre of its grid, by a few degrees at most.

    The operator is linear in the field and has an exact adjoint. It omits the phase of the centre of the
    band, so that the field on the tilted plane is correct except for a phase at each point.

    Parameters
    ----------
    grid, wavelength_um, distance_mm, dtype, shift_mm
        As in :class:`wavesim.fields.angular_spectrum.TransferFunction`.
    tilt_deg : (x, y)
        Right-handed rotation of the second plane about x, then about the rotated y axis.

    Attributes
    ----------
    tilt_deg : (x, y)
        The given tilt.
    propagators : list of TransferFunction
        Propagators to the parallel planes.

    Raises
    ------
    InputError
        If the grid is a line, or the tilt needs more than `MOST_PLANES` planes.
    """

    is_identity = False

    def __init__(
        self,
        grid: Grid,
        wavelength_um: float,
        distance_mm: float,
        dtype: DTypeLike,
        tilt_deg: tuple[float, float],
        shift_mm: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        if grid.is_line:
            raise InputError(f"tilt_deg = {tilt_deg}: must be 0 on a meridional line")
        rotation = rotation_matrix(*np.deg2rad(tilt_deg))
        # Displacement of a point (x, y) of the plane: along the axis it depends only on the coordinate along
        # `uphill`, the direction of steepest rise.
        moved = rotation[:, :2] - np.eye(3)[:, :2]
        uphill = moved[2] / math.hypot(*moved[2])
        level = np.array([-uphill[1], uphill[0]])
        half = np.array(grid.half_widths_mm[::-1])
        self.tilt_deg = tilt_deg
        self._grid, self._dtype = grid, np.dtype(dtype)
        self._uphill, self._level = uphill, level
        along, across = moved @ uphill, moved @ level
        reach, side = float(np.abs(uphill) @ half), float(np.abs(level) @ half)
        middle, differing = band_wavenumbers(grid, wavelength_um)
        phase = reach * (differing * abs(along[2]) + math.pi / grid.pitch_mm * math.hypot(*along[:2]))
        count = _count(phase, tilt_deg)
        self._nodes = reach * np.cos(np.pi * (np.arange(count) + 0.5) / count)
        self._nodes[count // 2] = 0.0
        self._phasors = np.exp(-1j * middle * along[2] * self._nodes)
        displacements = [along * node for node in self._nodes]
        self._side = 0.0
        # Largest displacement, in pitches, by the rotation about the normal that is neglected.
        least_rotation = 1e-3
        if side * math.hypot(*across) > least_rotation * grid.pitch_mm:
            self._side = side
            displacements.append(across * side)
        x_mm, y_mm = shift_mm
        self.propagators = [
            TransferFunction(
                grid, wavelength_um, distance_mm + float(z), dtype, (x_mm + float(x), y_mm + float(y))
            )
            for x, y, z in displacements
        ]

    def weights(self, index: int, rows: slice, row_offset: float = 0.0) -> ComplexArray:
        """Return the weights of one parallel plane on some rows of samples, shape (rows, nx).

        `row_offset` shifts the rows along y, in samples.
        """
        height, width = self._grid.shape
        pitch_mm = self._grid.pitch_mm
        y = pitch_mm * (np.arange(rows.start, rows.stop) + row_offset - 0.5 * (height - 1))[:, None]
        x = pitch_mm * (np.arange(width) - 0.5 * (width - 1))
        sideways = (self._level[0] * x + self._level[1] * y) / self._side if self._side else 0.0
        nodes = self._nodes
        if index == len(nodes):
            return np.asarray(sideways, self._dtype)
        height_mm, own = self._uphill[0] * x + self._uphill[1] * y, nodes[index]
        weight = np.ones(height_mm.shape)
        for other in np.delete(nodes, index):
            weight *= (height_mm - other) / (own - other)
        if index == len(nodes) // 2:
            weight -= sideways
        return np.asarray(weight * self._phasors[index], self._dtype)

    def forward(self, spectrum: ComplexArray) -> ComplexArray:
        """Return the field on the second plane from its spectrum on the first."""
        total = np.zeros_like(spectrum)
        for index, propagator in enumerate(self.propagators):
            total += propagator.forward(spectrum) * self.weights(index, slice(0, len(total)))
        return total

    def adjoint(self, values: ComplexArray) -> ComplexArray:
        """Return the adjoint of :meth:`forward`, for equal weights of a spectrum and the field of it."""
        total = np.zeros_like(values)
        for index, propagator in enumerate(self.propagators):
            total += propagator.adjoint(values * self.weights(index, slice(0, len(total))).conj())
        return total


def band_wavenumbers(grid: Grid, wavelength_um: float) -> tuple[float, float]:
    """Return kz (1/mm) in the centre of the grid's band, and the largest deviation from it."""
    most = 2e3 * math.pi / wavelength_um
    least = math.sqrt(max(most**2 - 2.0 * (math.pi / grid.pitch_mm) ** 2, 0.0))
    return 0.5 * (most + least), 0.5 * (most - least)


def _count(phase: float, tilt_deg: tuple[float, float]) -> int:
    """Return the number of planes (odd, Chebyshev nodes) for waves that differ by a phase at the rim."""
    # Largest error of the band's steepest wave at the worst point; the whole field is more accurate.
    accuracy = 1e-3
    for count in range(3, MOST_PLANES + 1, 2):
        if phase**count / (math.factorial(count) * 2.0 ** (count - 1)) <= accuracy:
            return count
    raise InputError(
        f"tilt_deg = {tilt_deg}: the phase varies by {phase:.3g} rad at the sensor's edge, too much for "
        "this method; use a smaller tilt or a smaller window of the sensor"
    )
