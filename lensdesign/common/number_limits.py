"""Limits of numbers in files and settings, checked before anything is computed from them.

There are two pairs of limits, because the computations have two precisions:

- Values of design and study files are used in double precision, whose range is 1e-308 to 1e308. Tolerances
  may be far smaller than anything that can be manufactured: a study with such tolerances predicts a yield of
  100 % and serves as a check.
- Settings of a simulation scale arrays in single precision, whose range is 1e-38 to 3e38.

A common pair would refuse legitimate tolerances, or accept settings whose cubes overflow.
"""

from __future__ import annotations

SMALLEST_IN_FILES, LARGEST_IN_FILES = 1e-60, 1e9
"""Range of sizes in design and study files, in any unit; fifth powers of both ends are normal doubles."""

SMALLEST_SETTING, LARGEST_SETTING = 1e-12, 1e12
"""Range of absolute values of settings other than 0; cubes of both ends are representable in float32."""
