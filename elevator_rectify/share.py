"""Where the files beside the code are: in a clone, in a ROS workspace, or below the Python that pip installed to."""

from __future__ import annotations

import os
import sys
from pathlib import Path

_NAME = "elevator_rectify"


def share_file(relative: str) -> Path:
    """Return the path of a file of config/, launch/ or bags/; FileNotFoundError with the places that were looked at."""
    prefixes = [*filter(None, os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)), sys.prefix, sys.base_prefix]
    places = [Path(__file__).parent.parent, *(Path(prefix) / "share" / _NAME for prefix in prefixes)]
    # A wheel installed with --target or --user, and colcon's own prefix: above site-packages.
    places += [parent / "share" / _NAME for parent in Path(__file__).parents]
    for place in places:
        if (place / relative).exists():
            return place / relative
    raise FileNotFoundError(f"{relative} is in none of {', '.join(str(p) for p in dict.fromkeys(places))}")
