"""Layouts of elevator panels: where the buttons are, in metres, and what they look like."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.types import Array, IntArray

PITCH_M = 0.045


@dataclass(frozen=True)
class Button:
    """One button: centre in the panel frame, its true cell, and the regular block it belongs to."""

    x_m: float
    y_m: float
    row: int
    column: int
    block: int = 0
    label: str = ""


@dataclass(frozen=True)
class Look:
    """Appearance: colours are BGR in 0..255.

    shape: of the cap; aspect: its width over its height, which is button_share of the smaller pitch; corner_share:
    radius of the corners over the smaller half size; ring_share: width of the ring around, over the half height;
    height_share: how far the cap stands out, over its height; label_beside: on the plate, not on the cap.
    """

    shape: str = "round"
    button_share: float = 0.62
    aspect: float = 1.0
    corner_share: float = 0.25
    ring_share: float = 0.1
    height_share: float = 0.0
    bevel: float = 0.1
    engraved: bool = False
    label_beside: bool = False
    braille: bool = False
    font: int = 2
    gloss: float = 0.0
    plate: tuple[int, int, int] = (176, 178, 180)
    face: tuple[int, int, int] = (196, 200, 204)
    rim: tuple[int, int, int] = (92, 94, 96)
    ink: tuple[int, int, int] = (30, 30, 34)
    lamp: tuple[int, int, int] = (60, 150, 250)
    wall: tuple[int, int, int] = (122, 138, 150)
    brushed: bool = True


@dataclass(frozen=True)
class Panel:
    """A panel: its buttons, column and row pitch in metres, rectangles (x0, y0, x1, y1) of plate and display."""

    buttons: tuple[Button, ...]
    pitch_m: tuple[float, float]
    plate_m: tuple[float, float, float, float]
    display_m: tuple[float, float, float, float] | None = None
    look: Look = Look()
    lit: frozenset[int] = frozenset()
    offsets_m: tuple[tuple[float, float], ...] = ()

    @property
    def placed_m(self) -> Array:
        """Return the (M, 3) centres as manufactured: off the lattice by `offsets_m`, where given."""
        points = self.points_m
        if self.offsets_m:
            points[:, :2] += np.array(self.offsets_m)
        return points

    @property
    def points_m(self) -> Array:
        """Return the (M, 3) button centres in the panel frame."""
        return np.array([[b.x_m, b.y_m, 0.0] for b in self.buttons])

    @property
    def cells(self) -> IntArray:
        """Return the (M, 2) true rows and columns."""
        return np.array([[b.row, b.column] for b in self.buttons], dtype=np.int64)

    @property
    def blocks(self) -> IntArray:
        """Return the (M,) block of each button; cells compare within a block."""
        return np.array([b.block for b in self.buttons], dtype=np.int64)


def regular_panel(rows: int, columns: int, row_pitch_m: float = PITCH_M, look: Look = Look()) -> Panel:
    """Return a full grid, floors numbered row by row upwards."""
    buttons = [
        Button(c * PITCH_M, r * row_pitch_m, r, c, 0, str((rows - 1 - r) * columns + c + 1))
        for r in range(rows)
        for c in range(columns)
    ]
    return framed(tuple(buttons), (PITCH_M, row_pitch_m), look)


def framed(buttons: tuple[Button, ...], pitch_m: tuple[float, float], look: Look, display: bool = False) -> Panel:
    """Put a plate around the buttons, with a display on top where asked."""
    x, y = np.array([[b.x_m, b.y_m] for b in buttons]).T
    margin = PITCH_M
    head = 1.9 * PITCH_M if display else 0.0
    plate = (float(x.min() - margin), float(y.min() - margin - head), float(x.max() + margin), float(y.max() + margin))
    middle, top = (plate[0] + plate[2]) / 2.0, plate[1] + 0.4 * PITCH_M
    screen = (middle - 0.9 * PITCH_M, top, middle + 0.9 * PITCH_M, top + 1.5 * PITCH_M) if display else None
    return Panel(buttons, pitch_m, plate, screen, look)


def with_gap(panel: Panel, gap: float, labels: tuple[str, ...], half_pitch: bool = True) -> Panel:
    """Add a last row of function buttons below, `gap` pitches further than a regular row, centred, half a pitch off."""
    last = max(b.row for b in panel.buttons)
    y = (last + 1 + gap) * panel.pitch_m[1]
    start = 0.5 if half_pitch else 0.0
    extra = tuple(Button((c + start) * PITCH_M, y, last + 1, c, 1, label) for c, label in enumerate(labels))
    return framed(panel.buttons + extra, panel.pitch_m, panel.look, panel.display_m is not None)


def with_display(panel: Panel) -> Panel:
    """Add a floor display above the buttons."""
    return framed(panel.buttons, panel.pitch_m, panel.look, display=True)


def paper_panels() -> tuple[Panel, ...]:
    """Return five different elevators, in the manner of the paper's experiment; the last is irregular."""
    steel = Look()
    glass = Look(
        shape="square", plate=(34, 34, 36), face=(58, 58, 60), rim=(150, 150, 150), ink=(235, 235, 235), brushed=False
    )
    gold = Look(plate=(96, 150, 178), face=(120, 178, 205), rim=(50, 84, 104), wall=(64, 84, 120))
    white = Look(shape="square", plate=(150, 150, 148), face=(232, 234, 236), rim=(110, 110, 110), wall=(170, 178, 180))
    dark = Look(plate=(130, 128, 126), face=(60, 58, 56), rim=(200, 200, 200), ink=(240, 240, 240), wall=(96, 120, 132))
    panels = (
        with_display(regular_panel(6, 3, look=steel)),
        regular_panel(8, 4, 0.042, look=glass),
        with_display(regular_panel(5, 3, 0.050, look=gold)),
        regular_panel(7, 2, 0.045, look=white),
        with_display(with_gap(regular_panel(6, 3, 0.044, look=dark), 0.45, ("<>", "><"))),
    )
    return tuple(replace(p, lit=frozenset({2 * k + 1})) for k, p in enumerate(panels))
