#!/usr/bin/env bash
# Makes the environment of this example in .venv beside it: py123d with all that it needs, nothing of LitSim.
# PYTHON names the interpreter, 3.11 (tried) to 3.13; EXTRAS are those of py123d. What is up to date is left alone.
set -euo pipefail
cd -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")"
python=${PYTHON:-python3.11} extras=${EXTRAS:-}
wanted=$(grep -o '^py123d==[0-9.]*' requirements.txt)
wanted=py123d${extras:+[$extras]}${wanted#py123d}
[ "$(cat .venv/.made-from 2>/dev/null)" = "$wanted" ] && exit 0

fail() {
  printf 'setup.sh: %s\n' "$1" >&2
  exit 1
}

"$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 13))' 2>/dev/null ||
  fail "'$python' is not a Python 3.11 to 3.13 that runs; name one: PYTHON=/path/to/python3.11"
unset PYTHONPATH PYTHONHOME # else pip would take packages of a ROS that the shell has sourced for installed
rm -rf .venv
"$python" -m venv .venv
echo '*' >.venv/.gitignore
touch .venv/COLCON_IGNORE
../../.venv/bin/uv pip install -q --python .venv/bin/python "$wanted" 2>/dev/null || # quicker
  .venv/bin/python -m pip --disable-pip-version-check install -qq "$wanted" ||
  fail "pip could not install $wanted; its message is above"
printf '%s\n' "$wanted" >.venv/.made-from
