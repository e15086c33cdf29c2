"""Real panels: photographs with physical straight edges, and outlines of 109 panels. Skipped where they are absent."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.core.config import Config
from elevator_rectify.core.geometry.camera import Camera
from elevator_rectify.core.pipeline import fit_panel
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.types import Array, Detection
from elevator_rectify.recordings.make_bag import photograph_camera

_CONFIG = Config()


def boxes_to_detections(boxes: Array) -> list[Detection]:
    """Return detections of boxes (N, 4) xmin, ymin, xmax, ymax."""
    return [Detection(float((a + c) / 2), float((b + d) / 2), float(c - a), float(d - b)) for a, b, c, d in boxes]


def edge_deviations_deg(entry: dict[str, Any], H: Array) -> Array:
    """Return the angles of the physical edges from upright (or level) after the homography H."""
    angles = []
    for name, axis in (("vertical", 1), ("horizontal", 0)):
        lines = np.array(entry[name], dtype=float).reshape(-1, 2, 2)
        ends = cv2.perspectiveTransform(lines.reshape(-1, 1, 2), H).reshape(-1, 2, 2)
        d = ends[:, 1] - ends[:, 0]
        angles.append(np.rad2deg(np.arctan2(np.abs(d[:, 1 - axis]), np.abs(d[:, axis]))))
    return np.concatenate(angles)


def rectifying_map(camera: Camera, fit: GridFit) -> Array:
    """Return the homography (3, 3) that turns the picture to face the panel."""
    return np.asarray(camera.matrix @ fit.R_camera_panel.T @ np.linalg.inv(camera.matrix))


def photographs(folder: Path, figures: Figures) -> str:
    """Return the table of the photographs: edges before and after, right cells, verdict."""
    entries = json.loads((folder / "photos" / "photos.json").read_text())
    lines, before_all, after_all = [f"{'photo':<7}{'boxes':>6}{'before':>8}{'after':>7}{'cells':>7}  verdict"], [], []
    for name, entry in sorted(entries.items()):
        camera = photograph_camera(entry["size"], entry["focal_over_max_size"])
        fit = fit_panel(boxes_to_detections(np.array(entry["boxes"])), camera, _CONFIG)
        before = edge_deviations_deg(entry, np.eye(3)).mean()
        after = edge_deviations_deg(entry, rectifying_map(camera, fit)).mean() if fit.ok else float("nan")
        if fit.ok:
            before_all.append(before)
            after_all.append(after)
        verdict = "ok" if fit.ok else f"{fit.status}: {fit.reason}"
        lines.append(
            f"{name:<7}{len(entry['boxes']):>6}{before:>8.2f}{after:>7.2f}{_cells(entry, fit):>7.2f}  {verdict}"
        )
    figures.share("photographs boxes accepted+", len(after_all), len(entries))
    figures.median("photographs boxes edges after deg-", after_all)
    lines.append(
        f"accepted {len(after_all)} of {len(entries)}: edges before {np.mean(before_all):.2f}, after "
        f"{np.mean(after_all):.2f} mean, {np.median(after_all):.2f} median, {np.max(after_all):.2f} worst, degrees"
    )
    return "\n".join(lines)


def _cells(entry: dict[str, Any], fit: GridFit) -> float:
    """Return the share of the main block's buttons in the right relative cell."""
    labelled = [(n, cell) for n, cell in enumerate(entry["cells"]) if cell is not None and entry["block"][n] == 0]
    pairs = [tuple(fit.cells[n] - np.array(cell)) for n, cell in labelled if fit.cells[n, 0] >= 0]
    return max((pairs.count(p) for p in set(pairs)), default=0) / max(1, len(labelled))


def _buttons(entry: dict[str, Any]) -> list[dict[str, Any]]:
    return [region for region in entry["regions"] if region["kind"] == "button"]


