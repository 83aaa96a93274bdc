#!/usr/bin/env bash
# Writes requirements/locked/*.txt: every package that the set-up installs, with its version, those of constraints.txt, and
# the hashes of its files. Asks pip's package index, with uv. Torch has two: torch.txt is that index's build, with GPU
# libraries; torch-cpu.txt the CPU build, which is in PyTorch's index alone.
set -euo pipefail
cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.."

lock() { # NAME FILE...
  local name=$1 words=()
  shift
  for file in "$@"; do words+=("requirements/$file.txt"); done
  printf 'lock: requirements/locked/%s.txt\n' "$name"
  .venv/bin/uv pip compile --quiet --universal --python-version 3.11 --generate-hashes --no-annotate \
    --custom-compile-command 'make lock' -c requirements/constraints.txt "${words[@]}" -o "requirements/locked/$name.txt"
}

mkdir -p requirements/locked
lock installer installer
lock base ros run build
lock dev dev export
for extra in maps live ray search docs torch; do lock "$extra" "$extra"; done

# The CPU build for Linux on x86-64 of CPython 3.11 and 3.12, by the SHA-256 that PyTorch's index gives; both change with
# the version. What it needs beside is what the other build needs but for NVIDIA's libraries.
cpu_build=2.13.0+cpu
cpu_hashes=(
  6746dbcbeb526eb61330b76b41ff1b4eb848951103a892eeb080dfa2b264667b
  4ca4a9394b0c771238a4f73590fdbbc4debad85ed0fa63d026ae1b085da7d6e2
)
printf 'lock: requirements/locked/torch-cpu.txt\n'
{
  awk '/^#/ { keep = 1 } /^[a-z]/ { keep = !/^(torch|triton|cuda-|nvidia-)/ } keep' requirements/locked/torch.txt
  printf 'torch==%s' "$cpu_build"
  printf ' \\\n    --hash=sha256:%s' "${cpu_hashes[@]}"
  printf '\n'
} >requirements/locked/torch-cpu.txt
