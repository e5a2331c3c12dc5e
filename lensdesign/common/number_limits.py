"""The limits of usable numbers: values beyond them are refused before anything is computed from them.

There are two pairs, because what follows from the numbers is computed in two precisions:

- Values of design and study files go through rays and statistics in double precision, which ends near 1e-308
  and 1e308. Tolerances may be far smaller than anything that can be made: a study with such tolerances
  predicts lenses that are all good, and is used as a check.
- Settings of a simulation scale arrays of single precision, which ends near 1e-38 and 3e38.

One pair for both would refuse legitimate tolerances, or let through settings whose cubes overflow.
"""

from __future__ import annotations

SMALLEST_IN_FILES, LARGEST_IN_FILES = 1e-60, 1e9
"""Sizes of any unit in design and study files: fifth powers of both ends are finite in double precision."""

SMALLEST_SETTING, LARGEST_SETTING = 1e-12, 1e12
"""Absolute values of settings that are not 0: the cube of either end is a number in single precision."""
