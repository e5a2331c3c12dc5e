"""What a shop takes: meshes, STEP files, drawings."""
