"""The lens with its rays, object and sensor planes in 3D: as a picture, and in an interactive window.

Off-screen rendering needs OpenGL libraries, and a window needs a display. Without them, VTK terminates the
whole process; therefore a child process tests rendering first, or opens the window.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lensdesign.common.arrays import Array
from lensdesign.common.atomic_files import atomic_path
from lensdesign.errors import InputError, TransferLensError
from lensdesign.lens.lens import Lens
from lensdesign.plots.labels import PlacedLabel, placed_labels
from lensdesign.plots.scene import SHARP_DEG, ScenePart, scene_parts

if TYPE_CHECKING:
    import pyvista

PROBE = """
import pyvista
plotter = pyvista.Plotter(off_screen=True, window_size=(64, 64))
plotter.add_mesh(pyvista.Cube())
image = plotter.screenshot(None, return_img=True)
raise SystemExit(0 if image.std() > 1.0 else 1)
"""
PROBE_SECONDS = 60.0

VIEW_CHORD_FRACTION = 2e-4
"""Chord error of the glass in pictures, as a fraction of the stop's semi-diameter."""


class RenderingError(TransferLensError):
    """Raised if no 3D view can be rendered on this machine."""


@cache
def rendering_available() -> bool:
    """Return whether this machine can render off-screen; tested once per process in a child process."""
    try:
        child = subprocess.run(
            [sys.executable, "-c", PROBE], timeout=PROBE_SECONDS, capture_output=True, check=False
        )
    except (OSError, subprocess.TimeoutExpired):
        return False
    return child.returncode == 0


def render_lens(
    lens: Lens, path: str | os.PathLike[str], window_size_px: tuple[int, int] = (1800, 1200)
) -> None:
    """Render the translucent lens with rays of three fields, object disc and sensor planes to a PNG file.

    Parameters
    ----------
    lens
        A lens whose elements close. Surfaces without a semi-diameter have the size of their footprint.
    path
        PNG file to write.
    window_size_px
        Width and height of the picture in pixels (default: 1800 x 1200).

    Raises
    ------
    RenderingError
        If this machine cannot render.
    InputError
        If an element does not close, or the file cannot be written.
    """
    parts = scene_parts(lens, 1e3 * VIEW_CHORD_FRACTION * lens.stop_semi_diameter_mm)
    if not rendering_available():
        raise RenderingError("no off-screen rendering on this machine (OpenGL libraries missing?)")
    with _quiet_vtk():
        plotter = _plotter(parts, window_size_px, off_screen=True)
        try:
            with atomic_path(path) as temporary:
                plotter.screenshot(str(temporary))
                if not temporary.stat().st_size:  # VTK does not report write errors
                    raise InputError(f"cannot write {path}: the picture is empty; is the disk full?")
        finally:
            plotter.close()


def show_lens(lens: Lens) -> None:
    """Open a window with the scene of :func:`render_lens`; return when the window is closed.

    Without a display this terminates the process on some machines;
    :func:`lensdesign.plots.window.open_window` is safe.

    Raises
    ------
    InputError
        If an element does not close.
    """
    parts = scene_parts(lens, 1e3 * VIEW_CHORD_FRACTION * lens.stop_semi_diameter_mm)
    plotter = _plotter(parts, (1200, 800), off_screen=False)
    plotter.add_axes(xlabel="x", ylabel="y", zlabel="z")
    plotter.show(title=lens.title or "Lens")


@contextmanager
def _quiet_vtk() -> Iterator[None]:
    """Suppress VTK's message on standard error that there is no X server."""
    from vtkmodules.vtkCommonCore import vtkLogger

    verbosity = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)


