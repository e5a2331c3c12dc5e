#!/usr/bin/env bash
# Optiland reads and writes the letter A of an asphere in a CODE V file as the coefficient of r^2.
#
# Guess from memory: in CODE V, A to J are the coefficients of r^4 to r^20, and an asphere is marked by ASP.
# Seen (Optiland 0.6.3): A becomes the coefficient of r^2 and B that of r^4. The writer uses the same order, and writes
# no ASP. Its own files come back as they were, but mean another surface in CODE V.
# Why it matters: an asphere from or for another program is wrong by orders of magnitude, without a message.
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_optiland
cat > asphere.seq <<'LENS'
RDM;LEN
TITLE 'singlet'
EPD 10
DIM M
WL 587.6
REF 1
XAN 0
YAN 0
SO 0.0 1e11
S 50.0 5.0 NBK7_SCHOTT
  STO
  ASP
  K 0.0
  A 1e-5
S -50.0 45.0
SI 0.0 0.0
GO
LENS
venv/bin/python - <<'PYTHON'
import logging
import sys
import warnings

warnings.simplefilter("ignore")
logging.disable(logging.CRITICAL)
from importlib.metadata import version

from optiland.fileio import load_codev_file, save_codev_file

print("Optiland", version("optiland"))

from optiland.optic import Optic

surface = load_codev_file("asphere.seq").surfaces[1]
base = 50.0 - (50.0**2 - 25.0) ** 0.5
term = float(surface.geometry.sag(0.0, 5.0)) - base
print(f"A 1e-5 at r = 5 mm adds {term:.6g} mm (expected: 1e-5 r^4 = 0.00625; 1e-5 r^2 = 0.00025)")
lens = Optic()
lens.surfaces.add(index=0, thickness=float("inf"))
lens.surfaces.add(
    index=1, radius=50.0, thickness=45.0, is_stop=True, surface_type="even_asphere", coefficients=[0.0, 1e-5]
)
lens.surfaces.add(index=2)
lens.set_aperture(aperture_type="EPD", value=10.0)
lens.fields.set_type(field_type="angle")
lens.fields.add(y=0.0)
lens.wavelengths.add(value=0.5876, is_primary=True)
save_codev_file(lens, "written.seq")
words = [line.split() for line in open("written.seq")]
letter = next(word[0] for word in words if len(word) == 2 and word[1].startswith("1e-05"))
marked = ["ASP"] in words
print(f"the coefficient of r^4 is written as {letter} (expected: A), with ASP: {marked} (expected: True)")
sys.exit(0 if abs(term - 0.00025) < 1e-9 and letter == "B" and not marked else 1)
PYTHON
