"""The paper's claim: pictures of panels seen askew are read better in the rectified view than as they are."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.benchmark import rapidocr
from elevator_rectify.benchmark.end_to_end import CONFIG, first_accepted, judgeable, true_detections
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core import Camera, Detection, GridFit, fit_panel
from elevator_rectify.core.find import with_labels
from elevator_rectify.core.geometry.rotations import rotation
from elevator_rectify.core.reading.labels import canonical
from elevator_rectify.core.reading.plates import PLATE
from elevator_rectify.core.reading.reader import box_corners_px, plane_corners_px, read_boxes, read_in_plane
from elevator_rectify.core.reading.vocabulary import encoded
from elevator_rectify.core.types import Array, Image
from elevator_rectify.train.labelled import read_labelled

ANGLES_DEG = (0.0, 20.0, 40.0, 55.0, 65.0)


@dataclass(frozen=True)
class Count:
    """Texts of one picture at one angle: whether the fit was accepted, how many there are, and right as the boxes are,
    in the plane, and after the panel's order; the same three by RapidOCR, where it is installed."""

    accepted: bool
    texts: int
    own: tuple[int, ...]
    rapidocr: tuple[int, ...] = ()


@dataclass(frozen=True)
class Turned:
    """A turned picture with its boxes."""

    image: Image
    detections: list[Detection]


def turned(image: Image, detections: list[Detection], camera: Camera, fit: GridFit, angle_deg: float) -> Turned:
    """Return picture and boxes as if the panel were turned about its upright middle line."""
    K, R, middle = camera.matrix, fit.R_camera_panel, fit.grid_panel.reshape(-1, 2).mean(axis=0)
    R2 = R @ rotation(np.array([0.0, np.deg2rad(angle_deg), 0.0]))
    point = R[:, :2] @ middle + fit.t_camera_panel
    before = K @ np.column_stack([R[:, :2], fit.t_camera_panel])
    after = K @ np.column_stack([R2[:, :2], point - R2[:, :2] @ middle])
    H = after @ np.linalg.inv(before)
    seen = cv2.warpPerspective(image, H, (image.shape[1], image.shape[0]), borderMode=cv2.BORDER_REPLICATE)
    return Turned(seen, [_turned_box(d, H) for d in detections])


def _turned_box(d: Detection, H: Array) -> Detection:
    """Return the upright box of a box's ellipse after the map H (3, 3)."""
    s = np.linspace(0.0, 2.0 * np.pi, 32, endpoint=False)
    outline = np.column_stack([d.x_px + d.width_px / 2 * np.cos(s), d.y_px + d.height_px / 2 * np.sin(s)])
    seen = cv2.perspectiveTransform(outline[:, None], H)[:, 0]
    low, high = seen.min(axis=0), seen.max(axis=0)
    x, y = (low + high) / 2.0
    return replace(d, x_px=float(x), y_px=float(y), width_px=float(high[0] - low[0]), height_px=float(high[1] - low[1]))


def run_picture(task: tuple[str, str]) -> list[Count]:
    """Turn one picture by all angles: (folder, name); nothing where its fit is refused."""
    (picture,) = read_labelled(Path(task[0]), names=(task[1],))
    truth = true_detections(picture)
    bare = [replace(d, label="") for d in truth]
    accepted = first_accepted(picture, bare)
    if accepted is None:
        return []
    fit, camera = accepted
    texts = [k for k, d in enumerate(truth) if d.label and (encoded(d.label) or ("",))[0] == "text"]
    return [_count(turned(picture.image, bare, camera, fit, a), truth, texts, camera) for a in ANGLES_DEG]


def _count(seen: Turned, truth: list[Detection], texts: list[int], camera: Camera) -> Count:
    """Read a turned picture in all ways; where its fit is refused, the boxes are read as they are."""
    inside = [k for k in texts if _inside(seen.detections[k], camera)]
    fit = fit_panel(seen.detections, camera, CONFIG, image=seen.image)
    direct = [r.label for r in read_boxes(seen.image, seen.detections)]
    plane = [r.label for r in read_in_plane(seen.image, camera, fit)] if fit.ok else direct
    labelled = with_labels(fit, seen.image, camera)
    own = _right(truth, inside, direct, plane, labelled)
    if not rapidocr.installed():
        return Count(fit.ok, len(inside), own)
    boxes = rapidocr.read_by_rapidocr(seen.image, box_corners_px(seen.detections))
    said = boxes
    if fit.ok:
        said = rapidocr.read_by_rapidocr(seen.image, plane_corners_px(fit, camera, seen.detections))
    brought = [replace(d, label=t, score=score) for d, (t, score) in zip(seen.detections, said, strict=True)]
    labelled = replace(fit, detections=tuple(brought))
    theirs = _right(truth, inside, [text for text, _ in boxes], [text for text, _ in said], labelled)
    return Count(fit.ok, len(inside), own, theirs)


def _right(
    truth: list[Detection], inside: list[int], direct: list[str], plane: list[str], labelled: GridFit
) -> tuple[int, ...]:
    """Count what is right as the boxes are read, in the plane, and after the order where there is a fit."""
    # What is a label's plate is as it is read: its label is that of the button beside it.
    ordered = {b.detection: b.label for b in labelled.buttons if b.label != PLATE} if labelled.ok else {}
    after = {k: ordered.get(k, plane[k]) for k in inside}
    return tuple(
        sum(canonical(labels[k]) == canonical(truth[k].label) for k in inside) for labels in (direct, plane, after)
    )


def _inside(d: Detection, camera: Camera) -> bool:
    return 0.0 <= d.x_px < camera.width and 0.0 <= d.y_px < camera.height


def turned_reading_table(folder: Path, figures: Figures) -> str:
    """Return the table over the validation part's panels that are accepted as they are."""
    tasks = [(str(folder), p.name) for p in read_labelled(folder, validation=True) if judgeable(p)]
    results = [r for r in parallel(run_picture, tasks, "turned pictures") if r]
    by_angle = list(zip(ANGLES_DEG, zip(*results, strict=True), strict=True))
    lines = [f"texts of {len(results)} real panels turned about their upright middle, true boxes, right by the reader"]
    lines += _lines("our own reader", by_angle, "own")
    for angle, counts in by_angle:
        rectified, texts = sum(c.own[1] for c in counts), sum(c.texts for c in counts)
        figures.share(f"real panels turned by {angle:g}, texts rectified+", rectified, texts)
    if rapidocr.installed():
        lines += _lines("RapidOCR, the surer of two views", by_angle, "rapidocr")
    return "\n".join(lines)


def _lines(title: str, by_angle: list[tuple[float, tuple[Count, ...]]], reader: str) -> list[str]:
    """Return the table of one reader."""
    lines = [
        title,
        f"{'turned by':<11}{'fit accepted':>13}{'texts':>7}{'as they are':>13}{'rectified':>11}{'after the order':>17}",
    ]
    for angle, counts in by_angle:
        texts = sum(c.texts for c in counts)
        direct, rectified, ordered = np.sum([getattr(c, reader) for c in counts], axis=0) / max(1, texts)
        accepted = np.mean([c.accepted for c in counts])
        lines.append(f"{angle:<11g}{accepted:>13.3f}{texts:>7}{direct:>13.3f}{rectified:>11.3f}{ordered:>17.3f}")
    return lines
