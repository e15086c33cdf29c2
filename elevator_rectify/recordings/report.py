"""What came out of a bag: a table like the paper's Table I and a contact sheet like its Fig. 1 and 2."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.types import Array, Image, IntArray
from elevator_rectify.core.view.draw import WHITE, caption, outlined_text
from elevator_rectify.recordings.evaluate import right_cells
from elevator_rectify.ros.bag import bag_topics, read_bag
from elevator_rectify.ros.config import DETECTION_TYPES
from elevator_rectify.ros.convert import camera_from_message, detections_from_message, output_stamp_ns, stamp_ns
from elevator_rectify.ros.pictures import image_from_message

_TILE = (320, 240)


@dataclass
class Outcome:
    """All that input, truth and output bags say of one image."""

    stamp: int
    group: str = "all"
    name: str = ""
    values: dict[str, str] = field(default_factory=dict)
    verdict: str = ""
    camera: Camera | None = None
    detections: Array = field(default_factory=lambda: np.zeros((0, 2)))
    true_pose: tuple[Array, Array] | None = None
    true_buttons: Array | None = None
    true_cells: IntArray | None = None
    true_labels: tuple[str, ...] = ()
    pose: tuple[Array, Array] | None = None
    target: Array | None = None
    grid: Array | None = None
    overlay: Image | None = None
    view: Image | None = None

    @property
    def ok(self) -> bool:
        """Tell whether a pose was published."""
        return self.pose is not None

    def rotation_error_deg(self) -> float:
        """Return the angle between published and true rotation; NaN where either is missing."""
        if self.pose is None or self.true_pose is None:
            return float("nan")
        return float(np.rad2deg(rotation_angle_rad(self.pose[0].T @ self.true_pose[0])))

    def target_error_m(self, label: str) -> float:
        """Return how far the published target is from the true button of that label; NaN where either is missing."""
        if self.target is None or self.true_pose is None or self.true_buttons is None or label not in self.true_labels:
            return float("nan")
        R, t = self.true_pose
        return float(np.linalg.norm(R @ self.true_buttons[self.true_labels.index(label)] + t - self.target))

    def right_share(self) -> float:
        """Return the share of the detected true buttons that are in the right relative cell of the grid."""
        if self.grid is None or self.true_cells is None or self.true_pose is None or self.camera is None:
            return float("nan")
        R, t = self.true_pose
        assert self.true_buttons is not None
        grid = self.grid.reshape(int(self.values["rows"]), int(self.values["columns"]), 3)
        truth = self.camera.project(self.true_buttons @ R.T + t)
        return right_cells(self.detections, self.camera.project(grid), truth, self.true_cells)


def read_outcomes(source: Path, output: Path) -> list[Outcome]:
    """Join the input bag and an output bag by stamp, oldest first."""
    outcomes: dict[int, Outcome] = {}
    kinds = {name: kind for name, (kind, _) in bag_topics(source).items()}
    for record in read_bag_quietly(source):
        message = record.message
        header = message if record.kind == "std_msgs/msg/Header" else getattr(message, "header", None)
        if header is None:
            continue
        outcome = outcomes.setdefault(stamp_ns(header), Outcome(stamp_ns(header)))
        _take_input(outcome, record.topic, kinds[record.topic], message)
    for record in read_bag_quietly(output):
        message, topic = record.message, record.topic.removeprefix("/elevator_rectify/")
        stamp = output_stamp_ns(message)
        if stamp in outcomes:
            _take_output(outcomes[stamp], topic, message)
    return [outcomes[stamp] for stamp in sorted(outcomes) if outcomes[stamp].values]


def read_bag_quietly(path: Path) -> Any:
    """Yield what can be read of a bag, damaged or not."""
    try:
        yield from read_bag(path)
    except ValueError:
        return


def _take_input(outcome: Outcome, topic: str, kind: str, message: Any) -> None:
    if topic == "/truth/panel_pose":
        outcome.true_pose = pose_of_message(message.pose)
    elif topic == "/truth/buttons":
        outcome.true_buttons = _positions(message)
    elif topic == "/truth/cells":
        outcome.true_cells, outcome.group = _positions(message).round().astype(np.int64), message.header.frame_id
    elif topic == "/truth/labels":
        outcome.true_labels = tuple(message.frame_id.split(","))
    elif kind == "std_msgs/msg/Header":
        outcome.name = message.frame_id
    elif kind == "sensor_msgs/msg/CameraInfo":
        outcome.camera = camera_from_message(message)
    elif kind in DETECTION_TYPES.values():
        outcome.detections = np.array([[d.x_px, d.y_px] for d in detections_from_message(message)]).reshape(-1, 2)


def _take_output(outcome: Outcome, topic: str, message: Any) -> None:
    if topic == "status":
        outcome.values = {pair.key: pair.value for pair in message.values}
        outcome.verdict = message.message
    elif topic == "panel_pose":
        outcome.pose = pose_of_message(message.pose.pose)
    elif topic == "target_pose":
        outcome.target = pose_of_message(message.pose)[1]
    elif topic == "grid_centers":
        outcome.grid = _positions(message)
    elif topic == "overlay":
        outcome.overlay = image_from_message(message)
    elif topic == "rectified/image":
        outcome.view = image_from_message(message)


def pose_of_message(message: Any) -> tuple[Array, Array]:
    """Return R (3, 3) and t (3,) of a geometry_msgs/Pose."""
    q, p = message.orientation, message.position
    half = np.array([q.x, q.y, q.z])
    length = float(np.linalg.norm(half))
    vector = half / length * 2.0 * np.arctan2(length, q.w) if length > 1e-12 else np.zeros(3)
    return np.asarray(cv2.Rodrigues(vector)[0]), np.array([p.x, p.y, p.z])


def _positions(message: Any) -> Array:
    return np.array([[p.position.x, p.position.y, p.position.z] for p in message.poses]).reshape(-1, 3)


def table(outcomes: dict[str, list[Outcome]]) -> str:
    """Return methods by groups: the paper's metric x 1000, accepted, and against the truth where it is known."""
    lines = [
        f"{'method':<18}{'group':<14}{'images':>7}{'accepted':>9}{'metric x 1000':>15}"
        f"{'rot. err. deg':>15}{'right cells':>13}"
    ]
    for method, rows in outcomes.items():
        groups = sorted({row.group for row in rows})
        for group in [*groups, "average"] if len(groups) > 1 else groups:
            lines.append(_line(method, group, [row for row in rows if group in ("average", row.group)]))
    return "\n".join(lines)