def mixed(folder: Path, figures: Figures) -> str:
    """Return the figures of the 109 panels: accepted, on the lattice, left-out buttons predicted, outlines' shape."""
    entries = json.loads((folder / "panels_mixed.json").read_text())
    judged = accepted = on = total = tried = predicted = 0
    ratios: list[float] = []
    spreads: list[float] = []
    for entry in entries.values():
        regions = _buttons(entry)
        boxes = np.array([region["box"] for region in regions]).reshape(-1, 4)
        if not _judgeable(boxes):
            continue
        judged += 1
        camera = photograph_camera(panel_size(entry), None)
        detections = boxes_to_detections(boxes)
        fit = fit_panel(detections, camera, _CONFIG)
        if not fit.ok:
            continue
        accepted += 1
        on, total = on + fit.inliers, total + len(boxes)
        hits = [_predicts(detections, k, camera) for k in range(len(boxes))]
        tried, predicted = tried + len(hits), predicted + sum(hits)
        axes = rectified_axes(regions, camera, fit)
        ratios += (axes[:, 0] / axes[:, 1]).tolist()
        if len(axes) > 3:
            radii = np.sqrt(axes.prod(axis=1))
            spreads.append(float(np.median(np.abs(radii / np.median(radii) - 1.0))))
    figures.share("outlined panels accepted+", accepted, judged)
    figures.share("outlined panels left-out button predicted+", predicted, tried)
    return (
        f"panels with six buttons in two rows and two columns: {judged}, accepted {accepted / judged:.3f}\n"
        f"of their buttons on the lattice {on / total:.3f}; left out in turn and predicted within 0.35 of its size "
        f"{predicted / tried:.3f}\n"
        f"ellipses after rectification: mean axis ratio {np.mean(ratios):.3f} of {len(ratios)}, "
        f"spread of a panel's radii {np.mean(spreads):.3f}"
    )


def panel_size(entry: dict[str, Any]) -> tuple[int, int]:
    """Return width and height of a panel's picture, which are unknown: those of the labelled part, with a margin."""
    width, height = np.array([region["box"] for region in entry["regions"]])[:, 2:].max(axis=0)
    return math.ceil(1.15 * width), math.ceil(1.15 * height)


def _judgeable(boxes: Array) -> bool:
    """Tell whether there are six buttons in at least two rows and two columns, by the boxes' overlap."""
    if len(boxes) < 6:
        return False
    return all(_lines(boxes[:, k], boxes[:, k + 2]) >= 2 for k in (0, 1))


def _lines(low: Array, high: Array) -> int:
    """Count the groups of intervals whose centres are further apart than half an interval."""
    centres = np.sort((low + high) / 2)
    return 1 + int((np.diff(centres) > 0.5 * np.median(high - low)).sum())


def _predicts(detections: list[Detection], k: int, camera: Camera) -> bool:
    """Tell whether the fit to all others has a grid centre within 0.35 of the size of detection k."""
    fit = fit_panel(detections[:k] + detections[k + 1 :], camera, _CONFIG)
    if not np.isfinite(fit.t_camera_panel).all():
        return False
    # The left-out button may be one cell outside of the seen grid.
    nodes = _extended(fit)
    pixels = camera.project(nodes @ fit.R_camera_panel[:, :2].T + fit.t_camera_panel)
    d = detections[k]
    distance = np.linalg.norm(pixels - [d.x_px, d.y_px], axis=-1)
    return bool(np.nanmin(distance) < 0.35 * np.sqrt(d.width_px * d.height_px))


def _extended(fit: GridFit) -> Array:
    """Return the grid's points in the panel (M, 2), with one more row and column on each side."""
    rows = np.concatenate([[-1.0], fit.row_positions, [fit.row_positions[-1] + 1]])
    columns = np.concatenate([[-1.0], fit.column_positions, [fit.column_positions[-1] + 1]])
    row_shift = np.concatenate([[0.0], 0.5 * fit.row_staggered, [0.0]])
    column_shift = np.concatenate([[0.0], 0.5 * fit.column_staggered, [0.0]])
    u = columns[None, :] + row_shift[:, None]
    v = rows[:, None] + column_shift[None, :]
    u0 = fit.column_positions[0] + 0.5 * float(fit.row_staggered[0])
    v0 = fit.row_positions[0] + 0.5 * float(fit.column_staggered[0])
    return np.asarray(np.stack([(u - u0).ravel(), (v - v0).ravel()], axis=-1) * fit.pitch)


def rectified_axes(regions: list[dict[str, Any]], camera: Camera, fit: GridFit) -> Array:
    """Return the semi-axes (M, 2), minor and major, of the drawn ellipses, rectified."""
    H, axes = rectifying_map(camera, fit), []
    for region in regions:
        if "ellipse" not in region:
            continue
        x, y, rx, ry, theta = region["ellipse"]
        s = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        outline = np.column_stack([rx * np.cos(s), ry * np.sin(s)]) @ turn.T + [x, y]
        (_, diameters, _) = cv2.fitEllipse(cv2.perspectiveTransform(outline[:, None], H).astype(np.float32))
        axes.append(sorted(d / 2.0 for d in diameters))
    return np.array(axes).reshape(-1, 2)
