"""Encoding of meshes: STL, PLY, OBJ and GLB by trimesh, and 3MF with units and glasses.

A 3MF file (3D Manufacturing Format, Core Specification 1.3) is a zip archive of one XML model and two files
that declare its type.
"""

from __future__ import annotations

import io
import zipfile
from collections.abc import Sequence
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    import trimesh

MESH_SUFFIXES = (".stl", ".ply", ".obj", ".glb", ".3mf")
"""Suffixes of the mesh formats that can be written."""

GLASS_RGBA = (0xA9, 0xD3, 0xEE, 0x66)
"""Translucent colour of glass, for formats with colours."""

_CONTENT_TYPES = """<?xml version="1.0" encoding="UTF-8"?>
<Types xmlns="http://schemas.openxmlformats.org/package/2006/content-types">
<Default Extension="rels" ContentType="application/vnd.openxmlformats-package.relationships+xml"/>
<Default Extension="model" ContentType="application/vnd.ms-package.3dmanufacturing-3dmodel+xml"/>
</Types>
"""

_RELATIONSHIPS = """<?xml version="1.0" encoding="UTF-8"?>
<Relationships xmlns="http://schemas.openxmlformats.org/package/2006/relationships">
<Relationship Id="model" Target="/3D/3dmodel.model" \
Type="http://schemas.microsoft.com/3dmanufacturing/2013/01/3dmodel"/>
</Relationships>
"""


def encode_meshes(
    suffix: str,
    meshes: Sequence[trimesh.Trimesh],
    glasses: Sequence[str],
    whole: trimesh.Trimesh,
    statement: str = "",
) -> bytes:
    """Return the bytes of a mesh file.

    Parameters
    ----------
    suffix
        One of :data:`MESH_SUFFIXES`.
    meshes, glasses
        Each body in mm, and the name of its material.
    whole
        All bodies as one mesh, for formats without bodies.
    statement
        Comment in the file (default: none).
    """
    if suffix == ".glb":
        return _glb(meshes, glasses, statement)
    if suffix == ".3mf":
        return _three_mf(meshes, glasses, statement)
    data = whole.export(file_type=suffix[1:], **({"digits": 12} if suffix == ".obj" else {}))
    encoded = data.encode() if isinstance(data, str) else bytes(data)
    return _with_remark(suffix, encoded, statement) if statement else encoded


def _with_remark(suffix: str, data: bytes, statement: str) -> bytes:
    """Return the file with a comment."""
    line = " ".join(_printable(statement).split()).encode("ascii", "replace")
    if suffix == ".stl":
        header_bytes = 80  # the header of a binary STL file must not begin with "solid"
        return (b"transferlens " + line)[:header_bytes].ljust(header_bytes) + data[header_bytes:]
    if suffix == ".obj":
        return b"# " + line + b"\n" + data
    head, body = data.split(b"end_header\n", 1)
    return head + b"comment " + line + b"\nend_header\n" + body


def glass_visuals(glass: str) -> trimesh.visual.TextureVisuals:
    """Return the translucent appearance of a glass body; `glass` names the material."""
    return _visuals(glass, GLASS_RGBA, False)


def plain_visuals(color: str, opacity: float = 1.0) -> trimesh.visual.TextureVisuals:
    """Return the two-sided appearance of an object in a colour such as ``#E6B800``."""
    red, green, blue = bytes.fromhex(color.removeprefix("#"))
    return _visuals(color, (red, green, blue, round(255 * opacity)), True)


def _visuals(name: str, rgba: tuple[int, int, int, int], both_sides: bool) -> trimesh.visual.TextureVisuals:
    import trimesh

    material = trimesh.visual.material.PBRMaterial(
        name=name,
        baseColorFactor=[*map(_linear, rgba[:3]), rgba[3]],
        alphaMode="OPAQUE" if rgba[3] == 255 else "BLEND",
        doubleSided=both_sides,
        metallicFactor=0.0,
        roughnessFactor=0.3,
    )
    return trimesh.visual.TextureVisuals(material=material)


def _printable(name: str) -> str:
    """Return a name without characters that XML does not allow."""
    return "".join(c if c.isprintable() else "\ufffd" for c in name)


def _linear(component: int) -> int:
    """Convert an sRGB component (IEC 61966-2-1) to linear light, as glTF requires; both from 0 to 255."""
    value = component / 255.0
    return round(255.0 * (value / 12.92 if value <= 0.04045 else ((value + 0.055) / 1.055) ** 2.4))


def _glb(meshes: Sequence[trimesh.Trimesh], glasses: Sequence[str], statement: str) -> bytes:
    import trimesh

    scene = trimesh.Scene(metadata={"outline": statement} if statement else None)
    for index, (mesh, glass) in enumerate(zip(meshes, glasses, strict=True), start=1):
        scaled = trimesh.Trimesh(1e-3 * mesh.vertices, mesh.faces, process=False)
        scaled.visual = glass_visuals(glass)
        scene.add_geometry(scaled, geom_name=f"element_{index}", node_name=f"element_{index}")
    return bytes(scene.export(file_type="glb"))


def _three_mf(meshes: Sequence[trimesh.Trimesh], glasses: Sequence[str], statement: str) -> bytes:
    from xml.sax.saxutils import escape, quoteattr

    names = list(dict.fromkeys(glasses))
    color = "".join(f"{component:02X}" for component in GLASS_RGBA)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        '<model unit="millimeter" xml:lang="en-US" '
        'xmlns="http://schemas.microsoft.com/3dmanufacturing/core/2015/02">',
        *([f'<metadata name="Description">{escape(_printable(statement))}</metadata>'] if statement else []),
        "<resources>",
        '<basematerials id="1">',
        *(f'<base name={quoteattr(_printable(name))} displaycolor="#{color}"/>' for name in names),
        "</basematerials>",
    ]
    for index, (mesh, glass) in enumerate(zip(meshes, glasses, strict=True), start=1):
        lines.append(
            f'<object id="{index + 1}" type="model" name="element {index}" pid="1" '
            f'pindex="{names.index(glass)}"><mesh><vertices>'
        )
        lines += [f'<vertex x="{x:.12g}" y="{y:.12g}" z="{z:.12g}"/>' for x, y, z in mesh.vertices.tolist()]
        lines.append("</vertices><triangles>")
        lines += [f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces.tolist()]
        lines.append("</triangles></mesh></object>")
    items = "".join(f'<item objectid="{index + 1}"/>' for index in range(1, len(meshes) + 1))
    lines += ["</resources>", f"<build>{items}</build>", "</model>"]
    packed = io.BytesIO()
    files = {
        "[Content_Types].xml": _CONTENT_TYPES,
        "_rels/.rels": _RELATIONSHIPS,
        "3D/3dmodel.model": "\n".join(lines),
    }
    with zipfile.ZipFile(packed, "w") as archive:
        for name, text in files.items():
            # The time is fixed so that the same lens yields identical bytes.
            entry = zipfile.ZipInfo(name, (1980, 1, 1, 0, 0, 0))
            archive.writestr(entry, text, zipfile.ZIP_DEFLATED, 1)
    return packed.getvalue()
