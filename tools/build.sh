#!/usr/bin/env bash
# Builds the workspace on the environment of tools/bootstrap.sh, if anything that a build reads has changed.
set -euo pipefail

if [ $# -gt 0 ]; then
  cat <<'TEXT'
Usage: tools/build.sh   (make build)

colcon build --symlink-install into build/, install/ and log/. Python sources are linked, so that only messages, build
descriptions and the set of data files call for another build. Then the kernels (litsim_sim/kernels/compiled.py) are compiled
beside their sources. On stock ROS 2 Jazzy, use plain `colcon build`, and `ros2 run litsim_sim compile` after it.
TEXT
  exit 0
fi

cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.."
stamp=install/.litsim-build
exec 9<tools/build.sh
flock 9 # one build at a time

if [ -f install/setup.sh ] && ! grep -qF "COLCON_CURRENT_PREFIX=$PWD/install" install/setup.sh; then
  echo "build: this checkout is a copy, whose build/ and install/ are those of the original: they are made anew"
  rm -rf build install log
fi

# What a build reads: the content of descriptions and messages, the names of files that it links one by one, and the
# environment at its place.
key=$(
  {
    echo "$PWD"
    cat .venv/.litsim-packages colcon.meta tools/build.sh
    find src -path '*/__pycache__' -prune -o -type f -path 'src/*/config/*' -print -o -type f -path 'src/*/launch/*' -print | sort
    find src -type f \( -name package.xml -o -name setup.py -o -name setup.cfg -o -name CMakeLists.txt -o -name '*.msg' \
      -o -name '*.srv' \) -print0 | sort -z | xargs -0 sha256sum
  } | sha256sum
)
# What kernels are made of, as far as it is cheap to say (what else there is, the first start finds out), and how many lie
# beside their sources, which are none after `make clean`.
kernels_key() {
  {
    cat .venv/.litsim-packages
    { grep -rlZ --include='*.py' '^@kernel$' src || true; } | sort -z | xargs -0r sha256sum
    find src \( -name '*.nbi' -o -name '*.kernel' \) -printf .
  } | sha256sum
}

compile_kernels() {
  PYTHONPATH=$(printf '%s:' src/litsim_*) .venv/bin/python -m litsim_sim.cli.compile
}

# Bytecode of the workspace's modules, what is not up to date. Python writes it by itself when it imports a module, but not
# where PYTHONDONTWRITEBYTECODE is set, and then each of a run's processes would compile them anew.
compile_modules() {
  .venv/bin/python -m compileall -q src/litsim*/litsim* install/litsim_msgs/lib/python*/site-packages/litsim_msgs
}

if [ -f "$stamp" ] && [ "$(cat "$stamp")" = "$key" ]; then
  if [ "$(cat install/.litsim-kernels 2>/dev/null)" != "$(kernels_key)" ]; then
    compile_kernels
    kernels_key >install/.litsim-kernels
  fi
  compile_modules
  exit 0
fi

# A ROS 2 that the shell has sourced would become a second underlay, of another build.
unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
# shellcheck disable=SC1091
source .venv/setup.bash

# CMake's cache holds absolute paths and the interpreter: it is good for one place and one environment.
made_for="$PWD $(python -VV)"
if [ -d build ] && [ "$(cat build/.litsim-made-for 2>/dev/null)" != "$made_for" ]; then
  rm -rf build install log
fi
# Packages of Python are made anew, in seconds: colcon keeps links to files and scripts that are gone.
for package in src/*/setup.py; do
  package=$(basename "$(dirname "$package")")
  rm -rf "build/$package" "install/$package"
done
mkdir -p build
printf '%s\n' "$made_for" >build/.litsim-made-for

echo "build: colcon build (half a minute the first time)"
# Of the messages, only what Python nodes load: the rest is for C++ nodes, and takes half of the time. Without MAKEFLAGS,
# colcon starts no second compiler on a machine that is busy already.
export MAKEFLAGS=${MAKEFLAGS:--j$(nproc)}
rm -f "$stamp"
compile_kernels & # needs nothing of the build, which does not keep all processors busy
compiling=$!
colcon build --symlink-install --event-handlers console_direct- --cmake-args -G Ninja -DLITSIM_PYTHON_ONLY=ON ||
  { echo "build: colcon failed; its whole output is in log/latest_build" >&2; exit 1; }
printf '%s\n' "$key" >"$stamp"
wait "$compiling"
kernels_key >install/.litsim-kernels
compile_modules
