"""What a lens is: surfaces and their shapes, glasses, measured figures, poses, edges, and the solid they
bound.
"""
