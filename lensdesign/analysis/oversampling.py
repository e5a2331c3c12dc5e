"""Oversampling ratio of a recording: measurements on its pixels for each unknown of the object.

Eq. 1 of the paper asks that the sensor holds as many degrees of freedom as the object. A recording needs
more: a pixel measures one real number, an intensity, and the phase of the light has to be found from such
numbers. The oversampling ratio extends Eq. 1 by counting both sides as real numbers::

    ratio = measurements / unknowns
    measurements = sum over frames of min(pixels in the light, 4 N_light)
    unknowns = N_object x (1 for amplitude or phase, 2 for complex) x layers x wavelengths

N_object is the space-bandwidth product of the object within its support. The light of a field with N degrees
of freedom has an intensity with 4 N of them, since the spectrum of an intensity is the autocorrelation of
that of the field. Finer pixels than these add no measurements.

For random measurements, theory gives the following limits of the ratio: 1 for a solution, both for real and
for complex unknowns [2]_; 1.01 (complex) and 1.13 (real) for its best known algorithm [2]_; and 2 for a
solution that is unique for every object [1]_ [3]_. A lens is not random, and
:func:`wavesim.calibration.plan_frames` measures what its planes need.

References
----------
.. [1] R. Balan, P. Casazza, D. Edidin, "On signal reconstruction without phase", Appl. Comput. Harmon. Anal.
   20, 345 (2006): 2 N - 1 measurements of N real unknowns.
.. [2] A. Maillard, B. Loureiro, F. Krzakala, L. Zdeborova, "Phase retrieval in high dimensions: statistical
   and computational phase transitions", NeurIPS 33 (2020).
.. [3] A. Conca, D. Edidin, M. Hering, C. Vinzant, "An algebraic characterization of injectivity in phase
   retrieval", Appl. Comput. Harmon. Anal. 38, 346 (2015): 4 N - 4 measurements of N complex unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

from lensdesign.analysis.exit_beam import footprint
from lensdesign.analysis.space_bandwidth import sbp_object
from lensdesign.errors import InputError, validate_choice, validate_positive, validate_whole_number
from lensdesign.lens.lens import Lens

ObjectKind = Literal["amplitude", "phase", "complex"]
"""Kind of an object: real transmission, transmission of modulus 1, or any transmission."""

UNKNOWNS_OF_KIND: dict[ObjectKind, int] = {"amplitude": 1, "phase": 1, "complex": 2}
"""Real unknowns for each degree of freedom of the object's light."""

INTENSITY_DEGREES = 4
"""Degrees of freedom of an intensity, over those of its field."""


@dataclass(frozen=True)
class Oversampling:
    """Measurements and unknowns of a recording.

    Attributes
    ----------
    kind : str
        Kind of the object: "amplitude", "phase" or "complex".
    support_mm : float
        Diameter of the part of the object that is not known beforehand.
    wavelengths_um : tuple of float
        Vacuum wavelengths, each with an object of its own.
    layers : int
        Number of layers of the object.
    plane_distances_mm : tuple of float
        Distance of each recording plane from the exit vertex.
    measurements_of_planes : tuple of float
        Measurements on each plane, at all wavelengths.
    unknowns : float
        Real unknowns of the object.
    """

    kind: ObjectKind
    support_mm: float
    wavelengths_um: tuple[float, ...]
    layers: int
    plane_distances_mm: tuple[float, ...]
    measurements_of_planes: tuple[float, ...]
    unknowns: float

    @property
    def measurements(self) -> float:
        """Real measurements on all planes."""
        return sum(self.measurements_of_planes)

    @property
    def ratio(self) -> float:
        """Measurements for each unknown."""
        return self.measurements / self.unknowns

    @property
    def ratio_of_planes(self) -> tuple[float, ...]:
        """Measurements of each plane alone for each unknown."""
        return tuple(one / self.unknowns for one in self.measurements_of_planes)

    def planes_for(self, ratio: float) -> int:
        """Return the number of planes, with as many measurements each as these, that reach a ratio."""
        mean = self.ratio / len(self.plane_distances_mm)
        return max(1, math.ceil(ratio / mean - 1e-9))


