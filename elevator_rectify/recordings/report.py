"""What came out of a bag: a table like the paper's Table I and a contact sheet like its Fig. 1 and 2."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation_angle_rad
from elevator_rectify.core.types import Array, Image, IntArray
from elevator_rectify.core.view.draw import WHITE, caption, outlined_text
from elevator_rectify.recordings.evaluate import right_cells
from elevator_rectify.recordings.topics import OUTPUT_PREFIX, STREAM_TYPES
from elevator_rectify.ros.bag import BadBag, Record, Unreadable, bag_topics, read_bag
from elevator_rectify.ros.config import DETECTION_TYPES
from elevator_rectify.ros.convert import camera_from_message, detections_from_message, output_stamp_ns, stamp_ns
from elevator_rectify.ros.pictures import BadMessage, image_from_message
from elevator_rectify.ros.poses import rotation_of

_TILE = (320, 240)
# A contact sheet has no more images.
_MOST_TILES = 60


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
    viewed: bool = False

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
        if self.true_buttons is None or len(self.true_buttons) != len(self.true_cells):
            return float("nan")
        grid = self.grid.reshape(int(self.values["rows"]), int(self.values["columns"]), 3)
        truth = self.camera.project(self.true_buttons @ R.T + t)
        return right_cells(self.detections, self.camera.project(grid), truth, self.true_cells)


@dataclass(frozen=True)
class Pictures:
    """What was published of one image for people."""

    overlay: Image | None = None
    view: Image | None = None


@dataclass(frozen=True)
class Report:
    """What came out of a bag: the table, and by method the outcomes and, of those shown, the pictures by stamp."""

    table: str
    outcomes: dict[str, list[Outcome]]
    pictures: dict[str, dict[int, Pictures]]


def read_outcomes(source: Path, output: Path) -> list[Outcome]:
    """Join the input bag and an output bag by stamp, oldest first; pictures are left in the bags."""
    outcomes: dict[int, Outcome] = {}
    kinds = {name: kind for name, (kind, _) in bag_topics(source).items()}
    for record, message in _messages(
        source, {name for name, kind in kinds.items() if kind not in STREAM_TYPES["image"]}
    ):
        header = message if record.kind == "std_msgs/msg/Header" else getattr(message, "header", None)
        if header is None:
            continue
        outcome = outcomes.setdefault(stamp_ns(header), Outcome(stamp_ns(header)))
        _take_input(outcome, record.topic, kinds[record.topic], message)
    topics = {name for name, (kind, _) in bag_topics(output).items() if kind not in STREAM_TYPES["image"]}
    for record, message in _messages(output, topics):
        stamp = output_stamp_ns(message)
        if stamp in outcomes:
            _take_output(outcomes[stamp], record.topic.removeprefix(OUTPUT_PREFIX), message)
    return [outcomes[stamp] for stamp in sorted(outcomes) if outcomes[stamp].values]


def read_pictures(output: Path, stamps: Collection[int]) -> dict[int, Pictures]:
    """Return the pictures of these stamps."""
    found: dict[int, Pictures] = {}
    names = {f"{OUTPUT_PREFIX}overlay": "overlay", f"{OUTPUT_PREFIX}rectified/image": "view"}
    for record, message in _messages(output, names.keys() & bag_topics(output).keys()):
        stamp = stamp_ns(message.header)
        if stamp in stamps:
            given = {names[record.topic]: image_from_message(message)}
            found[stamp] = replace(found.get(stamp, Pictures()), **given)
    return found


def _messages(path: Path, topics: Collection[str]) -> Iterator[tuple[Record, Any]]:
    """Yield what can be read of the topics, of a damaged bag too."""
    try:
        for record in read_bag(path, set(topics)):
            with suppress(Unreadable):
                yield record, record.message
    except BadBag:
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
        # Of a camera that is not calibrated nothing is compared; its frames were refused with the reason.
        with suppress(BadMessage):
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
    elif topic == "rectified/camera_info":
        outcome.viewed = True


def pose_of_message(message: Any) -> tuple[Array, Array]:
    """Return R (3, 3) and t (3,) of a geometry_msgs/Pose."""
    q, p = message.orientation, message.position
    return rotation_of(q.x, q.y, q.z, q.w), np.array([p.x, p.y, p.z])


def _positions(message: Any) -> Array:
    return np.array([[p.position.x, p.position.y, p.position.z] for p in message.poses]).reshape(-1, 3)


def table(outcomes: Mapping[str, Sequence[Outcome]]) -> str:
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


def contact_sheet(outcomes: Sequence[Outcome], pictures: Mapping[int, Pictures], columns: int = 5) -> Image:
    """Return every image's overlay above its rectified view, `columns` images a row."""
    tiles = []
    for row in outcomes:
        shown = pictures.get(row.stamp, Pictures())
        tiles.append(np.vstack([_named(_tile(shown.overlay, ""), row.name), _tile(shown.view, row.verdict)]))
    blank = np.zeros((2 * _TILE[1], _TILE[0], 3), np.uint8)
    return tiled(tiles, columns) if tiles else blank


