"""Install elevator_rectify as an ament_python package."""

from glob import glob

from setuptools import find_packages, setup

NAME = "elevator_rectify"

setup(
    name=NAME,
    version="0.1.0",
    description="Fits the button grid of an elevator panel, estimates its pose and rectifies its view.",
    license="Apache-2.0",
    packages=find_packages(include=[NAME, f"{NAME}.*"]),
    package_data={NAME: ["py.typed", "core/**/*.json"]},
    data_files=[
        ("share/ament_index/resource_index/packages", [f"resource/{NAME}"]),
        (f"share/{NAME}", ["package.xml"]),
        (f"share/{NAME}/config", glob("config/*.yaml") + glob("config/*.xml") + glob("config/*.rviz")),
        (f"share/{NAME}/launch", glob("launch/*.launch.py")),
    ],
    install_requires=["setuptools"],
    extras_require={"test": ["pytest", "hypothesis"]},
    zip_safe=False,
    entry_points={
        "console_scripts": [
            "node = elevator_rectify.ros.node:main",
            "replay = elevator_rectify.recordings.replay:main",
            "render = elevator_rectify.render.bag:main",
            "make_bag = elevator_rectify.recordings.make_bag:main",
            "play = elevator_rectify.recordings.play:main",
            "benchmark = elevator_rectify.benchmark.program:main",
            "calibrate = elevator_rectify.calibrate.confidence:main",
            "relay = elevator_rectify.live.relay:main",
            "latency = elevator_rectify.live.latency:main",
            "soak = elevator_rectify.live.soak:main",
            "chaos = elevator_rectify.live.chaos:main",
        ]
    },
)
