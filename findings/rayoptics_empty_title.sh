#!/usr/bin/env bash
# ray-optics cannot open a CODE V file whose title is empty.
#
# Guess from memory: TITLE '' is a valid command with an empty text, and is read as such; any reader accepts it.
# Seen (ray-optics 0.9.8): IndexError, list index out of range. The same file without the command opens.
# Why it matters: programs write TITLE '' for a lens that has no title. Delete the line.
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_rayoptics
cat > empty.seq <<'LENS'
RDM;LEN
TITLE ''
EPD 10
DIM M
WL 587.6
REF 1
XAN 0
YAN 0
SO 0.0 1e11
S 50.0 5.0 NBK7_SCHOTT
  STO
S -50.0 45.0
SI 0.0 0.0
GO
LENS
cat > without.seq <<'LENS'
RDM;LEN
EPD 10
DIM M
WL 587.6
REF 1
XAN 0
YAN 0
SO 0.0 1e11
S 50.0 5.0 NBK7_SCHOTT
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
from pathlib import Path

from rayoptics.codev.cmdproc import read_lens

print("ray-optics", version("rayoptics"))

seen = {}
for name in ("empty", "without"):
    try:
        seen[name] = round(float(read_lens(Path(f"{name}.seq"))[0]["analysis_results"]["parax_data"].fod.efl), 3)
    except IndexError as error:
        seen[name] = f"IndexError: {error}"
    print(f"title {name}: {seen[name]} (expected: focal length 49.213)")
sys.exit(0 if seen == {"empty": "IndexError: list index out of range", "without": 49.213} else 1)
PYTHON
