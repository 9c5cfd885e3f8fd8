#!/usr/bin/env bash
# Prints one hash for everything that the command computes from the shared recordings, and what it simulates:
#   scripts/fingerprint.sh [BINARY]      default: target/release/lumenmesh
# Two builds that print the same lines compute the same bytes: run it before and after a change that must change no
# result, and compare with diff. LUMENMESH_SHARED names the folder of recordings (default: ../shared). The backend gpu
# takes the best adapter, or the one that LUMENMESH_ADAPTER names; without one its lines say "no adapter".
set -euo pipefail
cd "$(dirname "$0")/.."
binary=$(realpath "${1:-target/release/lumenmesh}")
shared=$(realpath "${LUMENMESH_SHARED:-../shared}")
export XDG_RUNTIME_DIR="${XDG_RUNTIME_DIR:-$(mktemp -d)}"
adapter=(${LUMENMESH_ADAPTER:+--adapter "$LUMENMESH_ADAPTER"})
work=$(mktemp -d)
trap 'rm -rf "$work"' EXIT

backends=(cpu reference)
if "$binary" devices --json | grep -q '"name"'; then backends+=(gpu); else echo "gpu: no adapter"; fi

# Runs the command and prints the hash of what it wrote, or of why it refused.
hash_of() {
  local label=$1 file=$2
  shift 2
  if (cd "$work" && "$binary" "$@" >"$work/out" 2>"$work/err"); then
    printf '%s  %s\n' "$(sha256sum "$work/$file" | cut -c 1-16)" "$label"
  else
    printf '%s  %s (refused)\n' "$(sed "s|$shared||g" "$work/err" | sha256sum | cut -c 1-16)" "$label"
  fi
}

for recording in "$shared"/recordings/*.mat "$shared"/recordings/hard/*.mat; do
  name=${recording#"$shared/recordings/"}
  for backend in "${backends[@]}"; do
    chosen=(--backend "$backend")
    [ "$backend" = gpu ] && chosen+=("${adapter[@]}")
    hash_of "$name sweep $backend" mesh.vtp reconstruct "$recording" -o mesh.vtp "${chosen[@]}"
    for merge in stitch blend; do
      hash_of "$name cylinders $merge $backend" mesh.vtp \
        reconstruct "$recording" -o mesh.vtp --method cylinders --merge $merge --cylinders cylinders.csv "${chosen[@]}"
    done
    [ -e "$work/cylinders.csv" ] && printf '%s  %s\n' "$(sha256sum "$work/cylinders.csv" | cut -c 1-16)" "$name every cylinder $backend"
  done
  hash_of "$name sweep, poses corrected" mesh.vtp reconstruct "$recording" -o mesh.vtp --correct-poses --backend cpu
  hash_of "$name sweep, offset estimated" mesh.vtp reconstruct "$recording" -o mesh.vtp --estimate-offset --backend cpu
  hash_of "$name sweep, half-life" mesh.vtp reconstruct "$recording" -o mesh.vtp --half-life 30 --backend cpu
  hash_of "$name live sweep" mesh.vtp replay "$recording" -o mesh.vtp --backend cpu
  hash_of "$name live cylinders" mesh.vtp replay "$recording" -o mesh.vtp --method cylinders --backend cpu
  hash_of "$name info" out info "$recording" --json
done

aorta=$shared/data/aorta_adult_full_steve
noisy=$shared/recordings/adult_aorta_noisy.mat
hash_of "deviation, median, 24 x 8" mesh.ply reconstruct "$noisy" -o mesh.ply --method cylinders --nodes 24 --levels 8 \
  --outliers deviation --statistic median --iterations 5 --backend cpu
hash_of "evaluate" out evaluate "mesh.ply" --truth "$aorta.stl" --recording "$noisy" \
  --centreline "${aorta}_centreline.csv" --json
hash_of "sections" sections.csv sections mesh.ply "$noisy" --csv sections.csv
hash_of "simulated phantom" phantom.mat simulate --vessel side_branch --seed 3 --truth wall.vtp -o phantom.mat
hash_of "an offset in time" mesh.vtp reconstruct phantom.mat -o mesh.vtp --estimate-offset --correct-poses --backend cpu
hash_of "simulated in a surface" real.mat simulate --vessel "$shared/data/aorta_arch_coarctation_bpm120.stl" \
  --centreline "$shared/data/aorta_arch_coarctation_bpm120_centreline.csv" --cylinders -o real.mat
hash_of "pullback" pullback.mat import pullback "$shared/data/ivus_narco/ivus_rest/diastolic_contours.csv" --upright -o pullback.mat
hash_of "pullback along a centreline" pullback.mat import pullback \
  "$shared/data/ivus_narco/ivus_rest/diastolic_contours.csv" --centreline "$shared/data/ivus_narco/centerline_raw.csv" -o pullback.mat
hash_of "experiments" out experiments --quick --json
hash_of "picture" picture.png render wall.vtp -o picture.png --size 640x400
