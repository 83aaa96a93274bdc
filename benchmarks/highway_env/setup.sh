#!/usr/bin/env bash
# Makes the environment .venv beside this file, in which highway-env is stepped for comparison. Optional: `make bench` goes
# on without it where it cannot be had.
set -euo pipefail
cd -- "$(dirname -- "${BASH_SOURCE[0]}")"
[ .venv/.ready -nt requirements.txt ] && exit 0
rm -rf .venv
../../.venv/bin/python -m venv .venv
.venv/bin/python -m pip install -q --disable-pip-version-check -r requirements.txt
touch .venv/.ready