def _plotter(
    parts: Sequence[ScenePart], window_size_px: tuple[int, int], off_screen: bool
) -> pyvista.Plotter:
    import pyvista

    plotter = pyvista.Plotter(off_screen=off_screen, window_size=list(window_size_px), lighting="light kit")
    plotter.set_background("white")
    plotter.enable_anti_aliasing("ssaa")
    # Colour and width of the edges of bodies; rays have individual colours.
    edge_styles = {"glass": ("#4A7FA5", 4.0), "plane": ("#404040", 4.0)}
    for part in parts:
        if part.glass:
            _add_glass(plotter, part)
        elif len(part.faces):
            faces = pyvista.PolyData.from_regular_faces(part.vertices, part.faces)
            plotter.add_mesh(faces, color=part.color, opacity=part.opacity, lighting=False)
        if len(part.lines):
            color, width = edge_styles.get(part.kind, (part.color, 3.0))
            plotter.add_mesh(_polylines(part.lines), color=color, line_width=width, lighting=False)
    screen, type_mm = _place_camera(plotter, parts)
    _add_labels(plotter, placed_labels(parts, screen, type_mm))
    plotter.reset_camera_clipping_range()
    return plotter


def _add_glass(plotter: pyvista.Plotter, scene_part: ScenePart) -> None:
    import pyvista

    plotter.add_mesh(
        pyvista.PolyData.from_regular_faces(scene_part.vertices, scene_part.faces),
        color=scene_part.color,
        opacity=0.3,
        ambient=0.45,
        smooth_shading=True,
        split_sharp_edges=True,
        feature_angle=SHARP_DEG,
        specular=0.5,
        specular_power=40,
    )


def _add_labels(plotter: pyvista.Plotter, labels: Sequence[PlacedLabel]) -> None:
    for below in (False, True):
        plotter.add_point_labels(
            [label.end for label in labels if label.part.label_below == below],
            # VTK would interpret text between dollar signs as mathematics.
            [label.part.label.replace("$", "") for label in labels if label.part.label_below == below],
            show_points=False,
            always_visible=True,
            shape=None,
            bold=False,
            text_color="#333333",
            font_size=_type_pixels(plotter),
            justification_horizontal="center",
            justification_vertical="top" if below else "bottom",
        )
    for label in labels:
        if np.linalg.norm(label.end - label.foot) > 0.0:
            leader = _polylines(np.stack([label.foot, label.end])[None])
            plotter.add_mesh(leader, color="#8A8A8A", line_width=2.0, lighting=False)


def _type_pixels(plotter: pyvista.Plotter) -> int:
    return round(plotter.window_size[0] / 70)


def _polylines(lines: NDArray[np.float64]) -> pyvista.PolyData:
    import pyvista

    count, corners, _ = lines.shape
    numbers = np.arange(count * corners).reshape(count, corners)
    cells = np.column_stack([np.full(count, corners), numbers])
    return pyvista.PolyData(lines.reshape(-1, 3), lines=cells.ravel())


def _place_camera(plotter: pyvista.Plotter, parts: Sequence[ScenePart]) -> tuple[Array, float]:
    """Show the whole scene with y up; return the directions right and up on screen, and the type size."""
    towards = np.array([-0.80, 0.34, -0.50])
    towards /= np.linalg.norm(towards)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    points = [xyz.reshape(-1, 3) for part in parts for xyz in (part.vertices, part.lines)]
    screen = np.concatenate(points) @ np.stack([right, up, towards], axis=-1)
    middle, half = 0.5 * (screen.max(axis=0) + screen.min(axis=0)), 0.5 * np.ptp(screen, axis=0)
    focus = middle @ np.stack([right, up, towards])
    plotter.enable_parallel_projection()
    plotter.camera_position = [focus + 4.0 * np.linalg.norm(half) * towards, focus, up]
    width, height = plotter.window_size
    # Size of the picture relative to the scene; the margin holds the labels.
    margin_factor = 1.14
    plotter.camera.parallel_scale = margin_factor * max(half[1], half[0] * height / width)
    plotter.reset_camera_clipping_range()
    return np.stack([right, up]), 2.0 * plotter.camera.parallel_scale / height * _type_pixels(plotter)