def tiled(tiles: Sequence[Image], columns: int) -> Image:
    """Return tiles of one size row by row, the last row filled up with black."""
    blank = np.zeros_like(tiles[0])
    filled = [*tiles, *[blank] * (-len(tiles) % columns)]
    return np.vstack([np.hstack(filled[k : k + columns]) for k in range(0, len(filled), columns)])


def last_viewed(outcomes: Sequence[Outcome], groups: int = 3) -> list[Outcome]:
    """Return the last image with a rectified view of the first few groups."""
    return list({row.group: row for row in outcomes if row.viewed}.values())[:groups]


def before_after(pictures: Sequence[Pictures]) -> Image | None:
    """Return overlay and rectified view, side by side, of every picture that has both, below each other."""
    pairs = []
    for shown in pictures:
        if shown.overlay is None or shown.view is None:
            continue
        height = shown.overlay.shape[0]
        width = round(shown.view.shape[1] * height / shown.view.shape[0])
        pairs.append(np.hstack([shown.overlay, cv2.resize(shown.view, (width, height), interpolation=cv2.INTER_AREA)]))
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


def write_report(source: Path, outputs: dict[str, Path], folder: Path) -> Report:
    """Print the table and write it beside one contact sheet per method; say where they are."""
    outcomes = {method: read_outcomes(source, output) for method, output in outputs.items()}
    text = table(outcomes)
    print(text)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "table.txt").write_text(text + "\n")
    pictures = {}
    for method, rows in outcomes.items():
        pictures[method] = _write_pictures(method, rows, outputs[method], folder)
        print(f"bag:      {outputs[method]}")
    print(f"table:    {folder / 'table.txt'}")
    return Report(text, outcomes, pictures)


def _write_pictures(method: str, rows: list[Outcome], output: Path, folder: Path) -> dict[int, Pictures]:
    """Write contact sheet and before_after of one method, of a long bag every n-th image; say what was written.

    Returns the contact sheet's pictures by stamp.
    """
    every = max(1, math.ceil(len(rows) / _MOST_TILES))
    chosen, last = rows[::every], last_viewed(rows)
    pictures = read_pictures(output, {row.stamp for row in [*chosen, *last]})
    sheet = folder / f"contact_sheet_{method}.jpg"
    if cv2.imwrite(str(sheet), contact_sheet(chosen, pictures)):
        print(f"pictures: {sheet}" + (f", every {every}th of {len(rows)} images" if every > 1 else ""))
    pair = before_after([pictures[row.stamp] for row in last if row.stamp in pictures])
    if pair is not None:
        cv2.imwrite(str(folder / f"before_after_{method}.jpg"), pair, [cv2.IMWRITE_JPEG_QUALITY, 85])
    return {row.stamp: pictures[row.stamp] for row in chosen if row.stamp in pictures}
