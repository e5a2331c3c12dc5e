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

from lensdesign import Lens, Surface

Array = NDArray[np.float64]

PACKAGES = ("optiland", "prysm")
HOW_TO_GET = (
    "pip install -r benchmarks/requirements-others.txt in a throw-away environment that also has transferlens"
)
TOLERANCE = 1e-9


OPTILAND_NAMES: dict[str, tuple[str, dict[str, Any]]] = {
    "decenter_x_mm": ("decenter", {"axis": "x"}),
    "decenter_y_mm": ("decenter", {"axis": "y"}),
    "tilt_x_rad": ("tilt", {"axis": "x"}),
    "tilt_y_rad": ("tilt", {"axis": "y"}),
    "radius_mm": ("radius", {}),
    "conic": ("conic", {}),
    "index": ("index", {"wavelength": 0.532}),
}
"""Perturbations of the last surface, and of the index before it, as Optiland calls them."""


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
        self.optic = import_module("optiland.optic").Optic()
        surfaces = self.optic.surfaces
        surfaces.add(index=0, z=lens.object_z_mm)
        media = [make_medium(float(index)) for index in lens.indices(wavelength_um)[1:]]
        vertices = lens.vertex_z_mm
        for i, (surface, z, medium) in enumerate(zip(lens.surfaces, vertices, media, strict=True), start=1):
            surfaces.add(index=i, z=z, material=medium, is_stop=i == 1, **optiland_shape(surface))
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

    def monte_carlo(self, deviations: dict[str, float], index: float, trials: int) -> tuple[Array, Array]:
        """Largest sine of a ray's angle by Optiland's own Monte Carlo, perturbing the last surface.

        Parameters
        ----------
        deviations
            Standard deviation of each perturbation.
        index
            Nominal, of the glass before the last surface.
        trials
            How many.

        Returns
        -------
        values : ndarray, shape (trials, perturbations)
        sines : ndarray, shape (trials,)
        """
        tolerancing = import_module("optiland.tolerancing")
        samplers = import_module("optiland.tolerancing.perturbation").DistributionSampler
        geometry, last = self.surfaces[-2].geometry, len(self.surfaces) - 2
        middles = {"radius_mm": float(geometry.radius), "conic": float(geometry.k), "index": index}

        def largest_sine(optic: Any) -> float:
            self.trace()
            return float(np.max(np.hypot(self.rays.L, self.rays.M)))

        import_module("optiland.optimization.operand").operand_registry.register(
            "largest_sine", largest_sine, overwrite=True
        )
        asked = tolerancing.Tolerancing(self.optic)
        asked.add_operand("largest_sine", {"optic": self.optic}, target=0.0)
        for seed, (name, deviation) in enumerate(deviations.items()):
            kind, options = OPTILAND_NAMES[name]
            sampler = samplers("normal", seed=seed, loc=middles.get(name, 0.0), scale=deviation)
            surface = last - 1 if name == "index" else last
            asked.add_perturbation(kind, sampler, surface_number=surface, **options)
        runner = import_module("optiland.tolerancing.monte_carlo").MonteCarlo(asked)
        runner.run(trials)
        table = runner.get_results().to_numpy(float)
        nominal = np.array([middles.get(name, 0.0) for name in deviations])
        return table[:, : len(deviations)] - nominal, table[:, len(deviations)]

    def result(self) -> tuple[Array, Array]:
        rays = self.rays
        return np.column_stack([rays.x, rays.y, rays.z]), np.column_stack([rays.L, rays.M, rays.N])


def optiland_shape(surface: Surface) -> dict[str, Any]:
    """A surface's shape as arguments of Optiland. Its own tolerance would leave errors of 1e-7 mm."""
    radius = np.inf if surface.radius_mm is None else surface.radius_mm
    own = {"radius": radius, "conic": surface.conic, "tol": 1e-12}
    across = np.inf if surface.radius_x_mm is None else surface.radius_x_mm
    match surface.shape_class.NAME:
        case "conic":
            return {"radius": radius, "conic": surface.conic}
        case "even asphere":  # its first coefficient is that of r^2
            return {**own, "surface_type": "even_asphere", "coefficients": [0.0, *surface.asphere]}
        case "odd asphere":  # from r on
            return {**own, "surface_type": "odd_asphere", "coefficients": [0.0, 0.0, *surface.odd_asphere]}
        case "Qcon":
            coefficients = [0.0, *surface.shape.traced.terms[2:].tolist()]
            return {**own, "surface_type": "even_asphere", "coefficients": coefficients}
        case "Qbfs":
            terms = dict(enumerate(surface.q_mm))
            norm = surface.normalization_radius_mm
            return {**own, "surface_type": "forbes_qbfs", "radial_terms": terms, "norm_radius": norm}
        case "toroid":
            powers = [0.0, *surface.asphere]
            own |= {"radius_x": across, "radius_y": radius, "toroidal_coeffs_poly_y": powers}
            return {"surface_type": "toroidal", **own}
    raise SystemExit(f"Optiland: no counterpart of shape {surface.shape_class.NAME}")


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


def prysm_tangents(
    lens: Lens, origins: Array, directions: Array, wavelength_um: float, plane_z_mm: float
) -> Array | None:
    """Derivatives of rays' last directions by the perturbations of `OPTILAND_NAMES`, shape (n, 3, 7).

    By prysm's forward tangents, which no release has; None without them.
    """
    try:
        tangents = import_module("prysm.x.raytracing._diff_raytrace")
    except ImportError:
        return None
    shapes, materials = import_module("prysm.x.raytracing.surfaces"), import_module("prysm.x.materials")
    indices, vertices = lens.indices(wavelength_um)[1:], lens.vertex_z_mm
    system = [
        shapes.Surface(
            shapes.Conic(s.curvature, s.conic),
            interaction="refr",
            P=[0.0, 0.0, z],
            material=materials.ConstantMaterial(float(index)),
        )
        for s, z, index in zip(lens.surfaces, vertices, indices, strict=True)
    ]
    system.append(shapes.Surface(shapes.Plane(), interaction="eval", P=[0.0, 0.0, plane_z_mm]))
    last = len(lens.surfaces) - 1
    seeds = [
        *(tangents.seed_decenter(last, axis) for axis in "xy"),
        *(tangents.seed_tilt(last, axis) for axis in "xy"),
        tangents.seed_curvature(last),
        tangents.seed_conic(last),
        tangents.seed_index(last - 1),
    ]
    found = np.array(
        tangents.raytrace_with_tangents(system, origins, directions, wavelength_um, seeds).Sdot[-1]
    )
    found[..., 2:4] *= -1.0  # prysm's rotations lead into the surface's frame
    found[..., 4] *= -(lens.surfaces[-1].curvature ** 2)  # by radius
    return found


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
