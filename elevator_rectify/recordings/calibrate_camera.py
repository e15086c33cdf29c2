"""Calibrates a camera by a panel: from photographs, or a bag, that show one panel from several sides.

The views should be tilted in different directions, by 20 to 50 degrees, and fill the picture. The given calibration
(camera_info of the bag, or --focal-px and the like) is where the estimate starts: it may be off by a tenth. Written is
a camera_info YAML, as camera_calibration writes it.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

import cv2
import numpy as np
import yaml

from elevator_rectify.core import Camera, Config
from elevator_rectify.core.self_calibration import FEWEST_VIEWS, CameraEstimate, calibrated, shape_of_panel, sighting_of
from elevator_rectify.core.types import Image
from elevator_rectify.recordings.teach import Taken, add_source, learnt, read_views
from elevator_rectify.ros.bag import BadBag

# An estimate of the focal length that is no surer than this is not written.
_MOST_STD = 0.02
# Residuals are drawn so many times as long.
_DRAWN_TIMES = 40.0


def estimated(views: list[Taken], pixel_ratio: bool) -> CameraEstimate | None:
    """Return the camera by all views that show the panel; None where there are too few. Raises ValueError for pictures
    of different cameras."""
    cameras = {(v.camera.matrix.tobytes(), v.camera.width, v.camera.height) for v in views}
    if len(cameras) > 1:
        raise ValueError(f"the pictures are of {len(cameras)} cameras or sizes, one is needed")
    found = learnt(views, "panel", Config())
    if found is None:
        return None
    fits = [view.fit for view in found[1]]
    sightings = [s for s in map(sighting_of, fits) if s is not None]
    if len(sightings) < FEWEST_VIEWS:
        print(f"{len(sightings)} views show enough of the buttons, {FEWEST_VIEWS} needed")
        return None
    return calibrated(sightings, shape_of_panel(fits[0]), views[0].camera, pixel_ratio)


def described(estimate: CameraEstimate) -> str:
    """Return the finding as a table."""
    rows = [("focal length over the given one", estimate.focal_share, estimate.focal_std)]
    if np.isfinite(estimate.ratio_std):
        rows.append(("fy / fx over the given one", estimate.ratio, estimate.ratio_std))
    rows.append(("first coefficient of distortion, change", estimate.k1, estimate.k1_std))
    lines = [f"{name:<42}{value:>9.4f} +- {std:.4f}" for name, value, std in rows]
    before, after = estimate.rms_px
    lines.append(f"{'buttons from where they should be, rms px':<42}{before:>9.3f} before, {after:.3f} after")
    return "\n".join([f"by {estimate.views} views", *lines])


def camera_yaml(camera: Camera, name: str) -> str:
    """Return a calibration in the form of camera_calibration and camera_info_manager."""

    def matrix(values: list[float], rows: int, columns: int) -> dict[str, object]:
        return {"rows": rows, "cols": columns, "data": [float(f"{v:.8g}") for v in values]}

    projection = np.column_stack([camera.matrix, np.zeros(3)])
    return str(
        yaml.safe_dump(
            {
                "image_width": camera.width,
                "image_height": camera.height,
                "camera_name": name,
                "camera_matrix": matrix(camera.matrix.ravel().tolist(), 3, 3),
                "distortion_model": camera.model,
                "distortion_coefficients": matrix(camera.distortion.tolist(), 1, len(camera.distortion)),
                "rectification_matrix": matrix(np.eye(3).ravel().tolist(), 3, 3),
                "projection_matrix": matrix(projection.ravel().tolist(), 3, 4),
            },
            sort_keys=False,
            default_flow_style=None,
        )
    )


def residual_picture(estimate: CameraEstimate) -> Image:
    """Return a picture of where the buttons of all views are, and by how much they are off, drawn longer."""
    canvas = np.full((estimate.camera.height, estimate.camera.width, 3), 255, np.uint8)
    for x, y, dx, dy in estimate.residual_px:
        ends = [(round(float(a)), round(float(b))) for a, b in ((x, y), (x + _DRAWN_TIMES * dx, y + _DRAWN_TIMES * dy))]
        cv2.arrowedLine(canvas, *ends, (40, 40, 200), 1, cv2.LINE_AA, tipLength=0.2)
        cv2.circle(canvas, ends[0], 2, (60, 60, 60), -1, cv2.LINE_AA)
    cv2.putText(canvas, f"x {_DRAWN_TIMES:g}", (8, 20), cv2.FONT_HERSHEY_SIMPLEX, 0.5, (0, 0, 0), 1, cv2.LINE_AA)
    return canvas


def main(arguments: list[str] | None = None) -> int:
    """Command line: 0 where a calibration was written, 1 where the views do not tell, 2 for wrong input."""
    parser = argparse.ArgumentParser(
        prog="calibrate_camera", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_source(parser)
    parser.add_argument("-o", "--output", type=Path, default=Path("camera.yaml"), help="the calibration")
    parser.add_argument("--pixel-ratio", action="store_true", help="estimate fy / fx, too: pixels that are not square")
    parser.add_argument("--picture", type=Path, help="picture of the residuals, .png")
    options = parser.parse_args(arguments)
    try:
        estimate = estimated(read_views(options), options.pixel_ratio)
    except (ValueError, BadBag) as error:
        print(f"calibrate_camera: {error}", file=sys.stderr)
        return 2
    if estimate is None:
        print("calibrate_camera: too few views of one panel, nothing is written", file=sys.stderr)
        return 1
    print("\n" + described(estimate))
    if options.picture is not None:
        cv2.imwrite(str(options.picture), residual_picture(estimate))
    if not estimate.focal_std < _MOST_STD:
        print("calibrate_camera: the views tell too little: take some from other sides", file=sys.stderr)
        return 1
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(camera_yaml(estimate.camera, options.output.stem), encoding="utf-8")
    print(f"\n{options.output}: fx {estimate.camera.matrix[0, 0]:.2f}, fy {estimate.camera.matrix[1, 1]:.2f} px")
    return 0
