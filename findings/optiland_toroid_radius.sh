#!/usr/bin/env bash
# Optiland loses the radius of rotation of a toroid in a Zemax file, and reads its terms one order too low.
#
# Guess from memory: PARM 1 of TOROIDAL is the radius of rotation in mm, PARM 2 the coefficient of y^2, PARM 3 of y^4.
# Seen (Optiland 0.6.3): the reader takes the next value for each. The radius is infinite, so the toroid becomes a
# cylinder, and PARM 3 becomes the coefficient of y^2.
# Why it matters: the power of one section is gone, without a message. (The writer puts 1 / radius into PARM 1.)
source "$(dirname "${BASH_SOURCE[0]}")/inputs.sh"
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_optiland
toroid_lens > toroid.zmx
venv/bin/python - <<'PYTHON'
import logging
import sys
import warnings

warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)
from importlib.metadata import version

from optiland.fileio import load_zemax_file

print("Optiland", version("optiland"))

geometry = load_zemax_file("toroid.zmx").surfaces[1].geometry
radius = float(geometry.R_rot)
coefficients = [float(a) for a in geometry.coeffs_poly_y]
power = 2 * (next(i for i, a in enumerate(coefficients) if a) + 1)
print(f"radius of rotation {radius} mm (expected: 60); PARM 3 is the coefficient of y^{power} (expected: y^4)")
sys.exit(0 if radius == float("inf") and power == 2 else 1)
PYTHON
