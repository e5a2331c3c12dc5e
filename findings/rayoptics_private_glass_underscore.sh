#!/usr/bin/env bash
# ray-optics does not find a private glass of a CODE V file whose name has an underscore.
#
# Guess from memory: a glass that the block PRV of the file defines is found by its name, whatever the name is.
# Seen (ray-optics 0.9.8): GlassCatalogNotFoundError for 'MINE_1', whose last part is taken for a catalogue. The same
# file with the name 'MINE1' has the index that it states.
# Why it matters: names with an underscore are common, and the message names the number behind it.
source "$(dirname "${BASH_SOURCE[0]}")/inputs.sh"
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
install_rayoptics
private_glass_lens MINE_1 > underscore.seq
private_glass_lens MINE1 > plain.seq
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
