"""The GLB scene: what is in it, how large, and where the rays end."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.plots.glb import write_scene
from lensdesign.raytrace.bundles import pupil_hexapolar
from lensdesign.raytrace.paths import FIELD_FRACTIONS, ray_paths


@pytest.fixture(scope="module")
def scene(paper_lens: Lens, tmp_path_factory: pytest.TempPathFactory) -> dict[str, trimesh.Trimesh]:
    """Meshes by the name of their node, in mm where the node puts them."""
    path = tmp_path_factory.mktemp("scene") / "lens.glb"
    names = write_scene(paper_lens, path)
    loaded = trimesh.load(path)
    assert {*loaded.graph.nodes_geometry} == {*names}
    meshes = {}
    for name in names:
        transform, geometry = loaded.graph[name]
        meshes[name] = loaded.geometry[geometry].copy().apply_transform(transform).apply_scale(1e3)
    return meshes


def test_names(scene: dict[str, trimesh.Trimesh]) -> None:
    assert [*scene] == [
        "element_1_N-BK7",
        "stop_ring",
        "object_disc",
        "sensor_plane_1",
        "sensor_plane_2",
        "rays_0_mm",
        "rays_1.05_mm",
        "rays_1.5_mm",
    ]


def test_bounds(scene: dict[str, trimesh.Trimesh], paper_lens: Lens) -> None:
    glass = scene["element_1_N-BK7"]
    assert glass.bounds == pytest.approx(np.array([[-11.25, -11.25, 0.0], [11.25, 11.25, 9.7]]), abs=2e-3)
    glass.merge_vertices()
    assert glass.is_watertight
    assert scene["object_disc"].area == pytest.approx(math.pi * 1.5**2, rel=1e-3)
    assert scene["object_disc"].bounds[:, 2] == pytest.approx(paper_lens.object_z_mm, abs=1e-5)
    half = 0.5 * np.array(paper_lens.sensor.size_mm)
    for number, z in enumerate(paper_lens.sensor_z_mm, start=1):
        expected = np.array([[-half[0], -half[1], z], [half[0], half[1], z]])
        assert scene[f"sensor_plane_{number}"].bounds == pytest.approx(expected, abs=1e-5)
    r = np.hypot(*scene["stop_ring"].vertices[:, :2].T)
    assert np.min(r) == pytest.approx(paper_lens.stop_semi_diameter_mm, abs=1e-5)
    assert np.mean(scene["stop_ring"].bounds[:, 2]) == pytest.approx(
        float(paper_lens.surfaces[0].sag_mm(paper_lens.stop_semi_diameter_mm)), abs=1e-5
    )


def ends(tubes: trimesh.Trimesh, z_mm: float) -> NDArray[np.float64]:
    """Middles of the tubes' cross-sections in a plane."""
    at = tubes.vertices[np.abs(tubes.vertices[:, 2] - z_mm) < 1e-5]
    return np.asarray(at.reshape(-1, 8, 3).mean(axis=1))


def test_rays_run_from_the_object_to_the_last_sensor_plane(
    scene: dict[str, trimesh.Trimesh], paper_lens: Lens
) -> None:
    pupil = pupil_hexapolar(2).points
    for share, name in zip(FIELD_FRACTIONS, ("rays_0_mm", "rays_1.05_mm", "rays_1.5_mm"), strict=True):
        tubes = scene[name]
        height = share * paper_lens.half_field_mm
        assert tubes.bounds[0, 2] == pytest.approx(paper_lens.object_z_mm, abs=1e-5)
        assert tubes.bounds[1, 2] == pytest.approx(paper_lens.sensor_z_mm[-1], abs=1e-5)
        start = ends(tubes, paper_lens.object_z_mm)
        assert start[:, :2] == pytest.approx(np.tile([0.0, height], (len(start), 1)), abs=1e-4)
        arrived = ray_paths(paper_lens, (0.0, height), pupil)[:, -1]
        assert len(arrived) == len(pupil)
        assert ends(tubes, paper_lens.sensor_z_mm[-1]) == pytest.approx(arrived, abs=1e-4)
        # The 3 mm field of the paper's lens stays on its sensor.
        assert np.all(np.abs(arrived[:, :2]) < 0.5 * np.array(paper_lens.sensor.size_mm))


def test_clipped_rays_end_at_the_glass(paper_lens: Lens, tmp_path: Path) -> None:
    narrow = paper_lens.with_surface(1, semi_diameter_mm=6.0)
    write_scene(narrow, tmp_path / "lens.glb")
    tubes = trimesh.load(tmp_path / "lens.glb").geometry["rays_0_mm"]
    assert len(tubes.faces) < 19 * 3 * 16
    assert np.all(tubes.area_faces > 0.0)


def test_glass_is_translucent_and_planes_are_seen_from_both_sides(scene: dict[str, trimesh.Trimesh]) -> None:
    glass, plane = (scene[name].visual.material for name in ("element_1_N-BK7", "sensor_plane_1"))
    assert (glass.name, glass.alphaMode) == ("N-BK7", "BLEND")
    assert glass.baseColorFactor[3] < 255
    assert plane.doubleSided


def test_colours_are_linear_light(scene: dict[str, trimesh.Trimesh]) -> None:
    shown = np.array(scene["object_disc"].visual.material.baseColorFactor) / 255.0
    share = np.array([0xE6, 0xB8, 0x00]) / 255.0
    assert shown[:3] == pytest.approx(share**2.2, abs=0.015)


def test_nothing_is_written_where_no_scene_can_be(paper_lens: Lens, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"must end in \.glb"):
        write_scene(paper_lens, tmp_path / "lens.stl")
    with pytest.raises(InputError, match="edge thickness"):
        write_scene(paper_lens.with_surface(0, thickness_mm=4.5), tmp_path / "lens.glb")
    assert not list(tmp_path.iterdir())
