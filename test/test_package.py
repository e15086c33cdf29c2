"""The package as a ROS workspace sees it: built by colcon, its executable started."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import time
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

import elevator_rectify
from elevator_rectify.live.demo import dds_environment

ROOT = Path(__file__).parent.parent
SOURCES = (
    *("package.xml", "setup.py", "setup.cfg", "elevator_rectify", "resource"),
    *("config", "launch", "bags", "LICENSE"),
)


def test_manifest_names_every_dependency() -> None:
    manifest = ET.parse(ROOT / "package.xml").getroot()
    assert manifest.findtext("version") == elevator_rectify.__version__ == "0.1.0"
    depends = {element.text for element in manifest.iter() if element.tag.endswith("depend")}
    assert {"rclpy", "python3-numpy", "python3-opencv", "sensor_msgs", "geometry_msgs", "diagnostic_msgs"} <= depends


@pytest.mark.skipif(
    shutil.which("colcon", path=str(Path(sys.executable).parent)) is None, reason="colcon is not installed"
)
def test_colcon_builds_and_the_executable_runs(tmp_path: Path) -> None:
    source = tmp_path / "src" / "elevator_rectify"
    source.mkdir(parents=True)
    for name in SOURCES:
        path = ROOT / name
        copy = shutil.copytree if path.is_dir() else shutil.copy
        copy(path, source / name)
    environment = {**dds_environment(79), "AMENT_PREFIX_PATH": sys.prefix}
    colcon = Path(sys.executable).parent / "colcon"
    built = subprocess.run(
        [colcon, "build"], cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=200, check=False
    )
    assert built.returncode == 0, built.stderr
    prefix = tmp_path / "install" / "elevator_rectify"
    assert (prefix / "share" / "elevator_rectify" / "package.xml").exists()
    assert (prefix / "share" / "ament_index" / "resource_index" / "packages" / "elevator_rectify").exists()
    for name in ("config/fastdds.xml", "config/realsense.yaml", "bags/paper_5x5/metadata.yaml"):
        assert (prefix / "share" / "elevator_rectify" / name).exists()
    site = next(prefix.glob("lib/python3*/site-packages"))
    run_executable(prefix / "lib" / "elevator_rectify" / "node", {**environment, "PYTHONPATH": str(site)})


def run_executable(executable: Path, environment: dict[str, str]) -> None:
    """Start it as ros2 run does, give it time to come up, and end it as Ctrl-C does."""
    process = subprocess.Popen(
        [executable], env={**os.environ, **environment}, cwd="/", stderr=subprocess.PIPE, text=True
    )
    try:
        time.sleep(4.0)
        assert process.poll() is None
        process.send_signal(signal.SIGINT)
        assert process.wait(timeout=10.0) == 0
        assert process.stderr is not None and "Traceback" not in process.stderr.read()
    finally:
        if process.poll() is None:
            process.kill()
            process.wait()
