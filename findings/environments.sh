# Sourced by the scripts of this folder: a temporary folder with a virtual environment, and installers of pinned packages.
#
# It changes into the folder, which is removed when the script ends. The packages are installed without dependencies, so
# that nothing but the versions named here is run.
set -euo pipefail
folder=$(mktemp -d)
trap 'rm -rf "$folder"' EXIT
cd "$folder"
python3 -m venv venv

common=(
  numpy==2.4.6 scipy==1.17.1 pandas==3.1.1 matplotlib==3.11.2
  requests==2.34.2 urllib3==2.8.0 idna==3.20 certifi==2026.10.19.post1 charset-normalizer==3.5.3 PyYAML==6.0.4
  python-dateutil==4.0.0 packaging==26.4 pillow==13.0.0 pyparsing==3.3.3 kiwisolver==1.5.1 cycler==0.12.1
  fonttools==4.68.0 contourpy==1.3.3
)

install_optiland() {
  venv/bin/pip install --quiet --no-deps optiland==0.6.3 numba==0.68.1 llvmlite==0.50.0 vtk==9.7.2 "${common[@]}"
}

install_rayoptics() {
  venv/bin/pip install --quiet --no-deps rayoptics==0.9.8 opticalglass==1.1.1 anytree==2.13.0 json-tricks==3.17.3 \
    transforms3d==0.4.2 parsimonious==0.11.0 regex==2026.11.19 xlrd==2.0.2 openpyxl==3.1.5 et_xmlfile==2.0.0 \
    "${common[@]}"
}
