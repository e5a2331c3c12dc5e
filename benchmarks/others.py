"""The same lens in other ray tracers, for side-by-side comparison. None of them is needed otherwise."""

from __future__ import annotations

import inspect
import warnings
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import version
from importlib.util import find_spec
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from lensdesign import Lens

Array = NDArray[np.float64]

PACKAGES = ("optiland", "prysm")
HOW_TO_GET = (
    "pip install -r benchmarks/requirements-others.txt in a throw-away environment that also has transferlens"
)
TOLERANCE = 1e-9


class Tracer(Protocol):
    """A lens in another program, and one bundle of rays for it."""

    name: str

    def trace(self) -> None:
        """Trace the rays through all surfaces to the plane."""

    def perturb(self, dx_mm: float, dy_mm: float, tilt_x_deg: float, tilt_y_deg: float) -> None:
        """Decenter and tilt the last surface about its vertex, as SurfacePerturbation does."""

    def result(self) -> tuple[Array, Array]:
        """Positions and directions of the rays traced last."""


class OptilandTracer:
    """Optiland with its NumPy backend, without the records of every surface where it can leave them out."""

    def __init__(
        self, lens: Lens, origins: Array, directions: Array, wavelength_um: float, plane_z_mm: float
    ) -> None:
        make_medium = import_module("optiland.materials").IdealMaterial

        self.name = f"Optiland {version('optiland')}"
        self.make_rays = import_module("optiland.rays").RealRays
        self.columns = [np.ascontiguousarray(column) for column in (*origins.T, *directions.T)]
        self.columns += [np.ones(len(origins)), np.full(len(origins), wavelength_um)]
        surfaces = import_module("optiland.optic").Optic().surfaces
        surfaces.add(index=0, z=lens.object_z_mm)
        media = [make_medium(float(index)) for index in lens.indices(wavelength_um)[1:]]
        vertices = lens.vertex_z_mm
        for i, (surface, z, medium) in enumerate(zip(lens.surfaces, vertices, media, strict=True), start=1):
            radius = np.inf if surface.radius_mm is None else surface.radius_mm
            surfaces.add(index=i, z=z, radius=radius, conic=surface.conic, material=medium, is_stop=i == 1)
        surfaces.add(index=len(media) + 1, z=plane_z_mm)
        self.surfaces = surfaces
        # Releases before 0.6.3 always record.
        can_leave_out = "record" in inspect.signature(surfaces.trace).parameters
        self.options = {"record": False} if can_leave_out else {}
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # Numba's remarks while it compiles
            self.trace()

    def trace(self) -> None:
        self.rays = self.make_rays(*self.columns)
        self.surfaces.trace(self.rays, skip=1, **self.options)

    def perturb(self, dx_mm: float, dy_mm: float, tilt_x_deg: float, tilt_y_deg: float) -> None:
        frame = self.surfaces[-2].geometry.cs
        frame.x, frame.y = dx_mm, dy_mm
        # Optiland turns about the other axis first. Only where the axis of symmetry points matters.
        tilt_x, tilt_y = np.deg2rad([tilt_x_deg, tilt_y_deg])
        frame.rx = np.arcsin(np.sin(tilt_x) * np.cos(tilt_y))
        frame.ry = np.arctan2(np.tan(tilt_y), np.cos(tilt_x))

    def result(self) -> tuple[Array, Array]:
        rays = self.rays
        return np.column_stack([rays.x, rays.y, rays.z]), np.column_stack([rays.L, rays.M, rays.N])


class PrysmTracer:
    """prysm's ray tracer, with its law of refraction given the unit normals that it needs."""

    def __init__(
        self, lens: Lens, origins: Array, directions: Array, wavelength_um: float, plane_z_mm: float
    ) -> None:
        tracing = import_module("prysm.experimental.raytracing.spencer_and_murty")
        surface = import_module("prysm.experimental.raytracing.surfaces").Surface

        self.name = f"prysm {version('prysm')}"
        self.raytrace = tracing.raytrace
        self.rays = origins, directions, wavelength_um
        _give_unit_normals(tracing)
        indices, vertices = lens.indices(wavelength_um)[1:], lens.vertex_z_mm
        self.surfaces = [
            surface.conic(s.curvature, s.conic, "refract", [0.0, 0.0, z], n=lambda _, index=index: index)
            for s, z, index in zip(lens.surfaces, vertices, indices, strict=True)
        ]
        self.surfaces.append(surface.plane("eval", [0.0, 0.0, plane_z_mm]))
        self.trace()

    def trace(self) -> None:
        self.history = self.raytrace(self.surfaces, *self.rays)

    def perturb(self, dx_mm: float, dy_mm: float, tilt_x_deg: float, tilt_y_deg: float) -> None:
        from lensdesign.lens.poses import rotation_matrix

        surface = self.surfaces[-2]
        surface.P = np.array([dx_mm, dy_mm, surface.P[2]])
        surface.R = rotation_matrix(np.deg2rad(tilt_x_deg), np.deg2rad(tilt_y_deg)).T

    def result(self) -> tuple[Array, Array]:
        return self.history[0][-1], self.history[1][-1]


def _give_unit_normals(module: Any) -> None:
    """Correct prysm 0.21.1, which refracts at normals of any length: these rays would end 0.3 mm off."""
    if hasattr(module, "refract_at_unit_normals"):
        return
    module.refract_at_unit_normals = module.refract

    def refract(n: float, n_behind: float, directions: Array, normals: Array) -> Array:
        length = np.sqrt(np.einsum("ij,ij->i", normals, normals))
        return module.refract_at_unit_normals(n, n_behind, directions, normals / length[:, None])

    module.refract = refract


def other_tracers(
    lens: Lens, origins: Array, directions: Array, wavelength_um: float, plane_z_mm: float
) -> dict[str, Tracer]:
    """The tracers whose packages are installed, ready to run; says which are left out."""
    makers: dict[str, Callable[..., Tracer]] = {"optiland": OptilandTracer, "prysm": PrysmTracer}
    missing = missing_packages()
    if missing:
        print(f"left out: {', '.join(missing)}; to get them: {HOW_TO_GET}")
    return {
        package: make(lens, origins, directions, wavelength_um, plane_z_mm)
        for package, make in makers.items()
        if package not in missing
    }


def missing_packages() -> list[str]:
    """Packages of the comparison that are not installed."""
    return [package for package in PACKAGES if find_spec(package) is None]


def largest_difference(tracer: Tracer, position: Array, direction: Array) -> float:
    """Largest difference (mm, or of a direction cosine) between a tracer's last rays and others.

    Ends the program where the two do not find the same rays: their times are then no comparison.
    """
    theirs = tracer.result()
    difference = float(np.max(np.abs([theirs[0] - position, theirs[1] - direction])))
    if not difference <= TOLERANCE:  # NaN fails too
        raise SystemExit(f"void: {tracer.name} differs by {difference:.3g}; allowed: {TOLERANCE:g}")
    return difference
