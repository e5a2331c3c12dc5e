#!/usr/bin/env bash
# ray-optics does not find a private glass of a CODE V file whose name has an underscore.
#
# Guess from memory: a glass that the block PRV of the file defines is found by its name, whatever the name is.
# Seen (ray-optics 0.9.8): GlassCatalogNotFoundError for 'MINE_1', whose last part is taken for a catalogue. The same
# file with the name 'MINE1' has the index that it states.
# Why it matters: names with an underscore are common, and the message names the number behind it.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
python3 -m venv "$folder/venv"
"$folder/venv/bin/pip" install --quiet --no-deps rayoptics==0.9.8 opticalglass==1.1.1 anytree==2.13.0 \
  json-tricks==3.17.3 transforms3d==0.4.2 parsimonious==0.11.0 regex==2026.11.19 xlrd==2.0.2 openpyxl==3.1.5 et_xmlfile==2.0.0 \
  numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 matplotlib==3.11.2 \
  requests==2.34.2 urllib3==2.8.0 idna==3.20 certifi==2026.10.19.post1 charset-normalizer==3.5.3 PyYAML==6.0.4 \
  python-dateutil==4.0.0 packaging==26.4 pillow==13.0.0 pyparsing==3.3.3 kiwisolver==1.5.1 cycler==0.12.1 \
  fonttools==4.68.0 contourpy==1.3.3
cd "$folder"
cat > underscore.seq <<'LENS'
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
'MINE_1' 1.6
END
SO 0.0 1e11
S 50.0 5.0 'MINE_1'
  STO
S -50.0 45.0
SI 0.0 0.0
GO
LENS
cat > plain.seq <<'LENS'
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
for name in ("underscore", "plain"):
    try:
        model = read_lens(Path(f"{name}.seq"))[0]
        seen[name] = round(float(model.seq_model.gaps[1].medium.rindex(587.6)), 6)
    except Exception as error:  # its class is not public
        seen[name] = type(error).__name__
    print(f"{name}: {seen[name]} (expected: index 1.6)")
sys.exit(0 if seen == {"underscore": "GlassCatalogNotFoundError", "plain": 1.6} else 1)
PYTHON
