"""Virtual rotation of the photographs: a turn of the camera about its centre is a homography of the picture.

The estimate must turn by exactly as much; by how much it does not is the estimator's noise, without any truth.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.real import boxes_to_detections, edge_deviations_deg, rectifying_map
from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.geometry.rotations import rotation, rotation_angle_rad
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.types import Array, Image
from elevator_rectify.recordings.make_bag import photograph_camera

_CONFIG = Config()
_LARGEST_TURN_RAD = np.deg2rad(15.0)
_NOISE_SHARE = 0.04


def turned_view(image: Image, boxes: Array, camera: Camera, R: Array, rng: np.random.Generator) -> tuple[Image, Array]:
    """Return the picture of the camera turned by R, and the boxes around the turned boxes, with a detector's noise."""
    H = camera.matrix @ R @ np.linalg.inv(camera.matrix)
    turned = cv2.warpPerspective(image, H, (camera.width, camera.height), borderMode=cv2.BORDER_REPLICATE)
    corners = boxes[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2).astype(float)
    corners = cv2.perspectiveTransform(corners.reshape(-1, 1, 2), H).reshape(-1, 4, 2)
    moved = np.concatenate([corners.min(axis=1), corners.max(axis=1)], axis=1)
    size = np.sqrt(np.prod(moved[:, 2:] - moved[:, :2], axis=1))[:, None]
    return turned, moved + rng.normal(0.0, 1.0, moved.shape) * _NOISE_SHARE * size


def spread_deg(rotations: list[Array]) -> float:
    """Return the rms angle of the rotations from their mean; NaN for fewer than three."""
    if len(rotations) < 3:
        return float("nan")
    u, _, vt = np.linalg.svd(np.sum(rotations, axis=0))
    mean = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return float(np.rad2deg(np.sqrt(np.mean([rotation_angle_rad(mean.T @ R) ** 2 for R in rotations]))))


def run_photograph(task: tuple[str, str, int]) -> dict[str, Any]:
    """Return one photograph's line: (folder, name, turns)."""
    folder, name, turns = Path(task[0]), task[1], task[2]
    entry = json.loads((folder / "photos.json").read_text())[name]
    image = cv2.imread(str(folder / f"{name}.jpg"))
    camera = photograph_camera(entry["size"], entry["focal_over_max_size"])
    boxes, rng = np.array(entry["boxes"], dtype=float), np.random.default_rng([77, len(name), turns])
    line: dict[str, Any] = {"before": edge_deviations_deg(entry, np.eye(3)).mean()}
    for which, picture in (("boxes", None), ("picture", image)):
        fit = fit_panel(boxes_to_detections(boxes), camera, _CONFIG, image=picture)
        H = rectifying_map(camera, fit)
        line[which] = edge_deviations_deg(entry, H).mean() if fit.ok else float("nan")
        line[f"{which} status"] = fit.status
    found: dict[str, list[Array]] = {"boxes": [], "picture": []}
    for _ in range(turns):
        axis = rng.normal(0.0, 1.0, 3)
        R = rotation(axis / np.linalg.norm(axis) * rng.uniform(0.0, _LARGEST_TURN_RAD))
        turned, moved = turned_view(image, boxes, camera, R, rng)
        for which, picture in (("boxes", None), ("picture", turned)):
            fit = fit_panel(boxes_to_detections(moved), camera, _CONFIG, image=picture)
            if fit.ok:
                found[which].append(R.T @ fit.R_camera_panel)
    for which, rotations in found.items():
        line[f"{which} spread"], line[f"{which} turns"] = spread_deg(rotations), len(rotations)
    return line


def turned_table(folder: Path, turns: int, figures: Figures) -> str:
    """Return the table of the photographs: edges and spread, by boxes and by picture."""
    names = sorted(json.loads((folder / "photos" / "photos.json").read_text()))
    tasks = [(str(folder / "photos"), name, turns) for name in names]
    results = parallel(run_photograph, tasks, "photographs turned")
    lines = [
        f"{'photo':<7}{'before':>7} |{'edges after: boxes':>19}{'picture':>9} |{'spread: boxes':>14}{'picture':>9} | "
        f"accepted of {turns} turns; verdict with picture"
    ]
    for name, r in zip(names, results, strict=True):
        lines.append(
            f"{name:<7}{r['before']:>7.2f} |{r['boxes']:>19.2f}{r['picture']:>9.2f} |{r['boxes spread']:>14.2f}"
            f"{r['picture spread']:>9.2f} | {r['boxes turns']:>2} {r['picture turns']:>2}  {r['picture status']}"
        )
    for which in ("boxes", "picture"):
        after = np.array([r[which] for r in results])
        figures.rate(f"photographs {which} accepted+", np.isfinite(after))
        figures.median(f"photographs {which} edges after deg-", after)
        worse = np.nanmax(after - np.array([r["before"] for r in results]))
        lines.append(
            f"{which}: accepted {np.isfinite(after).sum()} of {len(names)}; edges {np.nanmean(after):.2f} mean, "
            f"{np.nanmedian(after):.2f} median, {np.nanmax(after):.2f} worst; most worse than before {worse:+.2f}; "
            f"median spread {np.nanmedian([r[f'{which} spread'] for r in results]):.2f} degrees"
        )
    return "\n".join(lines)
