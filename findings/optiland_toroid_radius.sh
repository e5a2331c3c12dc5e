#!/usr/bin/env bash
# Optiland loses the radius of rotation of a toroid in a Zemax file, and reads its terms one order too low.
#
# Guess from memory: PARM 1 of TOROIDAL is the radius of rotation in mm, PARM 2 the coefficient of y^2, PARM 3 of y^4.
# Seen (Optiland 0.6.3): the reader takes the next value for each. The radius is infinite, so the toroid becomes a
# cylinder, and PARM 3 becomes the coefficient of y^2.
# Why it matters: the power of one section is gone, without a message. (The writer puts 1 / radius into PARM 1.)
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_optiland
cat > toroid.zmx <<'LENS'
VERS 191106 258 36214
MODE SEQ
NAME lens
UNIT MM X W X CM MR CPMM
ENPD 10
GCAT SCHOTT
FTYP 0 0 1 1 0 0 0
XFLN 0
YFLN 0
WAVM 1 0.5876 1
PWAV 1
SURF 0
  TYPE STANDARD
  CURV 0.0 0 0 0 0
  DISZ INFINITY
SURF 1
  STOP
  TYPE TOROIDAL
  CURV 0.02 0 0 0 0
  PARM 1 60
  PARM 2 0
  PARM 3 1e-6
  DISZ 5
  GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0
SURF 2
  TYPE STANDARD
  CURV -0.02 0 0 0 0
  DISZ 45
SURF 3
  TYPE STANDARD
  CURV 0.0 0 0 0 0
  DISZ 0
LENS
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
