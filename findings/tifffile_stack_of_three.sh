#!/usr/bin/env bash
# A stack of three frames that tifffile writes is one colour picture, and Pillow reads its 16-bit planes scrambled.
#
# Guess from memory: tifffile.imwrite of an array (frames, rows, columns) of 16 bits writes one grey page for each
# frame, whatever their number, as it does for two and for five frames.
# Seen (tifffile 2026.3.3, Pillow 12.0.0): three frames become one page of RGB in separate planes. A reader that takes
# the tags at their word sees a colour picture. Pillow opens it as RGB of 8 bits without an error. Its red channel holds
# neither the high bytes nor the low bytes of the first frame.
# Why it matters: dark frames and flat fields are often averages of three. State photometric="minisblack" when writing.
source "$(dirname "${BASH_SOURCE[0]}")/environments.sh"
venv/bin/pip install --quiet tifffile==2026.3.3 pillow==12.0.0 numpy==2.3.4
venv/bin/python - <<'PYTHON'
import sys
import warnings

import numpy as np
import PIL
import tifffile
from PIL import Image

warnings.simplefilter("ignore")
print("tifffile", tifffile.__version__, "Pillow", PIL.__version__)
seen = {}
for count in (2, 3, 5):
    stack = np.random.default_rng(0).integers(0, 4096, (count, 24, 37)).astype(np.uint16)
    tifffile.imwrite("stack.tif", stack)
    with tifffile.TiffFile("stack.tif") as file:
        page = file.pages[0]
        seen[count] = (len(file.pages), int(page.photometric), int(page.samplesperpixel))
    print(f"{count} frames: {seen[count][0]} pages, photometric {seen[count][1]}, {seen[count][2]} samples a pixel")
stack = np.random.default_rng(0).integers(0, 4096, (3, 24, 37)).astype(np.uint16)
tifffile.imwrite("stack.tif", stack)
with Image.open("stack.tif") as image:
    mode, red = image.mode, np.asarray(image)[..., 0]
agreement = [float(np.mean(red == byte)) for byte in (stack[0] >> 8, stack[0] & 255)]
print(f"Pillow: mode {mode}; red equals the high byte in {agreement[0]:.0%}, the low byte in {agreement[1]:.0%}")
tifffile.imwrite("grey.tif", stack, photometric="minisblack")
with tifffile.TiffFile("grey.tif") as file:
    grey = len(file.pages)
print(f"with photometric='minisblack': {grey} pages")
expected = {2: (2, 1, 1), 3: (1, 2, 3), 5: (5, 1, 1)}
sys.exit(0 if seen == expected and mode == "RGB" and max(agreement) < 0.9 and grey == 3 else 1)
PYTHON
