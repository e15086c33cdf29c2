"""ROS parameters from the configuration dataclasses: the field's path is the parameter's name."""

from __future__ import annotations

import difflib
import math
from dataclasses import Field
from typing import Any

from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor, SetParametersResult
from rclpy.node import Node
from rclpy.parameter import Parameter

from elevator_rectify.core.config import Config, flatten, with_values
from elevator_rectify.core.known.file import known_panel, read_panel_file
from elevator_rectify.ros.config import NodeConfig

_INT_LIMIT = 2**31 - 1
# Parameters that every node has, and those of QoS overrides, which are declared with their topics.
_STANDARD = ("use_sim_time", "qos_overrides.", "start_type_description_service")


def declare(node: Node) -> tuple[NodeConfig, Config]:
    """Declare every value of NodeConfig (read-only) and Config, and return what the user set.

    Raises ValueError for a value out of its range, and a panel file that cannot be read.
    """
    node_config = _declared(node, NodeConfig(), read_only=True)
    config = _declared(node, Config(), read_only=False)
    # What cannot be read ends the node here, not every frame.
    known_panel(config.panel)
    _refuse_unknown(node)
    return node_config, config


def _refuse_unknown(node: Node) -> None:
    """Raise ValueError for parameters given by -p or a file that are none: a misspelt one would change nothing."""
    known = [*flatten(NodeConfig()), *flatten(Config())]
    # Public rclpy has no way to list what was given, but not declared.
    for name in node._parameter_overrides:
        if not node.has_parameter(name) and not name.startswith(_STANDARD):
            near = difflib.get_close_matches(name, known, 1)
            raise ValueError(f"there is no parameter '{name:.80}'" + (f"; did you mean '{near[0]}'?" if near else ""))


def _declared(node: Node, defaults: Any, read_only: bool) -> Any:
    values = {}
    for path, (item, default) in flatten(defaults).items():
        values[path] = node.declare_parameter(path, default, _descriptor(item, read_only)).value
    return with_values(defaults, values)


def _descriptor(item: Field[Any], read_only: bool) -> ParameterDescriptor:
    meta = item.metadata
    descriptor = ParameterDescriptor(description=meta["meaning"], read_only=read_only)
    # `column_pitch_m:=1` is an integer to ROS: our own check takes it for the float that is meant.
    descriptor.dynamic_typing = isinstance(item.default, float)
    if meta["choices"]:
        descriptor.additional_constraints = "one of " + ", ".join(meta["choices"])
    elif isinstance(item.default, int) and not isinstance(item.default, bool):
        low, high = (int(max(-_INT_LIMIT, min(_INT_LIMIT, bound))) for bound in (meta["low"], meta["high"]))
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high, step=0)]
    elif isinstance(item.default, float) and math.isfinite(meta["low"]) and math.isfinite(meta["high"]):
        descriptor.floating_point_range = [FloatingPointRange(from_value=meta["low"], to_value=meta["high"], step=0.0)]
    return descriptor


def changed(config: Config, parameters: list[Parameter]) -> tuple[Config, SetParametersResult]:
    """Return the configuration with the parameters set, or the old one and the reason why not.

    Parameters that are not the configuration's (use_sim_time, QoS overrides) pass.
    """
    known = flatten(config)
    values = {p.name: p.value for p in parameters if p.name in known}
    try:
        new = with_values(config, values)
        if "panel.file" in values:
            # The same file may have been taught anew.
            read_panel_file.cache_clear()
            known_panel(new.panel)
        return new, SetParametersResult(successful=True)
    except ValueError as error:
        return config, SetParametersResult(successful=False, reason=str(error))
