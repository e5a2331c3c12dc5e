#!/usr/bin/env bash
# ray-optics ignores the primary wavelength of a Zemax file and takes the middle one of the list.
#
# Guess from memory: PWAV 1 makes the first wavelength the reference, at which focal lengths are stated.
# Seen (ray-optics 0.9.8): PWAV is not supported. The reference is the wavelength in the middle of the list, here
# 486.1 nm, and the focal length is that at this wavelength (48.693 mm, not 49.213 mm).
# Why it matters: focal lengths differ by the longitudinal colour, without a message. CODE V files (REF) are read right.
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_rayoptics
cat > three.zmx <<'LENS'
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
WAVM 2 0.4861 1
WAVM 3 0.6563 1
PWAV 1
SURF 0
  TYPE STANDARD
  CURV 0.0 0 0 0 0
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.02 0 0 0 0
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
from pathlib import Path

from rayoptics.zemax.zmxread import read_lens_file

print("ray-optics", version("rayoptics"))

model = read_lens_file(Path("three.zmx"))[0]
spectrum = model.optical_spec.spectral_region
reference_nm = spectrum.wavelengths[spectrum.reference_wvl]
efl = float(model["analysis_results"]["parax_data"].fod.efl)
print(f"reference {reference_nm:.1f} nm (expected: 587.6); focal length {efl:.3f} mm (expected: 49.213)")
sys.exit(0 if abs(reference_nm - 486.1) < 0.01 and abs(efl - 48.693) < 0.01 else 1)
PYTHON
