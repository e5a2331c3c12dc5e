"""What shapes a surface may have: one module for each, and a line in the registry.

:class:`lensdesign.lens.shapes.base.Shape` says what a module has to give; tracing, optimizing, meshes,
solids, drawings and files take all they know of a surface from there.
"""
