"""The fitted panel as markers for RViz and Foxglove: grid, labels, plate and normal; the old ones are deleted."""

from __future__ import annotations

from typing import Any

import numpy as np

from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array
from elevator_rectify.ros.answer import Answer
from elevator_rectify.ros.messages import Make
from elevator_rectify.ros.poses import pose_of

# Numbers of visualization_msgs/Marker.
_ARROW, _LINE_STRIP, _SPHERE_LIST, _TEXT = 0, 4, 7, 9
_ADD, _DELETE_ALL = 0, 3
_RED, _GREEN, _BLUE, _WHITE = (0.9, 0.2, 0.2), (0.2, 0.9, 0.3), (0.2, 0.4, 1.0), (1.0, 1.0, 1.0)
# Sizes in pitches.
_DOT, _TEXT_HEIGHT, _LINE, _NORMAL_LENGTH, _MARGIN = 0.3, 0.4, 0.06, 2.0, 0.8
_UPRIGHT = (0.0, 0.0, 0.0, 1.0)


def marker_message(answer: Answer, header: Any, make: Make) -> Any:
    """Return a MarkerArray whose first marker deletes those of earlier frames; the only one where the fit is not ok."""
    markers = [_marker(header, make, action=_DELETE_ALL)]
    if answer.fit.ok:
        fit = answer.fit
        unit = float(fit.pitch.min())
        filled = {tuple(cell) for cell in fit.cells.tolist() if cell[0] >= 0}
        on = np.array([[(r, c) in filled for c in range(fit.columns)] for r in range(fit.rows)])
        for number, (points, colour) in enumerate(((fit.grid_points[on], _GREEN), (fit.grid_points[~on], _RED))):
            if len(points):
                size = (_DOT * unit,) * 3
                markers.append(_marker(header, make, points, colour, size, type=_SPHERE_LIST, ns="grid", id=number))
        markers.append(
            _marker(header, make, _plate(fit), _BLUE, (_LINE * unit, 0.0, 0.0), type=_LINE_STRIP, ns="plate")
        )
        markers.append(_normal(fit, unit, header, make))
        markers += _labels(answer, unit, header, make)
    return make("visualization_msgs/msg/MarkerArray", markers=markers)


def _plate(fit: GridFit) -> Array:
    """Return the closed outline (5, 3) around the grid, in the camera frame."""
    corners = fit.grid_panel.reshape(-1, 2)
    low, high = corners.min(axis=0) - _MARGIN * fit.pitch, corners.max(axis=0) + _MARGIN * fit.pitch
    outline = np.array([low, (high[0], low[1]), high, (low[0], high[1]), low])
    return np.asarray(outline @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel)


def _normal(fit: GridFit, unit: float, header: Any, make: Make) -> Any:
    """Return an arrow from the grid's middle out of the panel, towards the robot."""
    middle = fit.grid_points.reshape(-1, 3).mean(axis=0)
    ends = np.array([middle, middle - _NORMAL_LENGTH * unit * fit.R_camera_panel[:, 2]])
    return _marker(header, make, ends, _BLUE, (2 * _LINE * unit, 4 * _LINE * unit, 0.0), type=_ARROW, ns="normal")


def _labels(answer: Answer, unit: float, header: Any, make: Make) -> list[Any]:
    """Return the labels that were read, a little before their buttons."""
    fit, texts = answer.fit, []
    for number, (detection, (row, column)) in enumerate(zip(answer.detections, fit.cells, strict=True)):
        if row >= 0 and detection.label:
            place = fit.grid_points[row, column] - _DOT * unit * fit.R_camera_panel[:, 2]
            size, text = (0.0, 0.0, _TEXT_HEIGHT * unit), detection.label
            texts.append(
                _marker(header, make, None, _WHITE, size, place, type=_TEXT, ns="labels", id=number, text=text)
            )
    return texts


def _marker(
    header: Any,
    make: Make,
    points: Array | None = None,
    colour: tuple[float, float, float] = _WHITE,
    scale: tuple[float, float, float] = (0.0, 0.0, 0.0),
    place: Array | None = None,
    **fields: Any,
) -> Any:
    """Return one marker; all fields that are not given are empty."""
    vector = make("geometry_msgs/msg/Vector3", x=float(scale[0]), y=float(scale[1]), z=float(scale[2]))
    given = {
        "header": header,
        "ns": "",
        "id": 0,
        "type": _ARROW,
        "action": _ADD,
        "pose": pose_of(np.zeros(3) if place is None else place, _UPRIGHT, make),
        "scale": vector,
        "color": make("std_msgs/msg/ColorRGBA", r=colour[0], g=colour[1], b=colour[2], a=1.0),
        "lifetime": make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        "frame_locked": False,
        "points": [
            make("geometry_msgs/msg/Point", x=float(x), y=float(y), z=float(z))
            for x, y, z in (() if points is None else points)
        ],
        "colors": [],
        "texture_resource": "",
        "texture": _empty_texture(header, make),
        "uv_coordinates": [],
        "text": "",
        "mesh_resource": "",
        "mesh_file": make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        "mesh_use_embedded_materials": False,
    }
    return make("visualization_msgs/msg/Marker", **{**given, **fields})


def _empty_texture(header: Any, make: Make) -> Any:
    return make("sensor_msgs/msg/CompressedImage", header=header, format="", data=np.zeros(0, np.uint8))
