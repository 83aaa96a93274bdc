"""Make a virtual environment that holds the ROS 2 wheels look like /opt/ros/jazzy.

    .venv/bin/python tools/ros_prefix.py

The wheels install into the environment as one merged ament prefix. Three things are missing before colcon and CMake can
build on it; this script adds them. It is run after every pip install and may be run as often as one likes.

1. The exported CMake targets name the Python and numpy headers of the machine that built the wheels.
2. There are no local_setup.* and setup.* files, so a workspace cannot name this prefix as its underlay.
3. Only a .pth file sets LD_LIBRARY_PATH, by starting Python a second time. The setup files set it beforehand, and say
   so in a variable that the .pth file heeds.
"""

from __future__ import annotations

import argparse
import re
import sys
import sysconfig
from pathlib import Path

import numpy as np

HEADERS_OF_BUILDER = re.compile(
    r"/opt/python/cp3\d+-cp3\d+/[^;\"]*?(include/python3\.\d+|numpy/(?:_core|core)/include)"
)

LOCAL_SETUP = """\
# Written by tools/ros_prefix.py. Source it, from any POSIX shell, as one would /opt/ros/jazzy/setup.bash.
_litsim_prepend() {{  # VARIABLE DIRECTORY: put it first, once
  eval "_litsim_value=\\"\\${{$1:-}}\\""
  case ":$_litsim_value:" in
    *":$2:"*) ;;
    *) export "$1=$2${{_litsim_value:+:$_litsim_value}}" ;;
  esac
  unset _litsim_value
}}
{prepends}
unset -f _litsim_prepend
export VIRTUAL_ENV='{prefix}'  # CMake then looks for Python here first
export ROS_VERSION=2
export ROS_PYTHON_VERSION=3
export ROS_DISTRO=jazzy
# LD_LIBRARY_PATH is complete: the wheels' start-up hook need not start Python again.
export _ROS_WHEELS_BOOTSTRAP_COMPLETE=1
"""


def point_cmake_at_our_headers(prefix: Path) -> int:
    """Rewrite the include paths in the exported targets (gap 1). Returns how many files were changed."""
    python_include = sysconfig.get_paths()["include"]

    def ours(match: re.Match[str]) -> str:
        return python_include if match[1].startswith("include/") else np.get_include()

    changed = 0
    for path in prefix.glob("share/*/cmake/*Export.cmake"):
        text = path.read_text()
        rewritten = HEADERS_OF_BUILDER.sub(ours, text)
        if rewritten != text:
            path.write_text(rewritten)
            changed += 1
    return changed


def write_setup_files(prefix: Path) -> None:
    """Write {local_setup,setup}.{sh,bash,zsh} (gaps 2 and 3). All do the same, for this prefix has no underlay."""
    site_packages = Path(sysconfig.get_paths()["purelib"])
    libraries = [*sorted(site_packages.glob("ros_*.libs")), prefix / "lib"]
    paths = [("LD_LIBRARY_PATH", path) for path in libraries]
    paths += [("AMENT_PREFIX_PATH", prefix), ("PATH", prefix / "bin")]
    prepends = "\n".join(f"_litsim_prepend {name} '{path}'" for name, path in paths)
    main = prefix / "local_setup.sh"
    main.write_text(LOCAL_SETUP.format(prepends=prepends, prefix=prefix))
    for name in ("local_setup.bash", "local_setup.zsh", "setup.sh", "setup.bash", "setup.zsh"):
        (prefix / name).write_text(f". '{main}'\n")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.parse_args()
    prefix = Path(sys.prefix)
    if sys.prefix == sys.base_prefix or not (prefix / "share/ament_index").is_dir():
        print(f"ros_prefix: {prefix} is not a virtual environment with the ROS wheels in it", file=sys.stderr)
        return 1
    (prefix / "COLCON_IGNORE").touch()  # the wheels carry package.xml files; colcon must not build those
    changed = point_cmake_at_our_headers(prefix)
    write_setup_files(prefix)
    print(f"ros_prefix: {prefix} is ready ({changed} CMake files adapted); next: source {prefix}/setup.bash")
    return 0


if __name__ == "__main__":
    sys.exit(main())
