from .drawing.assumed import AssumedTolerances, load_tolerances
from .drawing.sheets import DrawingOptions, drawing_as_stated, lens_drawing, write_drawing
from .drawing.tolerances import DrawingTolerances, SurfaceTolerances
from .dxf.outline import OutlineReport, write_outline
from .exports import Exported, ExportOptions, export_lens
from .mesh.mesh import lens_mesh, write_mesh
from .mesh.reading import TriangleMesh, read_mesh
from .mesh.verification import MeshReport, verify_mesh
from .step.writing import StepReport, write_step

__all__ = [
    "AssumedTolerances",
    "DrawingOptions",
    "DrawingTolerances",
    "ExportOptions",
    "Exported",
    "MeshReport",
    "OutlineReport",
    "StepReport",
    "SurfaceTolerances",
    "TriangleMesh",
    "drawing_as_stated",
    "export_lens",
    "lens_drawing",
    "lens_mesh",
    "load_tolerances",
    "read_mesh",
    "verify_mesh",
    "write_drawing",
    "write_mesh",
    "write_outline",
    "write_step",
]
