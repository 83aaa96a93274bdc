#!/usr/bin/env bash
# Starts the adapter in its own environment, with no trace of LitSim in it; arguments as of any node (--ros-args -p ...).
set -euo pipefail
here=$(cd -- "$(dirname -- "$(readlink -f -- "${BASH_SOURCE[0]}")")" && pwd)
[ -f "$here/.venv/.made-from" ] || { printf 'run.sh: no environment; run %s/setup.sh first\n' "$here" >&2; exit 2; }
unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
# shellcheck disable=SC1091
source "$here/.venv/setup.bash"
export ROS_AUTOMATIC_DISCOVERY_RANGE=${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}
exec "$here/.venv/bin/python" "$here/adapter.py" "$@"
