"""Which way up the labels of real panels are said to stand, in their pictures as they are, turned and mirrored."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path

import numpy as np

from elevator_rectify.benchmark.end_to_end import judgeable, stretched_camera, true_detections
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core import Config, Detection, MeasurementConfig, fit_panel
from elevator_rectify.core.reading.attitude import put
from elevator_rectify.core.reading.upright import WayUp, way_up
from elevator_rectify.train.labelled import read_labelled

# How each picture is put (`put`), and what may be said of it.
_WAYS = {"as it is": 0, "on its side": 1, "on its head": 2, "mirrored": 4}
_SAID = ("upright", "turned", "mirrored", "unknown")
# The witness would refuse some before they are asked.
_CONFIG = Config(measurement=MeasurementConfig(witness=False))


def run_panel(task: tuple[str, str]) -> dict[str, str]:
    """Return what is said of a picture's labels each way, where the fit is accepted: (folder, name)."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    side, found = picture.image.shape[1], {}
    for name, way in _WAYS.items():
        image = np.ascontiguousarray(put(picture.image, way))
        detections = [_put(d, way, side) for d in true_detections(picture)]
        camera = stretched_camera(1.0, side)
        fit = fit_panel(detections, camera, _CONFIG, image=image)
        if fit.ok:
            found[name] = _said(way_up(image, camera, fit, detections))
    return found


def _put(detection: Detection, way: int, side: int) -> Detection:
    """Return the box in the square picture that is put another way, as `put` does."""
    x, y, width, height = detection.x_px, detection.y_px, detection.width_px, detection.height_px
    x = side - 1 - x if way >= 4 else x
    for _ in range(way % 4):
        x, y, width, height = y, side - 1 - x, height, width
    return replace(detection, x_px=x, y_px=y, width_px=width, height_px=height)


def _said(labels: WayUp) -> str:
    if labels.mirrored or labels.quarter_turns:
        return "mirrored" if labels.mirrored else "turned"
    return "upright" if labels.upright else "unknown"


def attitude_table(folder: Path, figures: Figures) -> str:
    """Return the table over the validation part."""
    names = [p.name for p in read_labelled(folder, validation=True) if judgeable(p)]
    several = parallel(run_panel, [(str(folder), name) for name in names], "which way up")
    lines = [f"{'labels, by true boxes':<24}{'accepted':>10}" + "".join(f"{said:>10}" for said in _SAID)]
    for name in _WAYS:
        of_way = Counter(found[name] for found in several if name in found)
        number = of_way.total()
        figures.share(f"labels {name}, said to be upright", of_way["upright"], number)
        lines.append(f"{name:<24}{number:>10}" + "".join(f"{of_way[s] / max(1, number):>10.3f}" for s in _SAID))
    return "\n".join(lines)
