#!/usr/bin/env bash
# Checks the device against the CPU, then times all engines, and keeps the numbers:
#   scripts/bench.sh [FILE]     default: benches/results/<adapter>.json
# SIZES, SWEEPS, REPEATS and ADAPTER override what is measured, and ARGUMENTS adds options of `lumenmesh
# bench`. The sizes are those of the targets: 512x512 and 2048x2048 faces with 10 million points, the
# published 12x5 with few and with many, and two skews.
#
# On a machine without Rust, LUMENMESH and TESTS name a command and a test binary (tests/gpu) that were built
# elsewhere: nothing is built then. Tests that need the sources or a command at its place are left out. PEER
# is a command that is timed before and after ours, such as another implementation on the same device; its
# output goes to FILE.peer.
set -euo pipefail
cd "$(dirname "$0")/.."
sizes=${SIZES:-12x5x1e4,12x5x1e6,512x512x1e6,512x512x1e7,2048x2048x1e7,512x512x1e6:crowded,512x512x1e6:half}
sweeps=${SWEEPS:-90x1e5,512x1e6,512x1e7}
adapter=(${ADAPTER:+--adapter "$ADAPTER"})
read -ra more <<<"${ARGUMENTS:-}"
export XDG_RUNTIME_DIR="${XDG_RUNTIME_DIR:-$(mktemp -d)}"
export LUMENMESH_REQUIRE_GPU=1 ${ADAPTER:+LUMENMESH_ADAPTER="$ADAPTER"}

if [ -z "${LUMENMESH:-}" ]; then
  cargo build --release --bin lumenmesh
  LUMENMESH=target/release/lumenmesh
fi
"$LUMENMESH" devices
if [ -n "${TESTS:-}" ]; then
  "$TESTS" --skip shaders:: --skip devices_command:: --skip any_number_of_threads --skip recordings:: \
    --skip the_sweep_s_error_is_the_cpu_s
elif command -v cargo >/dev/null; then
  cargo test --release --test gpu
else
  echo "TESTS names no test binary: the device is compared with the CPU by the bench alone"
fi

run=$(mktemp) peer=$(mktemp)
trap 'rm -f "$run" "$peer"' EXIT
if [ -n "${PEER:-}" ]; then bash -c "$PEER" | tee -a "$peer"; fi
"$LUMENMESH" bench --sizes "$sizes" --sweeps "$sweeps" --repeats "${REPEATS:-5}" "${adapter[@]}" "${more[@]}" --json >"$run"
if [ -n "${PEER:-}" ]; then bash -c "$PEER" | tee -a "$peer"; fi
name=$(sed -n 's/^  "adapter": "\([^"(]*[^"( ]\).*/\1/p' "$run" | tr ' A-Z' '-a-z' | tr -cd 'a-z0-9-')
file=${1:-benches/results/${name:-cpu}.json}
{
  printf '{\n  "date": "%s",\n  "commit": "%s",\n' "$(date -u +%F)" "$(git describe --always --dirty 2>/dev/null || echo unknown)"
  printf '  "processor": "%s",\n' "$(sed -n 's/^model name.*: //p' /proc/cpuinfo 2>/dev/null | head -n 1)"
  printf '  "rustc": "%s",\n' "$(rustc --version 2>/dev/null || echo "built elsewhere")"
  printf '  "load": "%s",\n' "$(cut -d' ' -f1-3 /proc/loadavg 2>/dev/null)"
  tail -n +2 "$run"
} >"$file"
if [ -n "${PEER:-}" ]; then cp "$peer" "$file.peer"; fi
echo "wrote $file"
