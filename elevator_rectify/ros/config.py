"""Configuration of the node itself; what concerns the mathematics is in core/config."""

from __future__ import annotations

from dataclasses import dataclass, field

from elevator_rectify.core.config import Checked, value


@dataclass(frozen=True)
class PairingConfig(Checked):
    """Bounds of the buffers."""

    max_images: int = value(60, "images that wait for their detections", low=1, high=10000)
    max_megabytes: int = value(256, "memory that waiting images may take", low=1, high=65536)
    max_detections: int = value(60, "detection messages that wait for their image", low=1, high=10000)


@dataclass(frozen=True)
class NodeConfig(Checked):
    """What concerns the node only; read when it starts."""

    image_transport: str = value("raw", "how images arrive", choices=("raw", "compressed"))
    pairing: PairingConfig = field(default_factory=PairingConfig)
