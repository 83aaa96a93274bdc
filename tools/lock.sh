#!/usr/bin/env bash
# Writes requirements/locked/*.txt: every package that the set-up installs, with its version, those of constraints.txt, and
# the hashes of its files. Asks pip's package index, with uv. Torch is not among them: its builds come from several indexes.
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
for extra in dev maps live film ray; do lock "$extra" "$extra"; done
