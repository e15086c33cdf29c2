"""From a fitted grid to the button that means what was asked for, or the reason why it is not certain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.cells import Cells, cells_of, probability_of
from elevator_rectify.core.config import LabelsConfig, TargetConfig
from elevator_rectify.core.labels import canonical
from elevator_rectify.core.pose import covariance_at
from elevator_rectify.core.types import Array, Button, Detection, GridFit

# A button's width over the pitch, where its box has no size.
_USUAL_SHARE = 0.6
DEFAULT_TARGET, DEFAULT_LABELS = TargetConfig(), LabelsConfig()
# A second button with more than this probability of the label is named as a candidate.
_CANDIDATE = 0.1


@dataclass(frozen=True)
class Choice:
    """The button that was asked for, or None and why: status and reason."""

    button: Button | None
    status: str
    reason: str = ""


def buttons_of(fit: GridFit, config: LabelsConfig = DEFAULT_LABELS) -> tuple[Button, ...]:
    """Return the places of an accepted fit, row by row, with what is known of their labels."""
    if not fit.ok:
        return ()
    cells = cells_of(fit)
    return tuple(_button(fit, cells, k, config) for k in range(fit.rows * fit.columns))


def _button(fit: GridFit, cells: Cells, k: int, config: LabelsConfig) -> Button:
    row, column = divmod(k, fit.columns)
    point, detection = fit.grid_points[row, column], int(cells.detection[k])
    given = fit.detections[detection] if fit.detections and detection >= 0 else None
    state = "observed" if detection >= 0 else "inferred" if cells.present[k] >= config.min_button else "empty"
    label, source, probability = _label(cells, k, config) if state != "empty" else ("", "", 0.0)
    return Button(
        block=(int(fit.row_block[row]), int(fit.column_block[column])),
        row=row,
        column=column,
        image_px=_image_px(fit, row, column),
        panel=fit.grid_panel[row, column],
        point=point,
        covariance=covariance_at(fit.covariance, point - fit.t_camera_panel)[:3, :3],
        normal=-fit.R_camera_panel[:, 2],
        size=_size(fit, row, column, given),
        label=label,
        read=cells.read[k],
        score=1.0 if given is None and detection >= 0 else float(cells.score[k]),
        detection=detection,
        state=state,
        probability=1.0 if detection >= 0 else float(cells.present[k]),
        label_source=source,
        label_probability=probability,
    )


def _label(cells: Cells, k: int, config: LabelsConfig) -> tuple[str, str, float]:
    """Return the cell's label, where it is from, and how probable it is."""
    read, floors = cells.label[k], cells.floors
    as_read = float(probability_of(cells, read)[k]) if read else 0.0
    if floors is None:
        return read, "read" if read else "", as_read
    best = int(floors.floor[k].argmax())
    likeliest, p = str(floors.numbers[best]), float(floors.floor[k, best])
    if read and likeliest != read and p >= config.min_correction:
        return likeliest, "corrected", p
    if read:
        return read, "read", as_read
    # Where nothing was detected: given that there is a button.
    p = p / max(float(cells.present[k]), 1e-9) if cells.detection[k] < 0 else p
    return (likeliest, "inferred", min(p, 1.0)) if p >= config.min_inference else ("", "", 0.0)


def _image_px(fit: GridFit, row: int, column: int) -> Array:
    """Return the button's centre as the picture shows it, or else its cell's."""
    if fit.measurement is not None and np.isfinite(fit.measurement.centre_px[row, column]).all():
        return np.asarray(fit.measurement.centre_px[row, column])
    return np.asarray(fit.grid_px[row, column])


def _size(fit: GridFit, row: int, column: int, detection: Detection | None) -> tuple[float, float]:
    """Return the button's width and height: as measured, or else its box over the distances around its cell."""
    if fit.measurement is not None:
        width, height = 2.0 * fit.measurement.half_size
        return float(width), float(height)
    if detection is None or not (detection.width_px > 0 and detection.height_px > 0):
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
    """Return the one button of the fit that means `target` ('7', 'open', 'B1'), or why there is none.

    A wrong pose presses a wrong button: a label that another button may have too, that is not surely what was asked
    for, or a place that is not known well enough are reasons to refuse. Spellings are unified (`labels.canonical`).
    """
    name = canonical(target)
    if not name:
        return Choice(None, "empty_target", "the target is empty")
    if not fit.ok:
        return Choice(None, "no_panel", f"{fit.status}: {fit.reason}")
    cells = cells_of(fit)
    probability = probability_of(cells, name)
    order = np.argsort(-probability, kind="stable")
    first, second = (float(probability[order[k]]) if k < len(order) else 0.0 for k in (0, 1))
    button = fit.buttons[order[0]]
    if first < 0.5 and second < _CANDIDATE:
        read = sorted({b.label for b in fit.buttons if b.label})
        return Choice(None, "unknown_label", f"no button is labelled {name}; known are: {', '.join(read) or 'none'}")
    if second > _CANDIDATE:
        places = ", ".join(f"({fit.buttons[k].row}, {fit.buttons[k].column})" for k in order[:2])
        return Choice(None, "two_candidates", f"{name} may be at the cells {places}")
    others = _other_readings(fit, button) - {name, ""}
    if others:
        return Choice(None, "two_candidates", f"the cell of {name} is read as {', '.join(sorted(others))} too")
    return _decided(fit, button, name, first * (1.0 - second), config)


def _other_readings(fit: GridFit, button: Button) -> set[str]:
    """Return what the other detections of the button's cell read."""
    mine = np.flatnonzero((fit.cells == [button.row, button.column]).all(axis=1))
    return {canonical(fit.detections[k].label) for k in mine if fit.detections and k != button.detection}


def _decided(fit: GridFit, button: Button, name: str, probability: float, config: TargetConfig) -> Choice:
    """Refuse a button whose label is not sure."""
    if button.detection < 0 and not config.allow_inferred:
        return Choice(None, "inferred_only", f"{name} was not detected; target.allow_inferred is off")
    as_read = canonical(button.read) == name
    if as_read and not button.score >= config.min_score:
        return Choice(None, "low_score", f"{name} is read with score {button.score:.2f} < {config.min_score:g}")
    if probability < config.min_probability:
        reason = f"the label is {name} with probability {probability:.3f} < {config.min_probability:g}"
        return Choice(None, "unsure_label", reason)
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
