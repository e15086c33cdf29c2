"""From a fitted grid to the button that means what was asked for, or the reason why it is not certain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.config import TargetConfig
from elevator_rectify.core.labels import canonical
from elevator_rectify.core.pose import covariance_at
from elevator_rectify.core.types import Array, Button, Detection, GridFit

# A button's width over the pitch, where its box has no size.
_USUAL_SHARE = 0.6
_UNLABELLED = Detection(0.0, 0.0)
DEFAULT_TARGET = TargetConfig()


@dataclass(frozen=True)
class Choice:
    """The button that was asked for, or None and why: status and reason."""

    button: Button | None
    status: str
    reason: str = ""


def buttons_of(fit: GridFit) -> tuple[Button, ...]:
    """Return the detected buttons of an accepted fit, row by row."""
    if not fit.ok:
        return ()
    on = np.flatnonzero(fit.cells[:, 0] >= 0)
    order = on[np.lexsort((on, fit.cells[on, 1], fit.cells[on, 0]))]
    return tuple(_button(fit, int(k)) for k in order)


def _button(fit: GridFit, k: int) -> Button:
    row, column = (int(index) for index in fit.cells[k])
    point = fit.grid_points[row, column]
    detection = fit.detections[k] if fit.detections else _UNLABELLED
    return Button(
        block=(int(fit.row_block[row]), int(fit.column_block[column])),
        row=row,
        column=column,
        image_px=fit.grid_px[row, column],
        panel=fit.grid_panel[row, column],
        point=point,
        covariance=covariance_at(fit.covariance, point - fit.t_camera_panel)[:3, :3],
        normal=-fit.R_camera_panel[:, 2],
        size=_size(fit, row, column, detection),
        label=canonical(detection.label),
        read=detection.label,
        score=detection.score,
        detection=k,
    )


def _size(fit: GridFit, row: int, column: int, detection: Detection) -> tuple[float, float]:
    """Return the button's width and height: as measured, or else its box over the distances around its cell."""
    if fit.measurement is not None:
        width, height = 2.0 * fit.measurement.half_size
        return float(width), float(height)
    if not (detection.width_px > 0 and detection.height_px > 0):
        usual = _USUAL_SHARE * float(fit.pitch.min())
        return usual, usual
    across = _per_px(fit, row, column, axis=1)
    down = _per_px(fit, row, column, axis=0)
    return detection.width_px * across, detection.height_px * down


def _per_px(fit: GridFit, row: int, column: int, axis: int) -> float:
    """Return the length on the panel of a pixel along a row (axis 1) or column (0), at a cell."""
    index, last = (row, column)[axis], fit.grid_px.shape[axis] - 1
    here, there = (row, column), [row, column]
    there[axis] = index + 1 if index < last else index - 1
    pixels = float(np.linalg.norm(fit.grid_px[tuple(there)] - fit.grid_px[here]))
    return float(np.linalg.norm(fit.grid_panel[tuple(there)] - fit.grid_panel[here])) / max(pixels, 1e-9)


def find_button(fit: GridFit, target: str, config: TargetConfig = DEFAULT_TARGET) -> Choice:
    """Return the one button of the fit that is labelled `target` ('7', 'open', 'B1'), or why there is none.

    A wrong pose presses a wrong button: two buttons of that label, a label that is not read surely, or a place that is
    not known well enough are reasons to refuse. Spellings are unified (`labels.canonical`).
    """
    name = canonical(target)
    if not name:
        return Choice(None, "empty_target", "the target is empty")
    if not fit.ok:
        return Choice(None, "no_panel", f"{fit.status}: {fit.reason}")
    candidates = [button for button in fit.buttons if button.label == name]
    if not candidates:
        read = sorted({button.label for button in fit.buttons if button.label})
        return Choice(None, "unknown_label", f"no button is labelled {name}; read were: {', '.join(read) or 'none'}")
    if len({(b.row, b.column) for b in candidates}) > 1:
        cells = ", ".join(f"({b.row}, {b.column})" for b in candidates)
        return Choice(None, "two_candidates", f"{name} is read at the cells {cells}")
    button = max(candidates, key=lambda b: np.nan_to_num(b.score, nan=-1.0))
    others = {b.label for b in fit.buttons if (b.row, b.column) == (button.row, button.column)} - {name, ""}
    if others:
        return Choice(None, "two_candidates", f"the cell of {name} is read as {', '.join(sorted(others))} too")
    if not button.score >= config.min_score:
        return Choice(None, "low_score", f"{name} is read with score {button.score:.2f} < {config.min_score:g}")
    return _placed(fit, button, config)


def _placed(fit: GridFit, button: Button, config: TargetConfig) -> Choice:
    """Refuse a button whose place is not known well enough to press it."""
    if not fit.metric:
        return Choice(None, "unknown_scale", "the scale is unknown: set scale.column_pitch_m or use a depth image")
    spread = lateral_std(button)
    if spread > config.max_lateral_std_m:
        reason = f"{button.label} is known to {spread:.4f} m sideways, {config.max_lateral_std_m:g} allowed"
        return Choice(None, "uncertain", reason)
    return Choice(button, "found")


def lateral_std(button: Button) -> float:
    """Return the standard deviation of the button's place across the pressing direction, along the worse axis."""
    across: Array = np.linalg.svd(button.normal[None])[2][1:]
    return float(np.sqrt(max(0.0, np.linalg.eigvalsh(across @ button.covariance @ across.T)[-1])))
