"""The result that users get: the fit, and what its buttons are and are called."""

from __future__ import annotations

from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any

from elevator_rectify.core.config import LabelsConfig
from elevator_rectify.core.reading.buttons import DEFAULT_LABELS, buttons_of
from elevator_rectify.core.reading.panel import Reading, read_panel
from elevator_rectify.core.types import Button, FitResult


@dataclass(frozen=True)
class GridFit(FitResult):
    """The fitted grid and the panel's pose, or the reason why there is none, with the panel's buttons.

    Labels and buttons are worked out when first asked for. plates_on_left: prints to the left of buttons without print
    are their labels.
    """

    plates_on_left: bool = False

    @classmethod
    def of(cls, fit: FitResult, **changes: Any) -> GridFit:
        """Return the result of the stages as one that can be read, with some fields changed."""
        return cls(**{field.name: getattr(fit, field.name) for field in fields(FitResult)} | changes)

    @cached_property
    def reading(self) -> Reading:
        """Return what the panel's labels and layout say of its places."""
        return read_panel(self, self.plates_on_left)

    @cached_property
    def buttons(self) -> tuple[Button, ...]:
        """Return the grid's places, row by row, then the off-grid buttons; none where the pose may not be used."""
        return self.buttons_by(DEFAULT_LABELS)

    @property
    def keypad(self) -> bool:
        """Tell whether the buttons are digits to be entered (destination dispatch), no floors."""
        return self.ok and self.reading.keypad

    def buttons_by(self, config: LabelsConfig) -> tuple[Button, ...]:
        """Return the buttons as `buttons` does, with other settings."""
        return buttons_of(self, self.reading, config) if self.ok else ()
