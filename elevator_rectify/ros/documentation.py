"""Writes the parameters out of the dataclasses: the YAML of config/ and docs/parameters.md.

`python3 -m elevator_rectify.ros.documentation yaml` or `... page`; a test keeps both files equal to this.
"""

from __future__ import annotations

import math
import sys
from typing import Any

from elevator_rectify.core.config import Config, flatten
from elevator_rectify.ros.config import NodeConfig

_PAGE = """# Parameters

All can be set in `config/elevator_rectify.yaml` (which holds the defaults), with `-p NAME:=VALUE`, or as arguments of
the launch file. Those before `method` are read when the node starts, the others can be changed while it runs: the next
frame uses them, and a bad value is refused with the reason. A name that is none of these is refused at start.

"""


def all_parameters() -> dict[str, tuple[Any, Any]]:
    """Return {path: (field, default)} of the node, in the order of the stages."""
    return {**flatten(NodeConfig()), **flatten(Config())}


def parameter_yaml() -> str:
    """Return the parameter file with every default and its meaning."""
    lines = [
        "# Every parameter with its default. Copy it and keep what you change.",
        "/**/elevator_rectify:",
        "  ros__parameters:",
    ]
    for path, (item, default) in all_parameters().items():
        lines += [f"    # {item.metadata['meaning']}{_limits(item)}", f"    {path}: {_literal(default)}"]
    return "\n".join(lines) + "\n"


def parameter_table() -> str:
    """Return the page's table of parameters."""
    rows = ["| parameter | default | meaning |", "| --- | --- | --- |"]
    for path, (item, default) in all_parameters().items():
        rows.append(f"| `{path}` | {_literal(default)} | {item.metadata['meaning']}{_limits(item)} |")
    return "\n".join(rows)


def parameter_page() -> str:
    """Return docs/parameters.md."""
    return _PAGE + parameter_table() + "\n"


def parameter_descriptions() -> dict[str, str]:
    """Return {path: meaning, range and default} for the launch file's arguments."""
    return {
        path: f"{item.metadata['meaning']}{_limits(item)}; default: {_literal(default)}"
        for path, (item, default) in all_parameters().items()
    }


def _limits(item: Any) -> str:
    meta = item.metadata
    if meta["choices"]:
        return " (" + ", ".join(meta["choices"]) + ")"
    return f" ({meta['low']:g} to {meta['high']:g})" if math.isfinite(meta["low"]) else ""


def _literal(content: Any) -> str:
    if isinstance(content, bool):
        return str(content).lower()
    if content == "":
        return "''"
    # YAML 1.1 takes 1e-06 for text: a float needs its point.
    return f"{content:.1e}" if isinstance(content, float) and 0 < abs(content) < 1e-4 else str(content)


if __name__ == "__main__":
    sys.stdout.write(parameter_yaml() if sys.argv[1:] == ["yaml"] else parameter_page())
