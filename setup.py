"""Install elevator_rectify: as an ament_python package with one executable a program, by pip with one command."""

import sys
from glob import glob
from pathlib import Path

from setuptools import find_packages, setup

NAME = "elevator_rectify"
PROGRAMS = """node lifecycle_node detector look teach calibrate_camera replay render make_bag play
demo press benchmark calibrate latency relay soak chaos""".split()  # noqa: SIM905
# colcon installs into lib/elevator_rectify, where `ros2 run` looks. pip installs into bin, where a program called
# `node` would hide Node.js: there the one command `elevator-rectify PROGRAM` serves.
BY_PIP = bool({"bdist_wheel", "dist_info", "editable_wheel"} & set(sys.argv))
COMMANDS = [f"{program} = {NAME}.programs:{program}" for program in PROGRAMS]


def files_below(folder: str) -> list[tuple[str, list[str]]]:
    """Return the data_files entries of a folder with all that is in it."""
    found: dict[str, list[str]] = {}
    for path in sorted(Path(folder).rglob("*")):
        if path.is_file():
            found.setdefault(f"share/{NAME}/{path.parent.as_posix()}", []).append(str(path))
    return sorted(found.items())


setup(
    name=NAME,
    version="0.1.0",
    description="Fits the button grid of an elevator panel, estimates its pose and rectifies its view.",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "core/**/*.json", "core/**/*.onnx", "core/**/*.onnx.xz", "train/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", [path for path in glob("config/*") if not path.endswith(".txt")]),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
        *files_below("bags/paper_5x5"),
    ],
    python_requires=">=3.10",
    # ROS brings its own NumPy and OpenCV: as wheels they would hide those.
    install_requires=["setuptools", *(["numpy", "opencv-python-headless"] if BY_PIP else [])],
    extras_require={"test": ["pytest", "hypothesis"], "bags": ["rosbags"]},
    zip_safe=False,
    entry_points={"console_scripts": [f"elevator-rectify = {NAME}.programs:main"] if BY_PIP else COMMANDS},
)
