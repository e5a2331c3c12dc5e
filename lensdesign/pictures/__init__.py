"""What people look at: layout, spots, charts, the lens in 3D."""
