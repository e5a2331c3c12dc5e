"""Surface shapes: one module and one registry line for each.

:class:`lensdesign.lens.shapes.base.Shape` is the interface of a shape. Ray tracing, optimization, meshes,
solids, drawings and file formats use surfaces through this interface alone.
"""
