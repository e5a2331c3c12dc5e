"""Published prescriptions in the manner in which lens makers and CODE V write them, and what they are.

The Edmund Optics files follow the maker's own downloads; the double Gauss is the sample lens that CODE V and
OpticStudio come with; the achromat follows the data sheet of Thorlabs.
"""

from __future__ import annotations

from dataclasses import dataclass, field


@dataclass(frozen=True)
class Sample:
    """A file's suffix and text, and what the lens that it holds is known to be.

    `efl_mm` and `bfl_mm` are values with their tolerances: half of the last published digit, or that of glass
    data where the file itself holds a paraxial image distance to all its digits.
    """

    suffix: str
    text: str
    efl_mm: tuple[float, float]
    bfl_mm: tuple[float, float]
    glasses: tuple[str | float | None, ...]
    stop: int
    radii_mm: tuple[float | None, ...] = ()
    dropped: tuple[str, ...] = ()
    encodings: tuple[str, ...] = field(default=("utf-8",))


EDMUND_32327 = """RDM;LEN       "VERSION: 11.2 SR1       LENS VERSION: 84       Creation Date: 01-May-2019"
TITLE '32327 Achromatic Lens'
EPD   25.0
DIM   M
WL    587.6
REF   1
WTW   1
TEM   20.0
INI   'EO '
XAN   0.0
YAN   0.0
WTF   1.0
VUY   0.0
VLY   0.0
SO    0.0 0.1e14
S     61.46999999999995 6.0 NBK7_SCHOTT
  STO
  SLB "32327"
  CIR 12.0
S     -44.63999999999994 2.5 NSF5_SCHOTT
S     -129.9400000000001 95.95194415183156
  CIR 12.0
  PIM
SI    0.0 0.0
GO
"""

EDMUND_49663 = """RDM;LEN       "VERSION: 11.2 SR1       LENS VERSION: 84       Creation Date: 28-May-2019"
TITLE '49663 LENS ASPHERE ACH 25 X 35 VIS 0 TS'
EPD   25.0
DIM   M
WL    656.3 587.6 486.1
REF   2
WTW   1 1 1
TEM   20.0
INI   'EG3'
XAN   0.0 0.0
YAN   0.0 2.0
WTF   1.0 1.0
SO    0.0 0.1e14
S     23.49999999999983 9.0 SLAL8_OHARA
  STO
  SLB "49663"
S     -36.69999999999967 2.5 STIH53_OHARA
S     0.0 0.08 517000.520000
S     -323.006393602994 28.077783387
  ASP
  K   0.0
  CUF 0.0
  A   0.138925111836e-4; B -0.208175206307e-7; C 0.0; D 0.0
SI    0.0 0.0
GO
"""

DOUBLE_GAUSS = """RDM N;LEN      "VERSION: 10.7       LENS VERSION: 80       Creation Date: 16-Jul-2015"
TITLE 'Double Gauss F/2 -  Available Glasses'
EPD   50.0
DIM   M
WL    656.3 587.6 486.1
REF   2
WTW   1 1 1
XAN   0.0 0.0 0.0
YAN   0.0 10.0000000023 14.0000000032
WTF   1.0 1.0 1.0
VUY   0.0 0.0 0.0
SO    0.0 993938392063.0
S     0.01779284094091543 8.75 NSSK2_SCHOTT
  CCY 0
S     0.006566600536925569 0.5
  CCY 0
S     0.02653743294670983 12.5 NSK2_SCHOTT
  CCY 0
S     0.0 3.8 F5_SCHOTT
S     0.04126892878570084 16.36944492653564
  CCY 0; THC 0
S     0.0 13.74795696388906
  THC 0
  STO
S     -0.03523942654429074 3.8 F5_SCHOTT
  CCY 0
S     0.0 11.0 NSK16_SCHOTT
S     -0.02636750828657709 0.5
  CCY 0
S     0.005636604951748545 7.0 NSK16_SCHOTT
  CCY 0
S     -0.0125926458590576 61.4875364179821
  CCY 0
  PIM
SI    0.0 -0.4002686453541377
  THC 0
DER   VAL I1 -0.6370618627459224e-5
DER   VAL I2 0.6608806779452905e-5
GO
"""

