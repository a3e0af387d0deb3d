#!/usr/bin/env bash
# Make an environment for several ranks from nothing on a Debian-like machine: Open MPI, PETSc, petsc4py, this package.
# usage: tests/distributed/environment.sh FOLDER [PYTHON]
#   FOLDER  of the virtual environment to make; PYTHON 3.11 or newer, python3 by default
set -euo pipefail

if [ $# -lt 1 ]; then
    sed -n '2,4s/^# //p' "$0" >&2
    exit 2
fi
folder=$1
python=${2:-python3}
root=$(cd "$(dirname "${BASH_SOURCE[0]}")/../.." && pwd)

as_root() {
    if [ "$(id -u)" -eq 0 ]; then "$@"; else sudo "$@"; fi
}

as_root apt-get update
as_root env DEBIAN_FRONTEND=noninteractive apt-get install --yes --no-install-recommends \
    build-essential libopenmpi-dev openmpi-bin libopenblas-dev python3-dev python3-venv

"$python" -m venv "$folder"
pip=("$folder/bin/python" -m pip)
"${pip[@]}" install --upgrade pip setuptools wheel
"${pip[@]}" install cython numpy

# PETSc is built from source (some minutes); C only, so that no Fortran compiler is needed.
export MPICC=mpicc MPICXX=mpicxx
export PETSC_CONFIGURE_OPTIONS="--with-fc=0 --with-debugging=0"
"${pip[@]}" install mpi4py petsc
"${pip[@]}" install --no-build-isolation petsc4py

"${pip[@]}" install --editable "${root}[test]"
"$folder/bin/python" -c "
from petsc4py import PETSc
import mpi4py, lcp_plugin.ranks.petsc
print('PETSc', '.'.join(map(str, PETSc.Sys.getVersion())), '· mpi4py', mpi4py.__version__, '· ready')"
echo "$folder/bin/python -m pytest $root/tests/distributed"
