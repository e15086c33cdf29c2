"""A panel as text, as it hangs on the wall."""

from __future__ import annotations

from collections.abc import Sequence

from elevator_rectify.core.types import Button

LEGEND = "7 read, 7! corrected, 7? inferred where none was read, (7) inferred button, _ no label, . empty, 7+ lit"


def cell_text(button: Button) -> str:
    """Return what stands for one place: its label and where that is from."""
    if button.state == "empty":
        return "."
    mark = {"corrected": "!", "inferred": "?"}.get(button.label_source, "")
    name = button.label or "_"
    lit = "+" if button.lit == "yes" else ""
    return f"({name})" if button.state == "inferred" else name + mark + lit


def text_grid(buttons: Sequence[Button]) -> str:
    """Return the places of a panel (`fit.buttons`) row by row; an empty line between blocks; those beside it last."""
    texts = {(b.row, b.column): cell_text(b) for b in buttons if b.row >= 0}
    blocks = {b.row: b.block[0] for b in buttons if b.row >= 0}
    width = max((len(t) for t in texts.values()), default=1)
    lines = []
    for row in range(1 + max(blocks, default=-1)):
        if row and blocks[row] != blocks[row - 1]:
            lines.append("")
        columns = sorted(c for r, c in texts if r == row)
        lines.append(" ".join(texts[row, c].rjust(width) for c in columns))
    beside = [cell_text(b) for b in buttons if b.row < 0]
    return "\n".join(lines + (["", "beside the grid: " + " ".join(beside)] if beside else []))
