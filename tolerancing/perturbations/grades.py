"""Starting tolerances: a study file to edit, made from a design and a manufacturing grade.

The grades ``commercial``, ``precision`` and ``high_precision`` follow the usual tolerance charts of
manufacturers. The grade ``iso10110`` uses the general tolerances of ISO 10110-11 (1996 edition, table 1),
which apply if a drawing gives none. The grades ``moulded_glass`` and ``moulded_plastic`` are those of mass
production; the tables below have the source of each value. No grade replaces the values of the manufacturer
or the current standard.

=====================  ===============  =================================================================
value                  moulded_plastic  source
=====================  ===============  =================================================================
radius                 1 %              Apollo Optical Systems, Manufacturing Tolerances,
                                        https://www.apollooptical.com/manufacturing-tolerances (injection
                                        moulding, commercial): radius of curvature
centre thickness       0.025 mm         same table: centre thickness
irregularity           3 waves          same table: 6 fringes at 632.8 nm over 25 mm
decenter of a surface  0.025 mm         same table: concentricity of both surfaces
tilt of a surface      6 arc minutes    estimate: 0.025 mm over a part of 14 mm
index, Abbe number     0.002, 1 %       estimates: density of the part and batch of the polymer
=====================  ===============  =================================================================

=====================  ===============  =================================================================
value                  moulded_glass    source
=====================  ===============  =================================================================
radius                 0.5 %            estimate: half that of plastic, since glass shrinks less; no
                                        published chart is known
centre thickness       0.025 mm         estimate: as plastic, the play of the press is the same
irregularity           1.5 waves        estimate: half that of plastic, for the same reason
decenter of a surface  0.025 mm         estimate: as plastic, set by the same kind of mould
tilt of a surface      3 arc minutes    estimate: half that of plastic
index, Abbe number     0.001, 0.8 %     estimate: as commercial glass. Fast cooling changes the index
                                        (Schaub, Schwertz and Symmons, Field Guide to Molded Optics,
                                        SPIE 2016, "Index Tolerances"); the design must have the changed
                                        index
=====================  ===============  =================================================================

The table of relative costs (`tolerancing/cost/relative.toml`) refers to the same values. Mounts of moulded
parts have the values of ``commercial``.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import tomli_w

from lensdesign.analysis.space_bandwidth import match
from lensdesign.common.toml_files import did_you_mean
from lensdesign.errors import InputError
from lensdesign.lens.lens import Lens
from lensdesign.lens.surface_figure_source import TEST_WAVELENGTH_UM
from lensdesign.manufacture.drawing.tolerances import GENERAL, MERCURY_LINE_UM
from lensdesign.raytrace.paths import FIELD_FRACTIONS

COMMENT_COLUMN = 42
TRIALS, SEED = 1000, 20240601


@dataclass(frozen=True)
class Grade:
    """Tolerances of one grade; each is the largest deviation of either sign.

    Attributes
    ----------
    radius_percent, thickness_mm
        Radius and centre thickness of a glass part.
    irregularity_pv_waves
        Irregularity of a surface, peak to valley, in waves of 632.8 nm.
    wedge_deg
        Tilt of each surface of a glass part against the ground edge.
    asphere_decenter_mm
        Decenter of a conic or aspheric surface against the axis of the part.
    index, abbe_percent
        Refractive index and Abbe number of the glass.
    lens_decenter_mm, lens_tilt_deg, sensor_tilt_deg
        Decenter and tilt in the mount.
    distance_mm
        Distances between parts, to the object and to the sensor.
    """

    radius_percent: float
    thickness_mm: float
    irregularity_pv_waves: float
    wedge_deg: float
    asphere_decenter_mm: float
    index: float
    abbe_percent: float
    lens_decenter_mm: float
    lens_tilt_deg: float
    distance_mm: float
    sensor_tilt_deg: float


COMMERCIAL = Grade(0.2, 0.15, 1.0, 3.0 / 60.0, 0.05, 0.001, 0.8, 0.1, 0.2, 0.1, 0.5)
PRECISION = Grade(0.1, 0.05, 0.25, 1.0 / 60.0, 0.02, 0.0005, 0.5, 0.05, 0.1, 0.05, 0.2)
HIGH_PRECISION = Grade(0.025, 0.01, 0.1, 0.5 / 60.0, 0.005, 0.0002, 0.2, 0.01, 0.03, 0.02, 0.1)
MOULDED_GLASS = replace(
    COMMERCIAL,
    radius_percent=0.5,
    thickness_mm=0.025,
    irregularity_pv_waves=1.5,
    wedge_deg=0.05,
    asphere_decenter_mm=0.025,
)
MOULDED_PLASTIC = replace(
    MOULDED_GLASS, radius_percent=1.0, irregularity_pv_waves=3.0, wedge_deg=0.1, index=0.002, abbe_percent=1.0
)


FRINGE_UM = 0.5 * MERCURY_LINE_UM
"""Fringe spacing of ISO 10110-5: half a wavelength of the green mercury line."""

GRADES: dict[str, Grade | None] = {
    "commercial": COMMERCIAL,
    "precision": PRECISION,
    "high_precision": HIGH_PRECISION,
    "moulded_glass": MOULDED_GLASS,
    "moulded_plastic": MOULDED_PLASTIC,
    "iso10110": None,
}
"""Grades by name; None: the tolerances depend on the size of the part."""


def starting_study(lens: Lens, design_name: str, grade: str, calibrated: bool = True) -> str:
    """Return the text of a study file with starting tolerances.

    Parameters
    ----------
    lens
        The nominal lens.
    design_name
        Its design file, relative to the folder of the study file.
    grade
        One of `GRADES`.
    calibrated
        Whether the mounting is calibrated before a reconstruction, so that its model follows the mounting:
        the study then has compensators for decenter and tilt of the lens.

    Returns
    -------
    str
        Text of a TOML file, with a comment on the source of each number.

    Raises
    ------
    InputError
        If the grade is unknown, or a part is larger than the table of the standard covers.
    DesignError
        If no ray passes the nominal lens.
    """
    if grade not in GRADES:
        known = ", ".join(GRADES) + did_you_mean(grade, GRADES)
        raise InputError(f"grade = {grade!r}: there is no such grade; allowed: {known}")
    blocks = [_head(lens, design_name, grade), _mounting(lens, grade)]
    blocks += [_surface(lens, index, grade) for index in range(len(lens.surfaces))]
    blocks.append(_compensators(grade) if calibrated else NOT_CALIBRATED)
    blocks.append(_merits(lens))
    return "\n".join(block for block in blocks if block).replace("\n\n\n", "\n\n").rstrip("\n") + "\n"


def _head(lens: Lens, design_name: str, grade: str) -> str:
    title = f"{lens.title or design_name}: {grade.replace('_', ' ')} grade"
    lines = [
        "# Starting tolerances, to be edited: check each against the shop that makes and mounts the lens.",
        "# Deviations follow a normal distribution of which the limit, at two sigma, is the tolerance.",
    ]
    if grade == "iso10110":
        lines += [
            "# Parts: ISO 10110-11:1996, table 1, general tolerances by the largest dimension of the part.",
            "# Later editions differ; check against the edition that the drawing names. The standard has no",
            "# tolerances for glass, decenter of aspheres and mounts: these are of the commercial grade.",
        ]
    elif grade == "moulded_plastic":
        lines += [
            "# Radii, thickness, irregularity and decenter: commercial injection moulding (Apollo Optical",
            "# Systems, Manufacturing Tolerances). Tilts and index: estimates. Mounts: commercial grade.",
        ]
    elif grade == "moulded_glass":
        lines += ["# Parts and glass: estimates for pressed glass. Mounts: of the commercial grade."]
    else:
        lines += ["# Parts, glass and mounts: values of manufacturers' tolerance charts for this grade."]
    # Samples across the pupil that resolve the wavefront errors of each grade.
    samples = {"precision": 128, "high_precision": 128}.get(grade, 256)
    lines += [
        tomli_w.dumps({"title": title, "design": design_name}).rstrip("\n"),
        f"trials = {TRIALS}",
        f"seed = {SEED}",
        _commented("pivot_z_mm = 0.0", "the lens tilts about its front vertex"),
        "",
        "[sampling]",
        _commented(f"pupil_samples = {samples}", "resolves the wavefront errors of this grade"),
        _commented(f"plane_distance_mm = {_plane_distance_mm(lens)}", "wavefronts are compared here"),
        "",
        _commented("[scaled_trials]", "yield with all tolerances multiplied"),
        "factors = [0.5, 2.0]",
        "trials = 100",
    ]
    return "\n".join(lines) + "\n"


def _plane_distance_mm(lens: Lens) -> float:
    """Return the distance of the plane on which wavefronts are compared.

    It is the first sensor plane, or a nearer one if the rays of an object point cross in front of it.
    """
    first = min(lens.sensor.plane_distances_mm)
    # A wavefront exists only in front of the caustic, also in a perturbed lens.
    margin, most_halvings = 1.5, 8
    for distance in (_number(first * 0.5**k) for k in range(most_halvings)):
        if not _is_folded(lens, margin * distance):
            return distance
    return first


def _is_folded(lens: Lens, plane_distance_mm: float, fractions: tuple[float, ...] = FIELD_FRACTIONS) -> bool:
    """Return whether rays of an object point, at fractions of the half field, cross on a plane."""
    from wavesim.pupil.characteristic import point_characteristic

    for fraction in fractions:
        field_mm = (0.0, fraction * lens.half_field_mm)
        traced = point_characteristic(lens, field_mm, plane_distance_mm=plane_distance_mm, samples=64)
        if traced.determinant_mm2.min() <= 0.0 < traced.determinant_mm2.max():
            return True
    return False


def _mounting(lens: Lens, grade: str) -> str:
    mount = GRADES[grade] or COMMERCIAL
    decenter, tilt, distance = mount.lens_decenter_mm, mount.lens_tilt_deg, mount.distance_mm
    text = "# Mounting\n"
    for axis in "xy":
        text += _perturbation("lens", f"decenter_{axis}_mm", decenter, f"+-{decenter:g} mm in its mount")
    for axis in "xy":
        text += _perturbation("lens", f"tilt_{axis}_deg", tilt, f"+-{tilt:g}° in its mount")
    text += _perturbation("object", "working_distance_mm", distance, f"+-{distance:g} mm from object to lens")
    text += _perturbation("sensor", "distance_mm", distance, f"+-{distance:g} mm from lens to sensor")
    for axis in "xy":
        angle = mount.sensor_tilt_deg
        text += _perturbation("sensor", f"tilt_{axis}_deg", angle, f"+-{angle:g}°")
    return text


NOT_CALIBRATED = (
    "# No compensators: a reconstruction uses the nominal mounting. See `tolerancing start --calibrated`.\n"
)


def _compensators(grade: str) -> str:
    """Return the parameters of the mounting that a calibration determines from frames.

    Distances are not among them: they change wavefronts by focus alone, which is free anyway.
    """
    mount = GRADES[grade] or COMMERCIAL
    # A calibration also absorbs part of the errors of the lens, beyond the tolerance of the mount.
    reach = 2.0
    text = (
        "# Calibration: the model of the reconstruction adapts its mounting to each lens, as\n"
        "# `wavesim calibrate` does from frames.\n"
    )
    for target, parameter, tolerance in (
        ("lens", "decenter_x_mm", mount.lens_decenter_mm),
        ("lens", "decenter_y_mm", mount.lens_decenter_mm),
        ("lens", "tilt_x_deg", mount.lens_tilt_deg),
        ("lens", "tilt_y_deg", mount.lens_tilt_deg),
    ):
        limit = _number(reach * tolerance)
        text += _table(
            "compensator", ("target", target, ""), ("parameter", parameter, ""), ("limit", limit, "")
        )
    return text


def _surface(lens: Lens, index: int, grade: str) -> str:
    """Return the perturbations of a surface and of the medium behind it."""
    surface, target = lens.surfaces[index], f"surface {index + 1}"
    made = _part_tolerances(lens, index, grade)
    keys = surface.shape_keys
    radii = [key for key in keys if key.startswith("radius") and keys[key] is not None]
    text = "".join(_radius(lens, index, key, made) for key in radii)
    waves = made.grade.irregularity_pv_waves
    if surface.semi_diameter_mm is not None:
        text += _irregularity(target, waves, made.irregularity)
    if surface.kind not in ("plane", "sphere"):
        text += "".join(_conic(lens, index, key, made) for key in radii if _conic_of(key) in keys)
        for axis in "xy":
            decenter = made.grade.asphere_decenter_mm
            comment = f"+-{decenter:g} mm against the part's axis"
            text += _perturbation(target, f"decenter_{axis}_mm", decenter, comment)
    if {index - 1, index} & set(lens.glass_fronts):
        # A drawing states the centring of both surfaces of a part, against its ground edge.
        for axis in "xy":
            text += _perturbation(target, f"tilt_{axis}_deg", made.grade.wedge_deg, made.wedge)
    if index < len(lens.surfaces) - 1:
        text += _space_behind(lens, index, made)
    return f"# Surface {index + 1}\n{text}" if text else ""


@dataclass(frozen=True)
class _PartTolerances:
    """Tolerances of one part, with comments on their source."""

    grade: Grade
    radius: str
    thickness: str
    irregularity: str
    wedge: str
    sagitta_fringes: float | None = None


def _part_tolerances(lens: Lens, index: int, grade: str) -> _PartTolerances:
    chosen = GRADES[grade]
    if chosen is not None:
        return _PartTolerances(
            chosen,
            radius=f"+-{chosen.radius_percent:g} %",
            thickness=f"+-{chosen.thickness_mm:g} mm",
            irregularity=f"surface, 0 to {chosen.irregularity_pv_waves:g} waves of 632.8 nm",
            wedge=f"+-{60.0 * chosen.wedge_deg:g} arc minutes against the ground edge",
        )
    dimension = _largest_dimension_mm(lens, index)
    up_to_mm = next((most for most in GENERAL if dimension <= most), None)
    if up_to_mm is None:
        raise InputError(
            f"grade = 'iso10110': surface {index + 1}: the part measures {dimension:.4g} mm; the table of "
            f"ISO 10110-11 ends at {max(GENERAL):g} mm; use another grade"
        )
    thickness, form = GENERAL[up_to_mm].thickness_mm, GENERAL[up_to_mm].left
    sagitta, irregularity, minutes = form.radius_fringes, form.irregularity_fringes, form.centring_arcmin
    # The table states all of them.
    assert thickness is not None
    assert sagitta is not None
    assert irregularity is not None
    assert minutes is not None
    diameter = 2.0 * (lens.surfaces[index].semi_diameter_mm or 0.5 * dimension)
    tested = min(diameter, form.test_diameter_mm or up_to_mm)
    values = vars(COMMERCIAL) | {
        "thickness_mm": thickness,
        "irregularity_pv_waves": irregularity * FRINGE_UM / TEST_WAVELENGTH_UM,
        "wedge_deg": minutes / 60.0,
    }
    indication = f"3/{sagitta:g}({irregularity:g})"
    return _PartTolerances(
        Grade(**values),
        radius=f"{indication} over {tested:.3g} mm: {sagitta:g} fringes of 546 nm",
        thickness=f"+-{thickness:g} mm for parts up to {up_to_mm:g} mm",
        irregularity=f"surface, {indication}: {irregularity:g} fringes of 546 nm",
        wedge=f"4/{minutes:g}': surface tilt",
        sagitta_fringes=sagitta * FRINGE_UM / (0.5 * TEST_WAVELENGTH_UM) * (diameter / tested) ** 2,
    )


def _radius(lens: Lens, index: int, key: str, made: _PartTolerances) -> str:
    surface, target = lens.surfaces[index], f"surface {index + 1}"
    radius, semi_diameter, name = getattr(surface, key), surface.semi_diameter_mm, key.removesuffix("_mm")
    percent, fringes = made.grade.radius_percent, made.sagitta_fringes
    if fringes is None:
        return _perturbation(target, f"{name}_percent", percent, made.radius)
    if semi_diameter is None:
        comment = f"commercial: {made.radius.split(':')[0]} needs a clear aperture, which is missing"
        return _perturbation(target, f"{name}_percent", percent, comment)
    # One fringe of sag at the edge is half a wave, h^2 dR / (2 R^2).
    equivalent = 100.0 * fringes * 1e-3 * TEST_WAVELENGTH_UM * abs(radius) / semi_diameter**2
    largest_percent = 10.0
    if equivalent > largest_percent:
        comment = f"reduced; {made.radius} would be {equivalent:.3g} %"
        return _perturbation(target, f"{name}_percent", largest_percent, comment)
    return _perturbation(target, f"{name}_fringes", fringes, made.radius)


def _irregularity(target: str, waves: float, comment: str) -> str:
    half = _number(0.5 * waves)
    return _table(
        "perturbation",
        ("target", target, ""),
        ("parameter", "irregularity_pv_waves", comment),
        ("distribution", "uniform", ""),
        ("mean", half, ""),
        ("half_width", half, ""),
    )


def _conic(lens: Lens, index: int, radius_key: str, made: _PartTolerances) -> str:
    """Return the perturbation of the conic constant that belongs to a radius."""
    surface, target = lens.surfaces[index], f"surface {index + 1}"
    largest = 0.01
    conic, comment = largest, "a guess"
    if surface.semi_diameter_mm is not None:
        # Without power, a quarter of the sag h^4 dk / (8 R^3) remains, peak to valley.
        pv_mm = 1e-3 * TEST_WAVELENGTH_UM * made.grade.irregularity_pv_waves
        allowed = 32.0 * pv_mm * abs(getattr(surface, radius_key)) ** 3 / surface.semi_diameter_mm**4
        conic = min(allowed, largest)
        comment = "equivalent to the irregularity" if conic == allowed else "a guess"
    return _perturbation(target, _conic_of(radius_key), conic, comment)


def _conic_of(radius_key: str) -> str:
    """Return the key of the conic constant that belongs to a radius."""
    return radius_key.removesuffix("_mm").replace("radius", "conic")


def _space_behind(lens: Lens, index: int, made: _PartTolerances) -> str:
    """Return the perturbations of the air space or the glass behind a surface."""
    target, grade = f"surface {index + 1}", made.grade
    if index not in lens.glass_fronts:
        distance = grade.distance_mm
        return _perturbation(
            target, "thickness_mm", distance, f"+-{distance:g} mm between parts, of the mount"
        )
    text = _perturbation(target, "thickness_mm", grade.thickness_mm, made.thickness)
    text += _perturbation(target, "index", grade.index, f"+-{grade.index:g}, of the melt")
    if isinstance(lens.surfaces[index].material, str):
        abbe = grade.abbe_percent
        text += _perturbation(target, "abbe_percent", abbe, f"+-{abbe:g} %, of the melt")
    return text


def _largest_dimension_mm(lens: Lens, index: int) -> float:
    """Return the largest dimension of the glass part of a surface: its diameter or its thickness."""
    first = last = index
    while first - 1 in lens.glass_fronts:
        first -= 1
    while last in lens.glass_fronts:
        last += 1
    part = range(first, last + 1)
    elements = [lens.glass_fronts.index(i) for i in part[:-1]]
    given = [lens.edges[e].semi_diameter_mm for e in elements] if lens.edges else []
    radii = [r for r in (*given, *(lens.surfaces[i].semi_diameter_mm for i in part)) if r is not None]
    semi_diameter = max(radii, default=lens.stop_semi_diameter_mm)
    return max(2.0 * semi_diameter, float(lens.vertex_z_mm[last] - lens.vertex_z_mm[first]))


def _merits(lens: Lens) -> str:
    wavelength = lens.wavelengths_um[0]
    limit = match(lens, wavelength)
    off_axis = _number(0.7 * lens.half_field_mm)
    # A patch of this many resolution elements is evaluated in a few milliseconds.
    patch_resolutions = 100
    patch = min(1e-3 * patch_resolutions * limit.resolution_um, lens.object.field_diameter_mm)
    text = "# Requirements\n"
    folded = [z for z in lens.sensor.plane_distances_mm if _is_folded(lens, z, FIELD_FRACTIONS[:2])]
    if folded:
        text += f"# No reconstruction_loss: rays of an object point cross on the plane at {folded[0]:g} mm.\n"
    else:
        text += _table(
            "merit",
            ("kind", "reconstruction_loss", "axis, 0.7 of the half field"),
            ("patch_mm", _number(patch), f"{patch_resolutions} x wavelength / (2 NA), or the field"),
            ("field_points_mm", [[0.0, 0.0], [0.0, off_axis]], ""),
            ("at_most", 0.05, "loss of correlation"),
        )
    width = _number(1.5 * limit.resolution_um)
    for location, field in (("axis", [0.0, 0.0]), ("field", [0.0, off_axis])):
        text += _table(
            "merit",
            ("name", f"fine_contrast_{location}", ""),
            ("kind", "line_pair_contrast", "of a field known behind the lens, refocused"),
            ("level", "pupil", "from rays; wave is slower, auto compares both"),
            ("line_width_um", width, "1.5 x wavelength / (2 NA)"),
            ("field_mm", field, "the axis" if location == "axis" else "0.7 of the half field"),
            ("at_least", 0.5, ""),
        )
    edge = lens.half_field_mm
    points = [[0.0, min(_number(fraction * edge), edge)] for fraction in FIELD_FRACTIONS]
    text += _table(
        "merit",
        ("kind", "rms_waves", ""),
        ("field_points_mm", points, ""),
        ("at_most", 0.25, "a quarter wave, root mean square"),
    )
    return text + _spread(lens, limit.spread_limit_deg)


def _spread(lens: Lens, limit_deg: float) -> str:
    from lensdesign.analysis.exit_beam import largest_spread_angle

    nominal = largest_spread_angle(lens).spread_deg
    if limit_deg >= 90.0:
        return "# No limit to the spread behind the lens: the pixels resolve every angle.\n"
    at_most, comment = 1.02 * limit_deg, f"2 % above the {limit_deg:.4g}° of Eq. 2"
    if 1.01 * nominal > at_most:
        at_most, comment = 1.01 * nominal, f"1 % above the nominal lens; Eq. 2 requires {limit_deg:.4g}°"
    return _table("merit", ("kind", "largest_spread_deg", ""), ("at_most", _number(at_most), comment))


def _perturbation(target: str, parameter: str, tolerance: float, comment: str) -> str:
    return _table(
        "perturbation",
        ("target", target, ""),
        ("parameter", parameter, comment),
        ("distribution", "truncated_normal", ""),
        ("sigma", _number(0.5 * tolerance), ""),
        ("limit", _number(tolerance), ""),
    )


def _table(key: str, *lines: tuple[str, str | float | list[Any], str]) -> str:
    """Return the text of one table of an array of tables, from keys, values and comments."""
    text = [f"[[{key}]]"]
    for name, value, comment in lines:
        shown = f'"{value}"' if isinstance(value, str) else repr(value)
        text.append(_commented(f"{name} = {shown}", comment))
    return "\n".join(text) + "\n\n"


def _commented(text: str, comment: str) -> str:
    return f"{text:<{COMMENT_COLUMN - 1}} # {comment}" if comment else text


def _number(value: float) -> float:
    """Round a number to four significant digits."""
    return float(f"{value:.4g}")
