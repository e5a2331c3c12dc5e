# Sourced by the scripts of this folder: lens files that several of them read.

# CODE V file of a lens whose glass the file defines, with a name.
private_glass_lens() {
  cat <<LENS
RDM;LEN
TITLE 'singlet'
EPD 10
DIM M
WL 587.6
REF 1
XAN 0
YAN 0
PRV
PWL 587.6
'$1' 1.6
END
SO 0.0 1e11
S 50.0 5.0 '$1'
  STO
S -50.0 45.0
SI 0.0 0.0
GO
LENS
}

# Zemax file of a lens with a toroid whose radius of rotation is 60 mm and whose coefficient of y^4 is 1e-6.
toroid_lens() {
  cat <<'LENS'
VERS 191106 258 36214
MODE SEQ
NAME lens
UNIT MM X W X CM MR CPMM
ENPD 10
GCAT SCHOTT
FTYP 0 0 1 1 0 0 0
XFLN 0
YFLN 0
WAVM 1 0.5876 1
PWAV 1
SURF 0
  TYPE STANDARD
  CURV 0.0 0 0 0 0
  DISZ INFINITY
SURF 1
  STOP
  TYPE TOROIDAL
  CURV 0.02 0 0 0 0
  PARM 1 60
  PARM 2 0
  PARM 3 1e-6
  DISZ 5
  GLAS N-BK7 0 0 1.5168 64.17 0 0 0 0 0 0
SURF 2
  TYPE STANDARD
  CURV -0.02 0 0 0 0
  DISZ 45
SURF 3
  TYPE STANDARD
  CURV 0.0 0 0 0 0
  DISZ 0
LENS
}
