"""Every test's ROS graph stays on this machine, in a domain of its own."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

from elevator_rectify.threads import ONE_THREAD

# As the programs have it; NumPy is not loaded yet.
os.environ.update(ONE_THREAD)
os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.setdefault("ROS_DOMAIN_ID", "77")
# Without it whole images are lost between processes.
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(Path(__file__).parent.parent / "config" / "fastdds.xml")
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
# The same examples in every run.
settings.register_profile("fixed", derandomize=True)
settings.load_profile("fixed")


# Of these files every test takes seconds; `colcon test` is to take about a minute.
LONG = (
    "benchmark",
    "few",
    "finding",
    "in_the_way",
    "joint",
    "lifecycle",
    "live",
    "load",
    "measured",
    "node",
    "own_detector",
    "package",
    "replay",
)


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--all", action="store_true", help="the long tests too, as `make test` does")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    if config.getoption("--all"):
        return
    skip = pytest.mark.skip(reason="a long test: run with --all")
    for item in items:
        if item.path.stem.removeprefix("test_") in LONG:
            item.add_marker(skip)
