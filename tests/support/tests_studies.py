"""Small studies of a singlet, as texts."""

DESIGN = """
title = "singlet"
wavelengths_um = [0.532]

[object]
field_diameter_mm = 3.0
numerical_aperture = 0.5
working_distance_mm = 13.5

[sensor]
pixel_pitch_um = 3.2
pixels = [9344, 7000]
plane_distances_mm = [2.0, 22.0]

[[surface]]
radius_mm = 42.3
thickness_mm = 9.7
material = 1.5194726
semi_diameter_mm = 8.26
stop = true

[[surface]]
radius_mm = -12.0
conic = -0.89862
semi_diameter_mm = 10.0
"""

HEAD = """
title = "a study"
design = "design.toml"
trials = 40
seed = 7

[sampling]
rings = 2
arms = 6
pupil_samples = 64
"""

DECENTER = """
[[perturbation]]
target = "lens"
parameter = "decenter_y_mm"
distribution = "normal"
sigma = 0.02
"""

RADIUS = """
[[perturbation]]
name = "shop_radius"
target = "surface 2"
parameter = "radius_mm"
distribution = "truncated_normal"
sigma = 0.01
limit = 0.02
"""

SPREAD = """
[[merit]]
kind = "largest_spread_deg"
at_most = 4.83
"""

STREHL = """
[[merit]]
kind = "strehl"
at_least = 0.5
"""

SWEEP = """
[[sweep]]
name = "decenter"
target = "lens"
parameter = "decenter_y_mm"
values = [0.0, 0.02, 0.04]
line_widths_um = [1.0]
merits = ["largest_spread_deg"]
picture_values = [0.04]
"""

RAY_STUDY = HEAD + DECENTER + RADIUS + SPREAD
FULL_STUDY = HEAD + DECENTER + RADIUS + SPREAD + STREHL + SWEEP