_ZMX_HEAD = """VERS 140124 258 36214
MODE SEQ
NAME {name}
PFIL 0 0 0
LANG 0
UNIT MM X W X CM MR CPMM
ENPD {pupil}
ENVD 2.0E+1 1 0
GFAC 0 0
GCAT {makers}
RAIM 0 0 1 1 0 0 0 0 0
PUSH 0 0 0 0 0 0
SDMA 0 1 0
FTYP 0 0 1 {waves} 0 0 0
ROPD 2
PICB 1
XFLN 0 0 0 0 0 0 0 0 0 0 0 0
YFLN 0 0 0 0 0 0 0 0 0 0 0 0
FWGN 1 1 1 1 1 1 1 1 1 1 1 1
VDXN 0 0 0 0 0 0 0 0 0 0 0 0
VCYN 0 0 0 0 0 0 0 0 0 0 0 0
"""
_ZMX_SETTINGS = """POLS 1 0 1 0 0 1 0
GLRS 1 0
GSTD 0 100.000 100.000 100.000 100.000 100.000 100.000 0 1 1 0 0 1 1 1 1 1 1
NSCD 100 500 0 1.0E-3 5 1.0E-6 0 0 0 0 0 0 1000000 0 2
COFN QF "COATING.DAT" "SCATTER_PROFILE.DAT" "ABG_DATA.DAT" "PROFILE.GRD"
COFN COATING.DAT SCATTER_PROFILE.DAT ABG_DATA.DAT PROFILE.GRD
"""
_ZMX_SURFACE = """  TYPE STANDARD
  FIMP

  CURV {curvature} 0 0 0 0 ""
  HIDE 0 0 0 0 0 0 0 0 0 0
  MIRR 2 0
  SLAB {label}
  DISZ {distance}
{glass}  DIAM {semi} 1 0 0 1 ""
  MEMA {semi} 0 0 0 1 ""
  POPS 0 0 0 0 0 0 0 0 1 1 1 1 0 0 0 0
"""


def zmx(name: str, pupil: float, waves: tuple[float, ...], *surfaces: tuple[object, ...]) -> str:
    """A file as OpticStudio writes it; each surface is (curvature, distance, glass or "", semi-diameter)."""
    text = _ZMX_HEAD.format(name=name, pupil=pupil, waves=len(waves), makers="SCHOTT MISC OHARA")
    text += "".join(f"WAVM {i} {w:.7E} 1\n" for i, w in enumerate(waves, start=1))
    text += f"WAVM {len(waves) + 1} 5.5E-1 1\nPWAV {1 + len(waves) // 2}\n{_ZMX_SETTINGS}"
    ends = (0.0, "INFINITY", "", 0.0), (0.0, 0, "", 0.0)
    for number, (curvature, distance, glass, semi) in enumerate((ends[0], *surfaces, ends[1])):
        text += f"SURF {number}\n" + ("  STOP\n" if number == 1 else "")
        line = f"  GLAS {glass} 0 0 1.5 40 0 0 0 0 0 0\n" if glass else ""
        text += _ZMX_SURFACE.format(
            curvature=curvature, label=number, distance=distance, glass=line, semi=semi
        )
    return text + 'BLNK \nTOL TOFF   0   0  0  0   0 0 0 0\nMNUM 1 1\nMOFF   0   1 "" 0 0 0 1 1 0 0.0 "" 0\n'


SAMPLES = {
    # Focal length 100 mm; the file's paraxial image solve tells the back focal length.
    "Edmund 32-327": Sample(
        ".seq",
        EDMUND_32327,
        (100.0, 0.05),
        (95.95194415183156, 1e-5),
        ("N-BK7", "N-SF5", None),
        0,
        (61.46999999999995, -44.63999999999994, -129.9400000000001),
    ),
    # Aspherized achromat, 25 mm x 35 mm FL, with an asphere of resin on its back.
    "Edmund 49-663": Sample(
        ".seq",
        EDMUND_49663,
        (35.0, 0.05),
        (28.077783387, 0.02),
        ("S-LAL8", "S-TIH53", 1.517, None),
        0,
        dropped=("surface 3: dispersion of the model glass 517000.520000",),
    ),
    # F/2 of an entrance pupil of 50 mm.
    "double Gauss": Sample(
        ".seq",
        DOUBLE_GAUSS,
        (100.0, 0.5),
        (61.4875364179821, 2e-4),
        ("N-SSK2", None, "N-SK2", "F5", None, None, "F5", "N-SK16", None, "N-SK16", None),
        5,
    ),
    # f = 100.0 mm within 1 %, fb = 97.1 mm.
    "Thorlabs AC254-100-A": Sample(
        ".zmx",
        zmx(
            "AC254-100-A",
            22.9,
            (0.4861, 0.5876, 0.6563),
            ("1.593625498007968E-002", 4.0, "N-BK7", 12.7),
            ("-2.187705097352877E-002", 2.5, "SF5", 12.7),
            ("-7.798487093503861E-003", 97.1, "", 12.7),
        ),
        (100.0, 1.0),
        (97.1, 0.6),
        ("N-BK7", "SF5", None),
        0,
        (62.75, -45.71, -128.23),
        encodings=("utf-16", "utf-8"),
    ),
    # A ball of N-BK7, 10 mm: effective focal length 7.34 mm, back focal length 2.34 mm.
    "ball lens": Sample(
        ".zmx",
        zmx("BALL 10 MM", 4.0, (0.5876,), (0.2, 10.0, "N-BK7", 4.0), (-0.2, 2.337, "", 4.0)),
        (7.34, 0.005),
        (2.34, 0.005),
        ("N-BK7", None),
        0,
        (5.0, -5.0),
        encodings=("utf-16", "latin-1"),
    ),
}
