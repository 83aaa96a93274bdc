#!/usr/bin/env bash
# Makes the environment of this example in .venv beside it: ROS 2 from wheels and the planner, nothing of LitSim.
# PYTHON names the interpreter, 3.11 (tried) or 3.12; a C compiler is needed. What is up to date is left alone.
set -euo pipefail
cd -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")"
root=../..
key=$(cat requirements.txt "$root/requirements/ros.txt" "$root/requirements/constraints.txt" | sha256sum)
[ "$(cat .venv/.made-from 2>/dev/null)" = "$key" ] && exit 0

fail() {
  printf 'setup.sh: %s\n' "$1" >&2
  exit 1
}

python=${PYTHON:-python3.11}
"$python" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' 2>/dev/null ||
  fail "'$python' is not a Python 3.11 or 3.12 that runs; name one: PYTHON=/path/to/python3.11"
unset PYTHONPATH PYTHONHOME # else pip would take packages of a ROS that the shell has sourced for installed
rm -rf .venv
"$python" -m venv .venv
echo '*' >.venv/.gitignore
touch .venv/COLCON_IGNORE
grep -v '^protobuf==' "$root/requirements/constraints.txt" >.venv/constraints.txt # the planner needs an older one than ONNX
wanted=(-c .venv/constraints.txt -r "$root/requirements/ros.txt" -r requirements.txt)
"$root/.venv/bin/uv" pip install -q --compile-bytecode --python .venv/bin/python "${wanted[@]}" 2>/dev/null || # quicker
  .venv/bin/python -m pip --disable-pip-version-check install -qq "${wanted[@]}" ||
  fail "pip could not install the packages; its message is above"
.venv/bin/python "$root/tools/ros_prefix.py" >/dev/null
printf '%s\n' "$key" >.venv/.made-from
