"""Where glasses come from: catalogue files, the refractiveindex.info database; what heat does to them."""
