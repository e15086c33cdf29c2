"""Builds the stand-ins for message packages that are not on PyPI into this Python's environment, for the tests.

Where a package is installed already (on a robot with its ROS sourced), the real one is used and nothing is built.
"""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

import numpy as np

HERE = Path(__file__).parent
# Beside this package: a part of the product, not a stand-in.
OURS = "elevator_rectify_interfaces"
PACKAGES = {"vision_msgs": HERE / "vision_msgs", "tf2_msgs": HERE / "tf2_msgs", OURS: HERE.parent.parent / OURS}
PREFIX = Path(sys.prefix)


def point_to_this_machine() -> None:
    """Replace the folders of the wheels' build machine in their CMake files by this machine's."""
    python = f"python{sys.version_info.major}.{sys.version_info.minor}"
    there = Path("/opt/python") / f"cp{sys.version_info.major}{sys.version_info.minor}"
    there = there.with_name(f"{there.name}-{there.name}")
    # Wheels for another NumPy name its folder core instead of _core.
    folders = {
        str(there / "include" / python): sysconfig.get_path("include"),
        **{
            str(there / "lib" / python / "site-packages" / "numpy" / core / "include"): np.get_include()
            for core in ("_core", "core")
        },
    }
    for path in PREFIX.glob("share/*/cmake/*.cmake"):
        text = path.read_text()
        new = text
        for old, here in folders.items():
            new = new.replace(old, here)
        if new != text:
            path.write_text(new)


def build(package: str, folder: Path) -> None:
    """Configure, compile and install one package."""
    environment = {**os.environ, "CMAKE_PREFIX_PATH": str(PREFIX), "AMENT_PREFIX_PATH": str(PREFIX)}
    cmake = str(Path(sysconfig.get_path("scripts")) / "cmake")
    options = [f"-DCMAKE_INSTALL_PREFIX={PREFIX}", "-DBUILD_TESTING=OFF", f"-DPython3_EXECUTABLE={sys.executable}"]
    steps = {
        "configuring": [cmake, "-S", str(PACKAGES[package]), "-B", str(folder), *options],
        "compiling": [cmake, "--build", str(folder), "--parallel", str(os.cpu_count() or 1)],
        "installing": [cmake, "--install", str(folder)],
    }
    for name, command in steps.items():
        print(f"{package}: {name} ...", flush=True)
        done = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
        if done.returncode:
            sys.exit(f"{package}: {name} failed\n{done.stdout[-3000:]}\n{done.stderr[-3000:]}")


def installed(package: str) -> bool:
    """Tell whether Python has the package: a folder of that name, such as the ones here, has no origin."""
    spec = importlib.util.find_spec(package)
    return spec is not None and spec.origin is not None


def changed(package: str) -> bool:
    """Tell whether the sources are younger than what was built of them here."""
    built = PREFIX / "share" / package / "package.xml"
    sources = [path.stat().st_mtime for path in PACKAGES[package].rglob("*") if path.is_file()]
    return built.exists() and max(sources) > built.stat().st_ctime


def main() -> None:
    """Build what is missing."""
    missing = [package for package in PACKAGES if not installed(package) or changed(package)]
    if not missing:
        return
    point_to_this_machine()
    with tempfile.TemporaryDirectory() as folder:
        for package in missing:
            build(package, Path(folder) / package)


if __name__ == "__main__":
    main()
