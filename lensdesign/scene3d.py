"""A rendered 3D view of a lens with its rays, object and sensor planes.

Off-screen rendering needs OpenGL libraries; where they are missing, the library that renders brings the
whole process down. So a child process tries first.
"""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from typing import TYPE_CHECKING

import numpy as np

from lensdesign.bundles import pupil_hexapolar
from lensdesign.errors import TransferLensError, atomic_path
from lensdesign.lens_solid import closed_elements
from lensdesign.mesh import lens_mesh
from lensdesign.ray_paths import FIELD_COLORS, FIELD_SHARES, ray_paths, sized_lens
from lensdesign.system import Lens

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


class RenderingError(TransferLensError):
    """No 3D view can be rendered on this machine."""


@cache
def rendering_available() -> bool:
    """Whether this machine renders off-screen: a child process draws a cube, once per process."""
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
    """Render the translucent lens with rays of three fields, object disc and sensor planes, as PNG.

    Parameters
    ----------
    lens
        Any lens whose elements close; surfaces without a semi-diameter are as large as their footprint.
    path
        PNG file to write.
    window_size_px
        Width and height of the picture.

    Raises
    ------
    RenderingError
        If this machine cannot render.
    InputError
        If an element does not close, or the file cannot be written.
    """
    lens = sized_lens(lens)
    elements = closed_elements(lens)
    if not rendering_available():
        raise RenderingError("no off-screen rendering on this machine (OpenGL libraries missing?)")
    import pyvista

    with _quiet_vtk():
        plotter = pyvista.Plotter(off_screen=True, window_size=list(window_size_px), lighting="light kit")
        try:
            plotter.set_background("white")
            plotter.enable_anti_aliasing("ssaa")
            for element in elements:
                _add_glass(plotter, lens, element.number)
            _add_rays(plotter, lens)
            _add_planes(plotter, lens)
            _place_camera(plotter)
            with atomic_path(path) as temporary:
                plotter.screenshot(str(temporary))
        finally:
            plotter.close()


@contextmanager
def _quiet_vtk() -> Iterator[None]:
    """VTK says on standard error that there is no X server, and then renders without one."""
    from vtkmodules.vtkCommonCore import vtkLogger

    before = vtkLogger.GetCurrentVerbosityCutoff()
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_ERROR)
    try:
        yield
    finally:
        vtkLogger.SetStderrVerbosity(before)


def _add_glass(plotter: pyvista.Plotter, lens: Lens, element: int) -> None:
    import pyvista

    mesh = lens_mesh(lens, chord_error_mm=2e-4 * lens.stop_semi_diameter_mm, element=element).mesh
    solid = pyvista.PolyData.from_regular_faces(mesh.vertices, mesh.faces)
    plotter.add_mesh(
        solid,
        color="#A9D3EE",
        opacity=0.3,
        ambient=0.45,
        smooth_shading=True,
        split_sharp_edges=True,
        feature_angle=15.0,
        specular=0.5,
        specular_power=40,
    )
    rims = solid.extract_feature_edges(feature_angle=15.0, boundary_edges=False, manifold_edges=False)
    if rims.n_cells:
        plotter.add_mesh(rims, color="#4A7FA5", line_width=4)


def _add_rays(plotter: pyvista.Plotter, lens: Lens) -> None:
    import pyvista

    pupil = pupil_hexapolar(2).points
    for share, color in zip(FIELD_SHARES, FIELD_COLORS, strict=True):
        paths = ray_paths(lens, (0.0, share * lens.half_field_mm), pupil)
        count, corners, _ = paths.shape
        numbers = np.arange(count * corners).reshape(count, corners)
        cells = np.column_stack([np.full(count, corners), numbers])
        lines = pyvista.PolyData(paths.reshape(-1, 3), lines=cells.ravel())
        plotter.add_mesh(lines, color=color, line_width=3.0, lighting=False)


def _add_planes(plotter: pyvista.Plotter, lens: Lens) -> None:
    import pyvista

    disc = pyvista.Disc(center=(0.0, 0.0, lens.object_z_mm), inner=0.0, outer=lens.half_field_mm, c_res=96)
    plotter.add_mesh(disc, color="#E6B800", lighting=False)
    width, height = lens.sensor.size_mm
    for z in lens.sensor_z_mm:
        plane = pyvista.Plane(
            center=(0.0, 0.0, z), i_size=width, j_size=height, i_resolution=1, j_resolution=1
        )
        plotter.add_mesh(plane, color="#707070", opacity=0.18, lighting=False)
        plotter.add_mesh(plane.extract_feature_edges(), color="#404040", line_width=4)


def _place_camera(plotter: pyvista.Plotter) -> None:
    """Light runs from left to right, y is up, seen from the side, the front and above; all in view."""
    towards = np.array([-0.80, 0.34, -0.50])
    towards /= np.linalg.norm(towards)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    low, high = np.reshape(plotter.bounds, (3, 2)).T
    corners = np.array([np.where(pick, high, low) for pick in np.ndindex(2, 2, 2)])
    across = corners @ np.stack([right, up, towards], axis=-1)
    middle, half = 0.5 * (across.max(axis=0) + across.min(axis=0)), 0.5 * np.ptp(across, axis=0)
    focus = middle @ np.stack([right, up, towards])
    plotter.enable_parallel_projection()
    plotter.camera_position = [focus + 4.0 * np.linalg.norm(half) * towards, focus, up]
    width, height = plotter.window_size
    plotter.camera.parallel_scale = 1.05 * max(half[1], half[0] * height / width)
    plotter.reset_camera_clipping_range()
