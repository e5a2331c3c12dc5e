#!/usr/bin/env bash
# Optiland reads a private glass of a CODE V file as air.
#
# Guess from memory: a glass that the block PRV defines by its index has that index, or the file is refused.
# Seen (Optiland 0.6.3): a warning that PRV is not supported; the surface then has an index of 1.
# Why it matters: scripts that filter warnings get a lens without power. A model glass in the file (1.6:60) is read.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-deps optiland==0.6.3 numba==0.68.1 llvmlite==0.50.0 vtk==9.7.2 \
  numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 matplotlib==3.11.2 \
  requests==2.34.2 urllib3==2.8.0 idna==3.20 certifi==2026.10.19.post1 charset-normalizer==3.5.3 PyYAML==6.0.4 \
  python-dateutil==4.0.0 packaging==26.4 pillow==13.0.0 pyparsing==3.3.3 kiwisolver==1.5.1 cycler==0.12.1 \
  fonttools==4.68.0 contourpy==1.3.3
cd "$folder"
cat > private.seq <<'LENS'
RDM;LEN
TITLE 'singlet'
EPD 10
DIM M
WL 587.6
REF 1
XAN 0
YAN 0
PRV
PWL 587.6
'MINE1' 1.6
END
SO 0.0 1e11
S 50.0 5.0 'MINE1'
  STO
S -50.0 45.0
SI 0.0 0.0
GO
LENS
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