def real_unknowns(
    kind: ObjectKind,
    support_mm: float,
    numerical_aperture: float,
    wavelengths_um: Sequence[float],
    layers: int = 1,
) -> float:
    """Return the number of real unknowns of an object.

    Parameters
    ----------
    kind
        "amplitude", "phase" or "complex".
    support_mm
        Diameter of the part of the object that is unknown.
    numerical_aperture
        Numerical aperture of the lens in front.
    wavelengths_um
        Vacuum wavelengths, each with an object of its own. A thickness that all wavelengths share counts
        once: give one wavelength.
    layers
        Number of layers of the object.

    Raises
    ------
    InputError
        If a value is out of range.

    Examples
    --------
    >>> f"{real_unknowns('complex', 3.0, 0.5, [0.532]):.3g}"
    '3.92e+07'
    """
    validate_choice("kind", kind, tuple(UNKNOWNS_OF_KIND))
    validate_positive("support_mm", support_mm)
    for wavelength in wavelengths_um:
        validate_positive("wavelengths_um", wavelength)
    validate_whole_number("layers", layers, 1)
    degrees = sum(sbp_object(support_mm, numerical_aperture, wavelength) for wavelength in wavelengths_um)
    return degrees * UNKNOWNS_OF_KIND[kind] * layers


def measurements_in_light(
    light_diameter_mm: float,
    sensor_sides_mm: Sequence[float],
    pixel_pitch_um: float,
    degrees_of_freedom: float,
) -> float:
    """Return the real measurements of one frame: pixels in the light, or fewer if pixels are very fine.

    Parameters
    ----------
    light_diameter_mm
        Diameter of the disc of light on the sensor, about its centre.
    sensor_sides_mm
        Sides of the sensor; only light on its inscribed circle counts, as in Eq. 1.
    pixel_pitch_um
        Pixel pitch.
    degrees_of_freedom
        Space-bandwidth product of the light.
    """
    diameter = min(light_diameter_mm, *sensor_sides_mm)
    pixels = math.pi * (0.5 * diameter / (1e-3 * pixel_pitch_um)) ** 2
    return min(pixels, INTENSITY_DEGREES * degrees_of_freedom)


def largest_oversampling(
    kind: ObjectKind,
    light_diameters_mm: Sequence[float],
    pixel_pitch_um: float,
    degrees_of_freedom: float,
) -> float:
    """Return the oversampling ratio of frames that light fills as far as it may, whatever the lens.

    Parameters
    ----------
    kind
        "amplitude", "phase" or "complex".
    light_diameters_mm
        Largest diameter of the light on the sensor, for each frame.
    pixel_pitch_um
        Pixel pitch.
    degrees_of_freedom
        Space-bandwidth product of the object's light.

    Examples
    --------
    No frame gives a complex object more than two measurements for each unknown:

    >>> largest_oversampling("complex", [22.4], 0.1, 1.96e7)
    2.0
    """
    measured = sum(
        measurements_in_light(diameter, (diameter, diameter), pixel_pitch_um, degrees_of_freedom)
        for diameter in light_diameters_mm
    )
    return measured / (UNKNOWNS_OF_KIND[kind] * degrees_of_freedom)


