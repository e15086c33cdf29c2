"""A taught panel as a layout whose nodes are its buttons: what fits a lattice fits it too, with only the pose free."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from elevator_rectify.core.config import Config
from elevator_rectify.core.lattice.layout import Layout
from elevator_rectify.core.types import Array, KnownPanel

# Even an exact drawing is not made more exactly than this, as a share.
_LEAST_ASPECT_STD = 1e-4
# Bounds of the places' own error, in column pitches.
_SCATTER = (1e-3, 0.03)


@dataclass(frozen=True)
class PlacedLayout(Layout):
    """K nodes at places (K, 2) in column pitches, as one row of K columns; nothing of it can be moved."""

    places: Array = field(default_factory=lambda: np.zeros((0, 2)))

    @cached_property
    def nodes(self) -> Array:
        """Return the places as (1, K, 2)."""
        return self.places[None]

    @cached_property
    def cells(self) -> float:
        """Return the number of buttons."""
        return float(len(self.places))


def placed_layout(known: KnownPanel) -> PlacedLayout:
    """Return the panel's buttons as a layout in column pitches."""
    number = len(known.labels)
    line, along = np.zeros(1), np.arange(number, dtype=float)
    return PlacedLayout(line, along, np.zeros(1), np.zeros(number), places=known.places / known.pitch[0])


def with_shape_known(config: Config, known: KnownPanel) -> Config:
    """Return the settings under which the shape is the taught one, and cells without detection cost nothing yet."""
    spread = float(np.clip(known.log_aspect_std, _LEAST_ASPECT_STD, config.joint.log_aspect_std))
    scatter = float(np.clip(known.place_std / known.pitch[0], *_SCATTER))
    return replace(
        config,
        joint=replace(config.joint, log_aspect=0.0, log_aspect_std=spread, empty_nats=0.0),
        measurement=replace(config.measurement, scatter_pitch=scatter),
    )
