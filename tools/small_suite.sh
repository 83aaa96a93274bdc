#!/bin/bash
# Makes the packaged suite `small` anew: 40 cases of generated traffic, 20 s each. A minute or two; equal files each time.
#   tools/small_suite.sh [FOLDER]
set -e
cd "$(dirname "$0")/.."
out=${1:-src/litsim_eval/litsim_eval/suites}
made=$(mktemp -d)
trap 'rm -rf "$made"' EXIT
data() { ./litsim data "$@"; }
cut() { data segments "$made/$1.parquet" --out "$made/$1" --simulation 17 --stride "$2" --split 1 0 0; }
data synthesize --net us101_like --seconds 54.1 --seed 1 --out "$made/motorway.parquet"
data synthesize --net urban_like --seconds 300 --seed 5 --out "$made/street.parquet"
cut motorway 17
cut street 5
rm -rf "$out/small" "$out/small.yaml"
data suite "$made/motorway" "$made/street" --out "$out/small.yaml" --pack --hardest 40 \
  --events cut_in=13,hard_braking=3,leader_braking=5,lane_change=12,merge=4,crossing=6,left_turn=5
