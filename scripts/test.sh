#!/usr/bin/env bash
# Installs what the tests need and runs all of them.
#
# On Debian and Ubuntu, as root or with sudo, missing pieces come from apt: the software Vulkan driver where no
# adapter is found, Octave, Chromium, Gmsh, libOpenIGTLink, and a Python environment with VTK, SimpleITK, pynrrd, trimesh,
# PyMeshLab, pyigtl and mcap under target/. Tests
# whose tool or data is still missing say SKIPPED; with LUMENMESH_REQUIRE_GPU=1, LUMENMESH_REQUIRE_DATA=1 or LUMENMESH_REQUIRE_TOOLS=1 they
# fail instead. LUMENMESH_SHARED names the folder of recordings and truth surfaces (default: ../shared).
#
#   scripts/test.sh             # everything that takes minutes
#   scripts/test.sh --release   # before a release: also the tests that take long, which are ignored otherwise
set -euo pipefail
cd "$(dirname "$0")/.."

# Some drivers complain where there is no such folder, as on a server.
export XDG_RUNTIME_DIR="${XDG_RUNTIME_DIR:-$(mktemp -d)}"

say() { printf '\n== %s\n' "$*"; }

apt_install() {
  command -v apt-get >/dev/null || { echo "no apt-get here; missing: $*"; return 1; }
  local sudo=""
  [ "$(id -u)" = 0 ] || sudo="sudo -n"
  $sudo apt-get update -qq && DEBIAN_FRONTEND=noninteractive $sudo apt-get install -y -qq --no-install-recommends "$@" >/dev/null
}

# One choice of packages and features for all: with another, Cargo would build every dependency again. The Python package has
# no tests in Rust, but asks for features of others.
chosen=(--all-features -p lumenmesh -p lumenmesh-capi -p lumenmesh-python)
say "building"
cargo test "${chosen[@]}" --no-run

say "adapters"
if ! target/debug/lumenmesh devices --json | grep -q '"name"'; then
  echo "no adapter: installing the software Vulkan driver"
  apt_install mesa-vulkan-drivers libvulkan1 || true
fi
target/debug/lumenmesh devices || true

say "other tools"
command -v octave-cli >/dev/null || apt_install octave || echo "octave-cli is missing: its tests will be skipped"
[ -d /usr/include/openigtlink ] || apt_install libopenigtlink-dev || echo "libopenigtlink-dev is missing: its test will be skipped"
for tool in cmake g++ pkg-config valgrind chromium gmsh; do
  command -v "$tool" >/dev/null || apt_install "$tool" || echo "$tool is missing: its tests will be skipped"
done
if [ -z "${LUMENMESH_PYTHON:-}" ]; then
  venv=target/python
  if ! "$venv/bin/python" -c 'import numpy, scipy, vtk, SimpleITK, nrrd, trimesh, pymeshlab, pyigtl, mcap' 2>/dev/null; then
    apt_install libgl1 libopengl0 libfontconfig1 libxrender1 || true
    { python3 -m venv "$venv" && "$venv/bin/pip" install -q --disable-pip-version-check numpy scipy vtk SimpleITK pynrrd trimesh pymeshlab pyigtl mcap; } ||
      echo "no Python with VTK, SimpleITK, pynrrd, trimesh, PyMeshLab, pyigtl and mcap: its tests will be skipped"
  fi
  if "$venv/bin/python" -c 'import numpy, scipy, vtk, SimpleITK, nrrd, trimesh, pymeshlab, pyigtl, mcap' 2>/dev/null; then export LUMENMESH_PYTHON="$PWD/$venv/bin/python"; fi
fi

log=$(mktemp)
trap 'rm -f "$log"' EXIT
status=0
run() {
  say "$*"
  "$@" 2>&1 | tee -a "$log" || status=1
}

run cargo test "${chosen[@]}"
# The comparisons that other devices need, which do not compute f32 as the CPU does.
run env LUMENMESH_WITHIN_ROUNDING=1 cargo test "${chosen[@]}" --test gpu -- grouping:: measure:: update:: sweep_passes::
# The Python package, as it is installed.
if [ -x target/python/bin/python ]; then
  python=target/python/bin/python
  run "$python" -m pip install -q --disable-pip-version-check maturin pytest mypy pyvista trimesh playwright pillow markdown-it-py 'dask[distributed]'
  rm -rf target/wheels
  run target/python/bin/maturin build --quiet --profile dev --features pyo3/extension-module,as-tested \
    --manifest-path python/Cargo.toml -i "$python" -o target/wheels
  run "$python" -m pip install -q --disable-pip-version-check --force-reinstall --no-deps target/wheels/*.whl
  run "$python" -m pytest -q python/tests
  run "$python" -m mypy.stubtest lumenmesh
  # The documentation: its links and examples, and the notices of all packages, also those of other platforms.
  run cargo fetch --quiet --locked
  run "$python" -m pytest -q -rs tests/docs
  # The page that shows a vessel, in Chromium.
  run "$python" -m pytest -q -rs tests/viewer
else
  echo "SKIPPED: the Python package, the documentation and the page: no Python with NumPy under target/"
  [ "${LUMENMESH_REQUIRE_TOOLS:-}" != 1 ] || status=1
fi
run cargo test "${chosen[@]}" --bench distance --bench fit --bench live --bench openigtlink -- --test
if [ "${1:-}" = --release ]; then
  # The large sizes need an optimised build: about ten minutes on a software device.
  run cargo test --release --all-features --test gpu -- --ignored --nocapture
fi

say "summary"
grep -h '^SKIPPED' "$log" | sort -u || true
awk '/^test result:/ { passed += $4; failed += $6 }
     /^[0-9].* (passed|failed).* in [0-9.]+s/ { for (i = 2; i <= NF; i++) { if ($i ~ /^passed/) passed += $(i - 1); if ($i ~ /^failed/) failed += $(i - 1) } }
     END { printf "%d passed, %d failed\n", passed, failed; exit passed == 0 }' "$log" || status=1
exit "$status"
