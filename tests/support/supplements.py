"""Values that complete the lens files of tests."""

from __future__ import annotations

from lensdesign.files.draft import Supplement

SENSOR = Supplement(pixel_pitch_um=3.2, pixels=(1000, 800))
SUPPLEMENT = Supplement(
    working_distance_mm=100.0,
    field_diameter_mm=1.0,
    numerical_aperture=0.02,
    pixel_pitch_um=3.2,
    pixels=(1000, 800),
)
