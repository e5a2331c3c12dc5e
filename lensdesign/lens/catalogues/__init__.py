"""Sources of glass data: catalogue files, the refractiveindex.info database, and thermal data."""
