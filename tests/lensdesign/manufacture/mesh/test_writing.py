"""3MF files as their specification has them, read without the writer's help."""

from __future__ import annotations

import zipfile
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import trimesh

from lensdesign.lens.lens import Lens
from lensdesign.manufacture.mesh.mesh import write_mesh

CORE = "{http://schemas.microsoft.com/3dmanufacturing/core/2015/02}"


def model_of(path: Path) -> ElementTree.Element:
    """The model that a 3MF package's relationships point to."""
    with zipfile.ZipFile(path) as archive:
        assert archive.testzip() is None
        types = ElementTree.fromstring(archive.read("[Content_Types].xml"))
        assert {t.get("Extension") for t in types} == {"rels", "model"}
        (relationship,) = ElementTree.fromstring(archive.read("_rels/.rels"))
        assert relationship.get("Type") == "http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"
        return ElementTree.fromstring(archive.read(str(relationship.get("Target")).lstrip("/")))


def mesh_of(item: ElementTree.Element) -> trimesh.Trimesh:
    vertices = [[float(v.get(a, "")) for a in "xyz"] for v in item.iter(f"{CORE}vertex")]
    faces = [[int(t.get(a, "")) for a in ("v1", "v2", "v3")] for t in item.iter(f"{CORE}triangle")]
    return trimesh.Trimesh(vertices, faces, process=False)


@pytest.fixture(scope="module")
def doublet(paper_lens: Lens) -> Lens:
    surfaces = [
        {"radius_mm": 40.0, "thickness_mm": 6.0, "material": "N-BK7", "semi_diameter_mm": 9.0, "stop": True},
        {"radius_mm": -30.0, "thickness_mm": 2.0, "material": "N-SF6", "semi_diameter_mm": 9.0},
        {"radius_mm": -90.0, "semi_diameter_mm": 9.0},
    ]
    return Lens.model_validate(paper_lens.model_dump(exclude={"surfaces"}) | {"surface": surfaces})


def test_3mf_holds_units_glasses_and_closed_bodies(doublet: Lens, tmp_path: Path) -> None:
    path = tmp_path / "lens.3mf"
    written = write_mesh(doublet, path, 10.0)
    model = model_of(path)
    assert model.tag == f"{CORE}model"
    assert model.get("unit") == "millimeter"
    (materials,) = model.iter(f"{CORE}basematerials")
    names = [base.get("name") for base in materials]
    assert names == ["N-BK7", "N-SF6"]
    assert all(len(base.get("displaycolor", "")) == 9 for base in materials)
    bodies = list(model.iter(f"{CORE}object"))
    assert [names[int(b.get("pindex", ""))] for b in bodies] == ["N-BK7", "N-SF6"]
    assert {b.get("pid") for b in bodies} == {materials.get("id")}
    assert [i.get("objectid") for i in model.iter(f"{CORE}item")] == [b.get("id") for b in bodies]
    meshes = [mesh_of(b) for b in bodies]
    assert all(m.is_watertight and m.is_winding_consistent for m in meshes)
    assert sum(m.volume for m in meshes) == pytest.approx(written.volume_mm3, rel=1e-10)
    corners = np.concatenate([m.vertices for m in meshes])
    assert corners == pytest.approx(written.mesh.vertices, abs=1e-10)


def test_the_same_lens_gives_the_same_3mf(paper_lens: Lens, tmp_path: Path) -> None:
    paths = tmp_path / "a.3mf", tmp_path / "b.3mf"
    for path in paths:
        write_mesh(paper_lens, path, 10.0)
    assert paths[0].read_bytes() == paths[1].read_bytes()


def test_glb_names_the_glass(doublet: Lens, tmp_path: Path) -> None:
    write_mesh(doublet, tmp_path / "lens.glb", 10.0)
    scene = trimesh.load(tmp_path / "lens.glb")
    assert {g.visual.material.name for g in scene.geometry.values()} == {"N-BK7", "N-SF6"}
    assert {g.visual.material.alphaMode for g in scene.geometry.values()} == {"BLEND"}
