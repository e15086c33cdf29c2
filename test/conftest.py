"""Every test's ROS graph stays on this machine, in a domain of its own."""

import os
from pathlib import Path

from hypothesis import settings

os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
os.environ.setdefault("ROS_DOMAIN_ID", "77")
# Without it whole images are lost between processes.
os.environ["FASTRTPS_DEFAULT_PROFILES_FILE"] = str(Path(__file__).parent.parent / "config" / "fastdds.xml")
os.environ["ROS_PYTHON_CHECK_FIELDS"] = "1"
# The same examples in every run.
settings.register_profile("fixed", derandomize=True)
settings.load_profile("fixed")
