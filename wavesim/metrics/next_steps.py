"""What a verdict advises to do next, for each cause of a result that is not to be trusted."""

from __future__ import annotations

ADVICE = {
    "planes swapped": "give the frames the distances of their planes in the other order",
    "orientation": "turn or mirror the pictures of that plane as the other planes' pictures are",
    "shift": "run `wavesim calibrate`: it finds the shift of each plane",
    "mounting": "run `wavesim calibrate`: it finds decenter and tilt of the lens",
    "working distance": "measure the object's distance anew, or run `wavesim calibrate`",
    "pixel pitch": "compare the pitch that frames and design state with the camera's data sheet",
    "lens": "compare design and wavelength with what is mounted; run `wavesim calibrate`",
    "distance": "measure the plane's distance anew, or run `wavesim calibrate`",
    "background": "block stray light, or run `wavesim calibrate`: it finds each plane's background",
    "field stop position": "measure the field stop, and give --field-stop-at-mm and --field-stop-mm",
    "field stop": "give --field-stop-at-mm and --field-stop-mm, or --field-stop find",
    "light": "run `wavesim calibrate`: it finds the light's direction and shape",
    "source": "state the width of the source (--source-deg), or let width and bandwidth, which blur alike, "
    "be found (--source-deg find --bandwidth-nm find)",
    "bandwidth": "state the bandwidth (--bandwidth-nm), let both widths, which blur alike, be found "
    "(--source-deg find --bandwidth-nm find), or narrow the band with a filter",
    "vibration": "mount the camera more firmly, expose for a shorter time, or run `wavesim calibrate`",
    "iterations": "give more --iterations",
    "noise parameters": "compare read noise, gain and offset with the camera's data sheet; use raw pictures",
    "several objects": "record more planes, farther from each other, or state more of the object (--kind)",
    "phase ramp": "measure the light's direction and the planes' shifts, and state them: a prism in the "
    "object, tilted light and a shifted plane give the same frames",
    "not judged": "run the same command again to judge the result",
    "not requested": "run the same command without --verdict none to judge the result",
    "lens or light": "run `wavesim calibrate`; compare the design with the lens that is mounted",
}


STOP_CAUSE = "field stop position"
"""Cause of a result whose field stop was found on a bench that turned out to be wrong."""


def next_step(cause: str, *, calibrated: bool = False) -> str:
    """Return the next step for a cause in words; empty if there is none.

    Parameters
    ----------
    cause
        Name of the cause.
    calibrated
        Whether the bench was calibrated before, so that a calibration is not advised.
    """
    step = ADVICE.get(cause, "")
    if calibrated and "wavesim calibrate" in step:
        return (
            "the calibration does not hold for these frames or does not contain the cause: compare design, "
            "light and camera with what is mounted, or calibrate with more parameters (--parameters all)"
        )
    return step
