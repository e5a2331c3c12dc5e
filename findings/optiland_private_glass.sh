#!/usr/bin/env bash
# Optiland reads a private glass of a CODE V file as air.
#
# Guess from memory: a glass that the block PRV defines by its index has that index, or the file is refused.
# Seen (Optiland 0.6.3): a warning that PRV is not supported; the surface then has an index of 1.
# Why it matters: scripts that filter warnings get a lens without power. A model glass in the file (1.6:60) is read.
source "$(dirname "${BASH_SOURCE[0]}")/inputs.sh"
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_optiland
private_glass_lens MINE1 > private.seq
cat > model.seq <<'LENS'
RDM;LEN
TITLE 'singlet'
EPD 10
DIM M
WL 587.6
REF 1
XAN 0
YAN 0
SO 0.0 1e11
S 50.0 5.0 1.6:60
  STO
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

import numpy as np
from optiland.fileio import load_codev_file

print("Optiland", version("optiland"))

seen = {}
for name in ("private", "model"):
    seen[name] = round(float(np.ravel(load_codev_file(f"{name}.seq").surfaces[1].material_post.n(0.5876))[0]), 3)
    print(f"{name} glass: index {seen[name]} (expected: 1.6)")
sys.exit(0 if seen == {"private": 1.0, "model": 1.6} else 1)
PYTHON
