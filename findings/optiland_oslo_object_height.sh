#!/usr/bin/env bash
# Optiland drops the sign of the object height of an OSLO file, so that solves of the chief ray turn around.
#
# Guess from memory: OBH -10 places the object point at y = -10 mm, and the chief ray crosses the stop with a positive
# slope. PYC 3.5 then asks for a height above the axis at the image.
# Seen (Optiland 0.6.3): the chief ray starts at y = +10 mm for OBH -10 as for OBH 10. The same solve gives a distance
# of -106.7 mm where 67.8 mm is right, without a message.
# Why it matters: OSLO saves the height with the sign that the user gave, often a negative one.
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_optiland
cat > below.len <<'LENS'
LEN NEW "chief" 100 4
NAO 0.05
OBH -10
UNI 1.0
TH 200.0
NXT
AST
TH 12.0
NXT
GLA 1.5
RD 60.0
TH 6.0
NXT
AIR
RD -80.0
PYC 3.5
NXT
WV 0.58756
END 4
LENS
cat > above.len <<'LENS'
LEN NEW "chief" 100 4
NAO 0.05
OBH 10
UNI 1.0
TH 200.0
NXT
AST
TH 12.0
NXT
GLA 1.5
RD 60.0
TH 6.0
NXT
AIR
RD -80.0
PYC 3.5
NXT
WV 0.58756
END 4
LENS
venv/bin/python - <<'PYTHON'
import logging
import sys
import warnings

warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)
from importlib.metadata import version

from optiland.fileio import load_oslo_file

print("Optiland", version("optiland"))

# The paraxial ray through the centre of the stop, by hand: slopes 10 / 200, behind the front and the rear surface.
u, n = 10.0 / 200.0, 1.5
y = 12.0 * u
u = (u - (n - 1.0) / 60.0 * y) / n
y += 6.0 * u
u = n * u - (1.0 - n) / -80.0 * y
expected = {"below": (3.5 - y) / u, "above": (3.5 + y) / -u}
seen = {}
for name in expected:
    surfaces = load_oslo_file(f"{name}.len").surfaces
    seen[name] = float(surfaces[4].geometry.cs.z - surfaces[3].geometry.cs.z)
    print(f"object {name} the axis: distance {seen[name]:.4f} mm (expected: {expected[name]:.4f})")
sys.exit(0 if abs(seen["above"] - expected["above"]) < 1e-6 and abs(seen["below"] - seen["above"]) < 1e-9 else 1)
PYTHON