def oversampling_of(
    lens: Lens,
    kind: ObjectKind = "complex",
    *,
    support_mm: float | None = None,
    plane_distances_mm: Sequence[float] | None = None,
    wavelengths_um: Sequence[float] | None = None,
    at_once: bool = False,
    layers: int = 1,
) -> Oversampling:
    """Return the oversampling ratio of a recording with a lens and its sensor.

    Parameters
    ----------
    lens
        The lens with its object and sensor.
    kind
        Kind of the object: "amplitude", "phase" or "complex".
    support_mm
        Diameter of the part of the object that is unknown; default: the field.
    plane_distances_mm
        Distance of each recording plane from the exit vertex; default: the planes of the design. Exposures
        that are merged into one plane count once.
    wavelengths_um
        Vacuum wavelengths, each with an object of its own; default: the first of the design.
    at_once
        Whether all wavelengths reach the same pixels in one frame. Otherwise every plane is recorded at each
        wavelength.
    layers
        Number of layers of the object.

    Raises
    ------
    DesignError
        If no ray passes the lens.
    InputError
        If a value is out of range.

    Examples
    --------
    One plane of the paper's lens has about two measurements for each unknown of an amplitude object:

    >>> from lensdesign import load_design
    >>> lens = load_design("designs/paper_singlet.toml")
    >>> for kind in ("amplitude", "complex"):
    ...     print(kind, round(oversampling_of(lens, kind, plane_distances_mm=(22.0,)).ratio, 2))
    amplitude 1.95
    complex 0.97
    """
    wavelengths = tuple(lens.wavelengths_um[:1] if wavelengths_um is None else wavelengths_um)
    planes = tuple(lens.sensor.plane_distances_mm if plane_distances_mm is None else plane_distances_mm)
    for name, values in (("wavelengths_um", wavelengths), ("plane_distances_mm", planes)):
        if not values:
            raise InputError(f"{name}: needs at least one value")
    field_mm, aperture = lens.object.field_diameter_mm, lens.object.numerical_aperture
    support = field_mm if support_mm is None else support_mm
    unknowns = real_unknowns(kind, support, aperture, wavelengths, layers)
    if support > field_mm * (1.0 + 1e-9):
        raise InputError(f"support_mm = {support:g}: must not exceed the field of {field_mm:g} mm")
    lit = lens.replaced(object=lens.object.replaced(field_diameter_mm=support))
    degrees = [sbp_object(support, aperture, wavelength) for wavelength in wavelengths]

    measured = []
    for distance in planes:
        lights_mm = [2.0 * footprint(lit, wavelength, distance).radius_mm for wavelength in wavelengths]
        if at_once:
            measured.append(_on_sensor(lens, max(lights_mm), sum(degrees)))
        else:
            frames = zip(lights_mm, degrees, strict=True)
            measured.append(sum(_on_sensor(lens, light_mm, own) for light_mm, own in frames))
    return Oversampling(kind, support, wavelengths, layers, planes, tuple(measured), unknowns)


def oversampling_of_kinds(
    lens: Lens, wavelength_um: float, footprint_radius_mm: Sequence[float]
) -> tuple[Oversampling, ...]:
    """Return the oversampling ratio of each kind of object over the whole field, from known footprints.

    The values are those of :func:`oversampling_of`, which traces the rays itself.

    Parameters
    ----------
    lens
        The lens with its object and sensor.
    wavelength_um
        Vacuum wavelength.
    footprint_radius_mm
        Radius of the light on each plane of the design.
    """
    scene, planes = lens.object, lens.sensor.plane_distances_mm
    degrees = sbp_object(scene.field_diameter_mm, scene.numerical_aperture, wavelength_um)
    measured = tuple(_on_sensor(lens, 2.0 * radius, degrees) for radius in footprint_radius_mm)
    return tuple(
        Oversampling(kind, scene.field_diameter_mm, (wavelength_um,), 1, planes, measured, degrees * count)
        for kind, count in UNKNOWNS_OF_KIND.items()
    )


def _on_sensor(lens: Lens, light_diameter_mm: float, degrees_of_freedom: float) -> float:
    """Return the measurements of one frame on the sensor of a lens."""
    sensor = lens.sensor
    return measurements_in_light(light_diameter_mm, sensor.size_mm, sensor.pixel_pitch_um, degrees_of_freedom)
