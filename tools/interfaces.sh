#!/usr/bin/env bash
# Builds message packages of others on the environment of tools/bootstrap.sh, in a folder outside of this workspace.
set -euo pipefail

usage() {
  cat <<'TEXT'
Usage: tools/interfaces.sh FOLDER     such as ../interfaces

Clones the message packages of Autoware, tf2, Ackermann and simulation_interfaces at pinned commits into FOLDER/src, and
builds of them what Python nodes load: about six minutes. Source FOLDER/install/setup.bash before ./litsim, and its nodes
find them. On stock ROS 2 Jazzy, apt has them: apt install ros-jazzy-autoware-msgs ros-jazzy-autoware-adapi-v1-msgs
ros-jazzy-tf2-msgs ros-jazzy-ackermann-msgs ros-jazzy-simulation-interfaces
TEXT
}

# Repositories and commits; ament_cmake_auto is what the packages of Autoware are built with.
SOURCES="
autowarefoundation/autoware_msgs 7025d8f7df0ead43037d86f8a4ffda8b397d0293
autowarefoundation/autoware_adapi_msgs 35a7aeb97dfbbbc363c49fc032ded0c8ba172e24
ros2/geometry2 da10f77d98ab97d2dfdfa9bfc4c98042a8ad7c3d
ros-simulation/simulation_interfaces 172a1b1c1b3ced62b99cddae9b4143e5bcddee8a
ros-drivers/ackermann_msgs df2fe51eb04e8bd3c0ba4f8a6ded8aea3815b660
ros-geographic-info/geographic_info 2a0ae99219645b8d29772b997ef31f8e17345d52
ament/ament_cmake 08de9432ab83f96840fa1af4791f2d227bf62007
"
PACKAGES="ackermann_msgs autoware_adapi_v1_msgs autoware_control_msgs autoware_perception_msgs autoware_planning_msgs
autoware_vehicle_msgs simulation_interfaces tf2_msgs"

case ${1:-} in '' | -h | --help) usage; exit 0 ;; esac

root=$(cd -- "$(dirname -- "${BASH_SOURCE[0]}")/.." && pwd)
mkdir -p "$1/src"
cd -- "$1"
case $PWD/ in "$root"/*) echo "interfaces: $PWD is in this workspace, expected a folder outside of it" >&2; exit 2 ;; esac

while read -r repository commit; do
  [ -n "$repository" ] || continue
  folder=src/$(basename "$repository")
  [ "$(git -C "$folder" rev-parse HEAD 2>/dev/null)" = "$commit" ] && continue
  rm -rf "$folder"
  git init --quiet "$folder"
  git -C "$folder" fetch --quiet --depth 1 "https://github.com/$repository" "$commit"
  git -C "$folder" checkout --quiet "$commit"
done <<<"$SOURCES"
# The environment has the rest of ament_cmake already.
find src/ament_cmake -mindepth 1 -maxdepth 1 -type d ! -name ament_cmake_auto -exec touch {}/COLCON_IGNORE \;
# What C++ nodes would load takes half of the time (src/litsim_msgs/CMakeLists.txt).
python_only='list(FILTER AMENT_EXTENSIONS_rosidl_generate_idl_interfaces EXCLUDE REGEX'
python_only+=' "^rosidl_(generator_cpp|typesupport_cpp|typesupport_fastrtps_cpp|typesupport_introspection_cpp):")'
find src -name CMakeLists.txt -exec grep -q '^rosidl_generate_interfaces' {} \; ! -exec grep -q '^list(FILTER AMENT' {} \; \
  -exec sed -i "s/^rosidl_generate_interfaces/$python_only\n&/" {} \;

unset AMENT_PREFIX_PATH CMAKE_PREFIX_PATH COLCON_PREFIX_PATH LD_LIBRARY_PATH PYTHONPATH
# shellcheck disable=SC1091
source "$root/.venv/setup.bash"
export MAKEFLAGS=${MAKEFLAGS:--j$(nproc)}
# shellcheck disable=SC2086
colcon build --event-handlers console_direct- --packages-up-to $PACKAGES \
  --cmake-args -G Ninja -DBUILD_TESTING=OFF "-DCMAKE_BUILD_TYPE=${BUILD_TYPE-Release}"
echo "built; to use them: source $PWD/install/setup.bash"
