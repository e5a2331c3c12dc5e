#!/usr/bin/env bash
# ray-optics puts the terms of a toroid of a Zemax file 10 places too high.
#
# Guess from memory: PARM 3 of TOROIDAL is the coefficient of y^4, and becomes the second coefficient of the profile.
# Seen (ray-optics 0.9.8): the reader appends it behind a profile that has ten coefficients of 0 already, and PARM 2
# behind those. PARM 3 becomes the coefficient of y^24. At 5 mm, 1e-6 becomes a sag of 6e10 mm.
# Why it matters: rays miss the surface, or end elsewhere without a message where the coefficient is small.
source "$(dirname "${BASH_SOURCE[0]}")/inputs.sh"
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_rayoptics
toroid_lens > toroid.zmx
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

profile = read_lens_file(Path("toroid.zmx"))[0].seq_model.ifcs[1].profile
place = next(i for i, a in enumerate(profile.coefs) if a)
print(f"radius of rotation {profile.rR} mm (expected: 60)")
print(f"PARM 3 is the coefficient of y^{2 * (place + 1)} (expected: y^4)")
sys.exit(0 if profile.rR == 60.0 and place == 11 and profile.coefs[place] == 1e-6 else 1)
PYTHON
