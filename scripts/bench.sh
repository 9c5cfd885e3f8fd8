#!/usr/bin/env bash
# Checks the device against the CPU, then times all engines, and keeps the numbers:
#   scripts/bench.sh [FILE]     default: benches/results/<adapter>.json
# SIZES, SWEEPS, REPEATS and ADAPTER override what is measured. The sizes are those of the targets: 512x512 and 2048x2048
# faces with 10 million points, the published 12x5 with few and with many, and two skews.
set -euo pipefail
cd "$(dirname "$0")/.."
sizes=${SIZES:-12x5x1e4,12x5x1e6,512x512x1e6,512x512x1e7,2048x2048x1e7,512x512x1e6:crowded,512x512x1e6:half}
sweeps=${SWEEPS:-90x1e5,512x1e6,512x1e7}
adapter=(${ADAPTER:+--adapter "$ADAPTER"})
export XDG_RUNTIME_DIR="${XDG_RUNTIME_DIR:-$(mktemp -d)}"

cargo build --release --bin lumenmesh
target/release/lumenmesh devices
LUMENMESH_REQUIRE_GPU=1 cargo test --release --test gpu

run=$(mktemp)
trap 'rm -f "$run"' EXIT
target/release/lumenmesh bench --sizes "$sizes" --sweeps "$sweeps" --repeats "${REPEATS:-5}" "${adapter[@]}" --json >"$run"
name=$(sed -n 's/^  "adapter": "\([^"(]*[^"( ]\).*/\1/p' "$run" | tr ' A-Z' '-a-z' | tr -cd 'a-z0-9-')
file=${1:-benches/results/${name:-cpu}.json}
{
  printf '{\n  "date": "%s",\n  "commit": "%s",\n' "$(date -u +%F)" "$(git describe --always --dirty)"
  printf '  "processor": "%s",\n' "$(sed -n 's/^model name.*: //p' /proc/cpuinfo 2>/dev/null | head -n 1)"
  printf '  "rustc": "%s",\n  "load": "%s",\n' "$(rustc --version)" "$(cut -d' ' -f1-3 /proc/loadavg 2>/dev/null)"
  tail -n +2 "$run"
} >"$file"
echo "wrote $file"