def _line(method: str, group: str, rows: Sequence[Outcome]) -> str:
    good = [row for row in rows if row.ok]
    metric = np.mean([float(row.values["cost_x1000"]) for row in good]) if good else np.nan
    errors = [row.rotation_error_deg() for row in good]
    shares = [row.right_share() for row in good]
    numbers = [
        f"{np.mean(x):{form}}" if x and np.isfinite(x).all() else "-" for x, form in ((errors, ".2f"), (shares, ".3f"))
    ]
    return f"{method:<18}{group:<14}{len(rows):>7}{len(good):>9}{metric:>15.4f}{numbers[0]:>15}{numbers[1]:>13}"


def contact_sheet(outcomes: Sequence[Outcome], columns: int = 5) -> Image:
    """Return every image's overlay above its rectified view, `columns` images a row."""
    tiles = [np.vstack([_named(_tile(row.overlay, ""), row.name), _tile(row.view, row.verdict)]) for row in outcomes]
    blank = np.zeros((2 * _TILE[1], _TILE[0], 3), np.uint8)
    tiles += [blank] * (-len(tiles) % columns)
    return np.vstack([np.hstack(tiles[k : k + columns]) for k in range(0, len(tiles), columns)] or [blank])


def before_after(outcomes: Sequence[Outcome], groups: int = 3) -> Image | None:
    """Return overlay and rectified view, side by side, of the last accepted image of the first few groups."""
    last = {row.group: row for row in outcomes if row.overlay is not None and row.view is not None}
    pairs = []
    for row in list(last.values())[:groups]:
        assert row.overlay is not None and row.view is not None
        height = row.overlay.shape[0]
        width = round(row.view.shape[1] * height / row.view.shape[0])
        pairs.append(np.hstack([row.overlay, cv2.resize(row.view, (width, height), interpolation=cv2.INTER_AREA)]))
    widest = max((pair.shape[1] for pair in pairs), default=0)
    padded = [cv2.copyMakeBorder(pair, 0, 0, 0, widest - pair.shape[1], cv2.BORDER_CONSTANT) for pair in pairs]
    if not padded:
        return None
    return np.asarray(cv2.resize(np.vstack(padded), None, fx=0.7, fy=0.7, interpolation=cv2.INTER_AREA))


def _named(tile: Image, name: str) -> Image:
    """Write the picture's file name into the upper left corner of its tile."""
    return outlined_text(tile, name, (6, 18), 0.5, WHITE) if name else tile


def _tile(image: Image | None, text: str) -> Image:
    """Fit an image into a tile; without one, write why."""
    canvas = np.zeros((_TILE[1], _TILE[0], 3), np.uint8)
    if image is None:
        words, lines = text.split(), [""]
        for word in words:
            lines = [*lines[:-1], f"{lines[-1]} {word}"] if len(lines[-1]) + len(word) < 42 else [*lines, word]
        return caption(canvas, lines, (40, 170, 250))
    scale = min(_TILE[0] / image.shape[1], _TILE[1] / image.shape[0])
    size = (max(1, int(image.shape[1] * scale)), max(1, int(image.shape[0] * scale)))
    small = cv2.resize(
        image if image.ndim == 3 else cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), size, interpolation=cv2.INTER_AREA
    )
    x, y = (_TILE[0] - size[0]) // 2, (_TILE[1] - size[1]) // 2
    canvas[y : y + size[1], x : x + size[0]] = small
    return canvas


def write_report(source: Path, outputs: dict[str, Path], folder: Path) -> dict[str, list[Outcome]]:
    """Print the table and write it beside one contact sheet per method; say where they are."""
    outcomes = {method: read_outcomes(source, output) for method, output in outputs.items()}
    text = table(outcomes)
    print(text)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "table.txt").write_text(text + "\n")
    for method, rows in outcomes.items():
        sheet = folder / f"contact_sheet_{method}.jpg"
        cv2.imwrite(str(sheet), contact_sheet(rows))
        print(f"pictures: {sheet}")
        pair = before_after(rows)
        if pair is not None:
            cv2.imwrite(str(folder / f"before_after_{method}.jpg"), pair, [cv2.IMWRITE_JPEG_QUALITY, 85])
        print(f"bag:      {outputs[method]}")
    print(f"table:    {folder / 'table.txt'}")
    return outcomes
