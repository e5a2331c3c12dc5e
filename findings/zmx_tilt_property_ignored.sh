#!/usr/bin/env bash
# Optiland and ray-optics read a .zmx surface with the property Tilt/Decenter (SCBD) as centred, without a message.
#
# Guess from memory: a tilt is a coordinate break in .zmx files, and readers that know coordinate breaks know all tilts.
# Seen (Optiland 0.6.3, ray-optics 0.9.8): OpticStudio also stores tilts as a property of a surface. The record
# SCBD 1 0 0 0 0.5 2 0 0 decenters the surface by 0.5 mm along y and then tilts it by 2 degrees about x; SCBD 2 0 2
# restores the axes behind it. Both readers drop the records. The chief ray stays on the axis, where a wedge of
# (n - 1)(tilt + decenter / radius) = 1.3 or 0.7 degrees, depending on the sign of the tilt, moves it by more than 0.5 mm.
# Why it matters: a lens with tolerances that were drawn in OpticStudio arrives as a perfect one.
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_optiland
install_rayoptics
venv/bin/python - <<'PYTHON' 2>error.txt || { cat error.txt >&2; exit 1; }
import sys
import warnings
from importlib.metadata import version
from pathlib import Path

warnings.simplefilter("ignore")
import numpy as np

LENS = """VERS 221026 0 123457
MODE SEQ
NAME singlet
UNIT MM X W X CM MR CPMM
ENPD 5
ENVD 20 1 0
GFAC 0 0
GCAT SCHOTT
FTYP 0 0 1 1 0 0 0 1
XFLN 0
YFLN 0
WAVM 1 0.5875618 1
PWAV 1
SURF 0
  TYPE STANDARD
  CURV 0.0 0 0 0 0
  DISZ INFINITY
SURF 1
  STOP
  TYPE STANDARD
  CURV 0.02 0 0 0 0
  DISZ 3
  GLAS ___BLANK 1 0 1.5168 64.17 0 0 0 0 0 0
  DIAM 5 1 0 0 1 ""
SURF 2
  TYPE STANDARD
  CURV -0.02 0 0 0 0
{property}  DISZ 48
  DIAM 5 1 0 0 1 ""
SURF 3
  TYPE STANDARD
  CURV 0.0 0 0 0 0
  DISZ 0
"""
PROPERTY = "  SCBD 1 0 0 0.0 0.5 2.0 0.0 0.0\n  SCBD 2 0 2 0.0 0.5 2.0 0.0 0.0\n"
for name, text in (("centred", ""), ("tilted", PROPERTY)):
    with open(f"{name}.zmx", "w") as file:
        file.write(LENS.replace("{property}", text))

from optiland.fileio import load_zemax_file
from rayoptics.zemax.zmxread import read_lens_file

heights = []
for name in ("centred", "tilted"):
    optic = load_zemax_file(f"{name}.zmx")
    optic.trace_generic(0, 0, 0, 0.0, 0.5875618)
    heights.append(float(np.ravel(optic.surface_group.y)[-1]))
print("Optiland", version("optiland"), "chief ray at the image, mm:", heights)
decenters = [s.decenter for s in read_lens_file(Path("tilted.zmx"))[0].seq_model.ifcs]
print("ray-optics", version("rayoptics"), "decenters of the surfaces:", decenters)
sys.exit(0 if heights[0] == heights[1] == 0.0 and not any(decenters) else 1)
PYTHON
