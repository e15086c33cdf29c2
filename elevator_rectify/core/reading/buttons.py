"""The buttons of a fitted panel: where each is, how surely it is one, and what it means."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from elevator_rectify.core.config import LabelsConfig
from elevator_rectify.core.geometry.pose import covariance_at
from elevator_rectify.core.reading.panel import Reading, as_read
from elevator_rectify.core.reading.places import PanelPlaces, known_index
from elevator_rectify.core.types import Array, Button, FitResult

# A button's width over the pitch, where its box has no size.
_USUAL_SHARE = 0.6
DEFAULT_LABELS = LabelsConfig()


def buttons_of(fit: FitResult, reading: Reading, config: LabelsConfig) -> tuple[Button, ...]:
    """Return the places of an accepted fit, row by row, then those beside the grid, with what is known of each."""
    where, meant, normal = _where(fit, reading.places), _meant(reading, config), -fit.R_camera_panel[:, 2]
    return tuple(_button(fit, reading, where, meant[k], normal, k, config) for k in range(len(meant)))


def _button(
    fit: FitResult,
    reading: Reading,
    where: _Where,
    meant: tuple[str, str, float],
    normal: Array,
    k: int,
    config: LabelsConfig,
) -> Button:
    places, present = reading.places, float(reading.present[k])
    detection = int(places.detection[k])
    row, column = divmod(k, fit.columns) if k < places.cells else (-1, -1)
    state = "observed" if detection >= 0 else "inferred" if present >= config.min_button else "empty"
    label, source, probability = meant if state != "empty" else ("", "", 0.0)
    return Button(
        block=(int(fit.row_block[row]), int(fit.column_block[column])) if row >= 0 else (-1, -1),
        row=row,
        column=column,
        image_px=where.image_px[k],
        panel=places.panel[k],
        point=where.point[k],
        covariance=where.covariance[k],
        normal=normal,
        size=(float(where.size[k, 0]), float(where.size[k, 1])),
        label=label,
        read=places.read[k],
        score=float(places.score[k]) if fit.detections or detection < 0 else 1.0,
        detection=detection,
        state=state,
        probability=present,
        label_source=source,
        label_probability=probability,
    )


def _meant(reading: Reading, config: LabelsConfig) -> list[tuple[str, str, float]]:
    """Return of every place what its label is, where that is from, and how probable it is."""
    labels, right, floors = reading.places.label, as_read(reading), reading.floors
    if reading.taught is not None:
        return [(label, "taught" if label else "", float(p)) for label, p in zip(labels, right, strict=True)]
    if floors is None:
        return [(read, "read" if read else "", float(p)) for read, p in zip(labels, right, strict=True)]
    likeliest = [str(floors.numbers[best]) for best in floors.floor.argmax(axis=1)]
    probability = floors.floor.max(axis=1)
    # Where nothing was detected: given that there is a button.
    given = np.minimum(1.0, probability / np.where(reading.places.detection < 0, reading.present, 1.0))
    return [
        _label(read, float(as_it_is), floor, float(p), float(if_there), config)
        for read, as_it_is, floor, p, if_there in zip(labels, right, likeliest, probability, given, strict=True)
    ]


def _label(
    read: str, right: float, likeliest: str, p: float, if_there: float, config: LabelsConfig
) -> tuple[str, str, float]:
    """Return the label of one place: the likeliest floor, or what was read, right with that probability."""
    if read and likeliest != read and p >= config.min_correction:
        return likeliest, "corrected", p
    if read:
        return read, "read", right
    return (likeliest, "inferred", if_there) if if_there >= config.min_inference else ("", "", 0.0)


@dataclass(frozen=True)
class _Where:
    """Of K places: image_px (K, 2), point (K, 3) with covariance (K, 3, 3), size (K, 2)."""

    image_px: Array
    point: Array
    covariance: Array
    size: Array


def _where(fit: FitResult, places: PanelPlaces) -> _Where:
    """Return where the buttons are: cells by the lattice, the others by their detections."""
    point = places.panel @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel
    covariance = covariance_at(fit, places.panel)[:, :3, :3]
    per_px = _per_px(fit, places)
    # A button is off its cell by the panel's own scatter. The lattice says nothing of what is beside it: there the
    # detection's own error counts.
    own = fit.rms_px * per_px
    own[: places.cells] = 0.0 if fit.measurement is None else fit.measurement.scatter * float(fit.pitch[0])
    if fit.known is not None:
        own[:] = fit.known.place_std * float(fit.pitch[0] / fit.known.pitch[0])
    across = fit.R_camera_panel[:, :2] * own[:, None]
    covariance += across @ np.swapaxes(across, 1, 2)
    return _Where(_image_px(fit, places), point, covariance, _size(fit, places, per_px))


def _image_px(fit: FitResult, places: PanelPlaces) -> Array:
    """Return the buttons' centres (K, 2) as the picture shows them, or else their cells', or their detections'."""
    cells = fit.grid_px.reshape(-1, 2)
    if fit.known is not None:
        px = np.concatenate([cells, np.zeros((len(places.panel) - len(cells), 2))])
        px[known_index(fit, fit.known)] = fit.known_px
        return np.asarray(px)
    if fit.measurement is not None:
        seen = fit.measurement.centre_px.reshape(-1, 2)
        cells = np.where(np.isfinite(seen), seen, cells)
    beside = [(fit.detections[k].x_px, fit.detections[k].y_px) for k in places.detection[places.cells :]]
    return np.concatenate([cells, np.array(beside).reshape(-1, 2)])


def _size(fit: FitResult, places: PanelPlaces, per_px: Array) -> Array:
    """Return the buttons' widths and heights (K, 2): as measured, or else of their boxes, or the usual ones."""
    index = places.detection
    if fit.known is not None:
        usual = np.full((len(index), 2), _USUAL_SHARE * float(fit.pitch.min()))
        usual[known_index(fit, fit.known)] = fit.known.sizes * (fit.pitch / fit.known.pitch)
        return usual
    if fit.measurement is not None:
        return np.tile(2.0 * fit.measurement.half_size, (len(index), 1))
    if not fit.detections:
        return np.full((len(index), 2), _USUAL_SHARE * float(fit.pitch.min()))
    boxes = np.nan_to_num([(d.width_px, d.height_px) for d in fit.detections])[index]
    known = (boxes > 0).all(axis=1) & (index >= 0)
    return np.where(known[:, None], boxes * per_px, _USUAL_SHARE * float(fit.pitch.min()))


def _per_px(fit: FitResult, places: PanelPlaces) -> Array:
    """Return the lengths on the panel (K, 2) of a pixel along a row and along a column, at the places' cells."""
    lengths = []
    for axis in (1, 0):
        pixels = np.linalg.norm(np.diff(fit.grid_px, axis=axis), axis=2)
        panel = np.linalg.norm(np.diff(fit.grid_panel, axis=axis), axis=2)
        ratio = panel / np.maximum(pixels, 1e-9)
        if not ratio.size:
            ratio = np.full((fit.rows, fit.columns), np.nan)
        lengths.append(np.concatenate([ratio, ratio.take([-1], axis=axis)], axis=axis)[: fit.rows, : fit.columns])
    cell = np.clip(places.line.round(), 0, (fit.rows - 1, fit.columns - 1)).astype(int)
    both = np.stack(lengths, axis=-1)[cell[:, 0], cell[:, 1]]
    # One row or column has a length along the other axis only.
    return np.asarray(np.where(np.isfinite(both), both, both[:, ::-1]))
