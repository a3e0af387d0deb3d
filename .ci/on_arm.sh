#!/bin/sh
# Smoke test on 64-bit ARM Linux, emulated by QEMU: the import, seven solves and a verified proof.
#     sh .ci/on_arm.sh [FOLDER]
# On Debian or Ubuntu, x86-64. apt downloads QEMU and a Python for ARM, pip the wheels; both go to FOLDER (default:
# a new one), 1 GB, and nothing is installed in the system. pyamg has no wheel for ARM and is left out.
set -eu
root=$(cd "$(dirname "$0")/.." && pwd)
folder=${1:-$(mktemp -d)}
mkdir -p "$folder/apt/lists/partial" "$folder/apt/archives/partial" "$folder/debs" "$folder/system"
cd "$folder/debs"

apt-get download qemu-user-static
of_arm="-o APT::Architecture=arm64 -o APT::Architectures=arm64 -o Dir::State::Lists=$folder/apt/lists
    -o Dir::Cache::Archives=$folder/apt/archives -o Dir::State::Status=$folder/apt/status -o Dir::Cache::pkgcache=
    -o Dir::Cache::srcpkgcache="
touch "$folder/apt/status"
apt-get $of_arm -qq update || true # repositories without ARM
apt-get $of_arm -qq --yes --no-install-recommends --download-only install python3 libstdc++6 libgcc-s1
mv "$folder"/apt/archives/*.deb .
for package in *.deb; do dpkg-deb -x "$package" "$folder/system"; done
[ -e "$folder/system/lib" ] || ln -s usr/lib "$folder/system/lib"

version=$(ls "$folder/system/usr/bin" | sed -n 's/^python3\.\([0-9]*\)$/3.\1/p')
platforms=$(for minor in 17 24 26 27 28 31 34; do echo "--platform manylinux_2_${minor}_aarch64"; done)
python3 -m pip install --quiet --target "$folder/packages" --upgrade --only-binary=:all: --python-version "$version" \
    --implementation cp $platforms --platform manylinux2014_aarch64 numpy scipy numba qdldl daqp piqp clarabel

cat > "$folder/solves.py" <<'PYTHON'
import platform

import numpy as np
import scipy.sparse as sp

import lcp_plugin
from lcp_plugin import LCP, FrictionalContact, QuadraticProgram, gallery, solve

random = np.random.default_rng(0)
B = random.normal(size=(40, 40))
dense = LCP(B @ B.T + np.eye(40), random.normal(size=40))
string = sp.diags_array([-1.0, 2.0, -1.0], offsets=[-1, 0, 1], shape=(300, 300), format="csr")
block = 2.0 * np.eye(3), np.array([[0.0, 0.0, 1.0]]), np.array([[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0]]])
solves = {
    "dense LCP": (dense, {}),
    "Lemke's method": (dense, {"algorithm": "lemke"}),
    "npsor": (gallery.build("obstacle_2d", size=15).problem, {"algorithm": "npsor"}),
    "obstacle in one dimension": (LCP(string, np.full(300, 1e-4), lower=-0.1), {}),
    "obstacle in two dimensions": (gallery.build("obstacle_2d", size=30).problem, {}),
    "quadratic program": (QuadraticProgram(np.eye(3), -np.ones(3), G=[[1.0, 1.0, 1.0]], h=[1.0]), {}),
    "contact with friction": (FrictionalContact(block, [0.05, 0.0, -0.08], 0.4), {}),
}
print(platform.machine(), platform.python_version(), lcp_plugin.__version__)
for name, (problem, options) in solves.items():
    result = solve(problem, **options).require_solved()
    print(f"{name}: {result.status.name} by {result.algorithm}, {result.seconds:.2f} s")
assert solve(LCP([[0.0]], [-1.0])).proof.verify()
print("a proof of infeasibility is verified")
PYTHON
PYTHONPATH="$folder/packages:$root" OMP_NUM_THREADS=1 NUMBA_CACHE_DIR="$folder/cache" \
    "$folder/system/usr/bin/qemu-aarch64-static" -L "$folder/system" "$folder/system/usr/bin/python$version" \
    "$folder/solves.py"
