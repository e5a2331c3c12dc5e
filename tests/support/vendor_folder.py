"""Lens files as vendors write them, for tests of the search in a folder."""

from __future__ import annotations

from pathlib import Path

# Radius, thickness behind, glass; plano-convex lenses of Thorlabs' LA series, 25.4 mm in diameter, N-BK7.
LA1131 = [(25.75, 5.34, "N-BK7"), (None, 46.5, "")]
LA1509 = [(51.5, 3.6, "N-BK7"), (None, 97.7, "")]


def zmx_text(
    name: str, surfaces: list[tuple[float | None, float, str]], semi_mm: float, stop_plane: bool = False
) -> str:
    """Return a Zemax file with the object at infinity, perhaps with a separate stop in front of the lens."""
    lines = ["VERS 171115", "MODE SEQ", f"NAME {name}", "UNIT MM X W X CM MR CPMM", f"ENPD {2.0 * semi_mm}"]
    lines += ["GCAT SCHOTT", "FTYP 0 0 1 1 0 0 0 1", "XFLN 0", "YFLN 0", "WAVM 1 0.5876 1", "PWAV 1"]
    lines += ["SURF 0", "  CURV 0.0", "  DISZ INFINITY"]
    if stop_plane:
        lines += ["SURF 1", "  STOP", "  CURV 0.0", "  DISZ 5.0", f'  DIAM {semi_mm} 0 0 0 1 ""']
    for number, (radius_mm, distance_mm, glass) in enumerate(surfaces, start=1 + stop_plane):
        lines += [f"SURF {number}", *(["  STOP"] if number == 1 else [])]
        lines += [f"  CURV {0.0 if radius_mm is None else 1.0 / radius_mm!r}", f"  DISZ {distance_mm}"]
        lines += [f"  GLAS {glass}"] if glass else []
        lines += ["  COAT A"] if number == 1 + stop_plane else []
        lines += [f'  DIAM {semi_mm} 1 0 0 1 ""']
    lines += [f"SURF {len(surfaces) + 1 + stop_plane}", "  CURV 0.0", "  DISZ 0"]
    return "\r\n".join([*lines, "TOL TOFF   0   0", "MNUM 1 1", ""])


def seq_text(radii_mm: list[float], thickness_mm: float, glass: str, semi_mm: float) -> str:
    """Return a CODE V file of a single lens with the object at infinity."""
    front, back = radii_mm
    return "\n".join(
        [
            "RDM;LEN",
            "TITLE 'A single lens'",
            f"EPD {semi_mm}",
            "DIM M",
            "WL 587.6",
            "SO 0.0 1e20",
            f"S {front} {thickness_mm} {glass}",
            "  STO",
            f"  CIR {semi_mm}",
            f"S {back} 50.0",
            f"  CIR {semi_mm}",
            "SI 0.0 0.0",
            "",
        ]
    )


def write_vendors(folder: Path) -> None:
    """Write good lenses, copies of one under another name, and files that are damaged or of no use."""
    (folder / "plano").mkdir(parents=True)
    (folder / "bad").mkdir()
    (folder / "plano" / "LA1131.zmx").write_bytes(zmx_text("LA1131", LA1131, 11.43).encode("utf-16"))
    (folder / "plano" / "LA1131-A.ZMX").write_bytes(zmx_text("LA1131-A", LA1131, 11.43, True).encode())
    (folder / "plano" / "LA1509.zmx").write_bytes(zmx_text("LA1509", LA1509, 11.43).encode())
    (folder / "biconvex.seq").write_text(seq_text([51.0, -51.0], 6.0, "NBK7_SCHOTT", 11.4))
    (folder / "bad" / "cut.zmx").write_bytes(zmx_text("CUT", LA1131, 11.43).encode("utf-16")[:301])
    (folder / "bad" / "noise.zmx").write_bytes(bytes(range(256)) * 20)
    (folder / "bad" / "mirror.zmx").write_text(zmx_text("M", [(-50.0, -20.0, "MIRROR")], 10.0))
    triplet = [(30.0, 3.0, "N-BK7"), (None, 2.0, ""), (40.0, 3.0, "N-BK7"), (None, 30.0, "")]
    (folder / "bad" / "two.zmx").write_text(zmx_text("TWO", triplet, 8.0))
    (folder / "bad" / "glass.zmx").write_text(
        zmx_text("G", [(30.0, 3.0, "UNOBTAINIUM"), (None, 9.0, "")], 8.0)
    )
    (folder / "notes.txt").write_text("not a lens file")
