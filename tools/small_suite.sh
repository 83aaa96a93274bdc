#!/bin/bash
# Makes the packaged suite `small` anew: 40 cases of generated traffic, 20 s each. A quarter of a minute; equal files each time.
#   tools/small_suite.sh [FOLDER]
set -e
cd "$(dirname "$0")/.."
out=${1:-src/litsim_sim/litsim_sim/suites}
data() { ./litsim litsim_sim data "$@"; }
rm -rf "$out/small" "$out/small.yaml"
mkdir -p "$out/small"
data synthesize --net us101_like --seconds 51.5 --seed 1 --out "$out/small/motorway.parquet"
data synthesize --net urban_like --seconds 75.5 --seed 5 --out "$out/small/street.parquet"
data segments "$out/small/motorway.parquet" "$out/small/street.parquet" --out "$out/small" \
  --simulation 17 --stride 5 --split 1 0 0
data suite "$out/small" --out "$out/small.yaml" \
  --events cut_in=13,hard_braking=1,leader_braking=6,lane_change=13,merge=4,crossing=7,left_turn=6 --hardest 40
