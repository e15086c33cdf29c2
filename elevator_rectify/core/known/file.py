"""Panel files: YAML that people may read and mend."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from elevator_rectify.core.config import PanelConfig
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.types import KnownPanel

HEAD = """# A taught elevator panel; labels may be corrected. at: a button's centre from cell (0, 0)'s, right and down.
"""
_UNITS = {"m": True, "column pitch": False}
_FEWEST = 4


def panel_text(known: KnownPanel) -> str:
    """Return the panel as YAML."""
    buttons = [
        f"- {{label: {_quoted(label)}, row: {row}, column: {column}, at: {_pair(at)}, size: {_pair(size)}}}"
        for label, (row, column), at, size in zip(
            known.labels, known.cells.tolist(), known.places, known.sizes, strict=True
        )
    ]
    lines = [
        f"panel: {_quoted(known.name)}",
        f"unit: {'m' if known.metric else 'column pitch'}",
        f"pitch: {_pair(known.pitch)}",
        f"scale_std_share: {known.scale_std_share:.5g}",
        f"place_std: {known.place_std:.5g}",
        f"log_aspect_std: {known.log_aspect_std:.5g}",
        *_lines("rows", known.row_positions, known.row_staggered, known.row_block),
        *_lines("columns", known.column_positions, known.column_staggered, known.column_block),
        "buttons:",
        *buttons,
    ]
    return HEAD + "\n".join(lines) + "\n"


def _lines(name: str, positions: Any, staggered: Any, block: Any) -> list[str]:
    return [
        f"{name}:",
        f"  positions: [{', '.join(f'{p:.5g}' for p in positions)}]",
        f"  staggered: [{', '.join('true' if s else 'false' for s in staggered)}]",
        f"  block: [{', '.join(str(int(b)) for b in block)}]",
    ]


def _quoted(text: str) -> str:
    return "'" + text.replace("'", "''") + "'"


def _pair(values: Any) -> str:
    return f"[{values[0]:.6g}, {values[1]:.6g}]"


def known_panel(config: PanelConfig) -> KnownPanel | None:
    """Return the configured panel, None where there is none. Raises ValueError as `read_panel_file` does.

    Its file is read once: `read_panel_file.cache_clear()` has it read again.
    """
    return read_panel_file(Path(config.file)) if config.file else None


@lru_cache(maxsize=32)
def read_panel_file(path: Path) -> KnownPanel:
    """Return the panel of a file. Raises ValueError, which names file and field, where there is none in it."""
    try:
        loaded = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, yaml.YAMLError) as error:
        raise ValueError(f"panel file {path} cannot be read: {error}") from error
    if not isinstance(loaded, dict):
        raise ValueError(f"panel file {path}: a mapping with 'panel', 'buttons' and more is expected")
    try:
        return _panel(loaded, path.stem)
    except KeyError as error:
        raise ValueError(f"panel file {path}: {error} is missing") from error
    except (TypeError, ValueError, IndexError) as error:
        raise ValueError(f"panel file {path}: {error}") from error


def _panel(loaded: dict[str, Any], stem: str) -> KnownPanel:
    buttons, rows, columns = loaded["buttons"], loaded["rows"], loaded["columns"]
    if not isinstance(buttons, list) or len(buttons) < _FEWEST:
        raise ValueError(f"'buttons' must be a list of {_FEWEST} or more")
    if loaded["unit"] not in _UNITS:
        raise ValueError(f"'unit' must be one of {', '.join(_UNITS)}, not {loaded['unit']!r}")
    cells = np.array([(int(b.get("row", -1)), int(b.get("column", -1))) for b in buttons], dtype=np.int64)
    shape = len(rows["positions"]), len(columns["positions"])
    if (cells.min(axis=1) < 0).any() and not (cells[cells.min(axis=1) < 0] == -1).all():
        raise ValueError("'row' and 'column' of a button must both be -1 beside the lattice")
    if (cells >= shape).any():
        raise ValueError(f"a button lies outside of the {shape[0]} rows and {shape[1]} columns")
    return KnownPanel(
        name=str(loaded.get("panel", stem)),
        labels=tuple(canonical(str(b.get("label", ""))) for b in buttons),
        places=_numbers("at", [b["at"] for b in buttons], (len(buttons), 2)),
        sizes=_numbers("size", [b["size"] for b in buttons], (len(buttons), 2)),
        cells=cells,
        metric=_UNITS[loaded["unit"]],
        pitch=_positive("pitch", _numbers("pitch", loaded["pitch"], (2,))),
        row_positions=_numbers("rows.positions", rows["positions"], (shape[0],)),
        column_positions=_numbers("columns.positions", columns["positions"], (shape[1],)),
        row_staggered=_numbers("rows.staggered", rows["staggered"], (shape[0],)) > 0.5,
        column_staggered=_numbers("columns.staggered", columns["staggered"], (shape[1],)) > 0.5,
        row_block=_numbers("rows.block", rows["block"], (shape[0],)).astype(np.int64),
        column_block=_numbers("columns.block", columns["block"], (shape[1],)).astype(np.int64),
        **{name: _share(name, loaded.get(name, 0.0)) for name in ("place_std", "log_aspect_std", "scale_std_share")},
    )


def _numbers(name: str, values: Any, shape: tuple[int, ...]) -> Any:
    found = np.array(values, dtype=float)
    if found.shape != shape or not np.isfinite(found).all():
        raise ValueError(f"'{name}' must be numbers of shape {shape}, not {values!r}")
    return found


def _positive(name: str, values: Any) -> Any:
    if not (values > 0).all():
        raise ValueError(f"'{name}' must be above 0, not {values.tolist()!r}")
    return values


def _share(name: str, content: Any) -> float:
    number = float(content)
    if not 0.0 <= number < np.inf:
        raise ValueError(f"'{name}' must be 0 or more, not {content!r}")
    return number
