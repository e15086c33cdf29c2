"""Looks at pictures: finds the panel, prints it as text, writes it before and after; with --press says where to press.

The calibration is that of --camera-info, --focal-px or --focal-35mm, else of the picture's EXIF (where Pillow is
installed), else a guess: angles and distances are then rough.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import yaml

from elevator_rectify.arguments import positive
from elevator_rectify.core import (
    Button,
    Camera,
    Config,
    GridFit,
    ScaleConfig,
    TargetConfig,
    find_button,
    find_panel,
    lamps_of,
    rectify_image,
    with_lit,
)
from elevator_rectify.core.types import Image
from elevator_rectify.core.view.draw import draw_overlay, draw_rectified
from elevator_rectify.core.view.text_grid import LEGEND, text_grid
from elevator_rectify.recordings.make_bag import ASSUMED_FOCAL, photograph_camera

# Width of 35 mm film, and the EXIF tags of focal lengths.
_FILM_MM = 36.0
# A button in a photograph is known to this share of the pitch, or it is not told.
_PITCH_STD = 0.2
_EXIF_FOCAL_35MM, _EXIF_IFD = 0xA405, 0x8769


def camera_of(path: Path, image: Image, options: argparse.Namespace) -> tuple[Camera, str]:
    """Return the picture's camera, and where it is from. Raises ValueError for a camera_info that cannot be used."""
    height, width = image.shape[:2]
    longer = max(width, height)
    if options.camera_info is not None:
        return read_camera_info(options.camera_info, width, height), f"of {options.camera_info}"
    if options.focal_px is not None:
        return Camera.centred(width, height, options.focal_px), "given in pixels"
    film = options.focal_35mm or exif_focal_35mm(path)
    if film:
        source = "given" if options.focal_35mm else "EXIF"
        return Camera.centred(width, height, film / _FILM_MM * longer), f"{film:g} mm of 35 mm film ({source})"
    guess = f"a guess, {ASSUMED_FOCAL:g} of the longer side: give --focal-px or --camera-info for exact angles"
    return photograph_camera((width, height), None), guess


def exif_focal_35mm(path: Path) -> float:
    """Return the 35 mm equivalent focal length of the picture's EXIF in mm, 0 where it is not known."""
    try:
        from PIL import Image as Pillow
    except ImportError:
        return 0.0
    with Pillow.open(path) as picture:
        return float(picture.getexif().get_ifd(_EXIF_IFD).get(_EXIF_FOCAL_35MM) or 0.0)


def read_camera_info(path: Path, width: int, height: int) -> Camera:
    """Return the camera of a calibration YAML as camera_calibration writes it, for a picture of that size."""
    try:
        loaded: dict[str, Any] = yaml.safe_load(path.read_text())
        size = int(loaded["image_width"]), int(loaded["image_height"])
        K = np.array(loaded["camera_matrix"]["data"], dtype=float).reshape(3, 3)
        D = np.array(loaded["distortion_coefficients"]["data"], dtype=float)
        model = str(loaded.get("distortion_model", "plumb_bob"))
    except (OSError, KeyError, TypeError, ValueError, yaml.YAMLError) as error:
        raise ValueError(f"{path} is no calibration of camera_calibration's form: {error!r}") from error
    if size != (width, height):
        raise ValueError(f"{path} is of {size[0]} x {size[1]} pictures, this one is {width} x {height}")
    return Camera.from_matrix(K, width, height, D, model)


def look(path: Path, options: argparse.Namespace) -> int:
    """Look at one picture; 0 where a panel was found (and the button), 1 where not, 2 for what is no picture."""
    image = cv2.imread(str(path), cv2.IMREAD_COLOR)
    if image is None:
        print(f"look: {path} is no picture that OpenCV reads", file=sys.stderr)
        return 2
    camera, source = camera_of(path, image, options)
    config = in_pitches() if options.pitch_m is None else Config(scale=ScaleConfig(column_pitch_m=options.pitch_m))
    fit = find_panel(image, camera, config)
    print(f"{path}: focal length {camera.focal_px:.0f} px, {source}")
    lit = lamps_of(image, camera, fit, fit.buttons) if fit.ok else None
    buttons = with_lit(fit.buttons, fit, lit)
    print(described(fit, buttons))
    target = find_button(fit, options.press, config.target) if options.press else None
    button = target.button if target is not None else None
    write_pictures(path, image, camera, fit, options.output, button, buttons)
    if target is None:
        return 0 if fit.ok else 1
    if button is None:
        print(f"{options.press}: {target.status}: {target.reason}")
        return 1
    unit = "column pitches" if options.pitch_m is None else "m"
    at, normal = (", ".join(f"{v:.3f}" for v in vector) for vector in (button.point, button.normal))
    lamp = {"yes": ", its lamp is lit", "no": ", its lamp is dark"}.get(with_lit((button,), fit, lit)[0].lit, "")
    print(
        f"{options.press}: at ({at}) {unit} in the camera frame, its normal ({normal}), in the picture at "
        f"({button.image_px[0]:.0f}, {button.image_px[1]:.0f}); probability {button.label_probability:.3f}{lamp}"
    )
    return 0


def in_pitches() -> Config:
    """Return the settings for lengths in column pitches: where to press in a photograph needs no metres."""
    return Config(
        scale=ScaleConfig(column_pitch_m=1.0, column_pitch_std_m=0.0), target=TargetConfig(max_lateral_std_m=_PITCH_STD)
    )


def described(fit: GridFit, buttons: Sequence[Button]) -> str:
    """Return what was found, as text; buttons: the fit's, with their lamps."""
    if not fit.ok:
        return f"{len(fit.detections)} buttons found, no pose: {fit.status}: {fit.reason}"
    tilt = np.rad2deg(np.arccos(np.clip(fit.R_camera_panel[2, 2], -1.0, 1.0)))
    head = f"{len(fit.detections)} buttons found, seen from {tilt:.0f} degrees, confidence {fit.confidence:.2f}"
    return f"{head}\n\n{text_grid(buttons)}\n\n{LEGEND}"


def write_pictures(
    path: Path,
    image: Image,
    camera: Camera,
    fit: GridFit,
    folder: Path,
    target: Button | None,
    buttons: Sequence[Button],
) -> None:
    """Write the overlay, and the rectified view where there is a pose."""
    folder.mkdir(parents=True, exist_ok=True)
    centres = np.array([[d.x_px, d.y_px] for d in fit.detections]).reshape(-1, 2)
    overlay = folder / f"{path.stem}_overlay.jpg"
    cv2.imwrite(str(overlay), draw_overlay(image, centres, fit, target, buttons))
    written = [overlay]
    if fit.ok:
        view = rectify_image(image, camera, fit)
        for name, picture in (("rectified", view.image), ("read", draw_rectified(view, buttons, target))):
            written.append(folder / f"{path.stem}_{name}.jpg")
            cv2.imwrite(str(written[-1]), picture)
    print("pictures: " + ", ".join(str(p) for p in written))


def add_calibration(parser: argparse.ArgumentParser) -> None:
    """Add what `camera_of` takes."""
    parser.add_argument("--focal-px", type=positive, help="focal length in pixels")
    parser.add_argument("--focal-35mm", type=positive, help="focal length in mm as of 35 mm film")
    parser.add_argument("--camera-info", type=Path, help="calibration YAML, as camera_calibration writes it")


def main(arguments: list[str] | None = None) -> int:
    """Command line: 0 where every picture shows a panel (and the button), 1 where one does not, 2 for wrong input."""
    parser = argparse.ArgumentParser(
        prog="look", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("pictures", type=Path, nargs="+", help="photographs of panels")
    parser.add_argument("--press", default="", metavar="LABEL", help="say where this button is")
    add_calibration(parser)
    parser.add_argument("--pitch-m", type=positive, help="metres between neighbouring buttons of a row: the scale")
    parser.add_argument("--output", type=Path, default=Path("out/look"), help="folder for the pictures")
    options = parser.parse_args(arguments)
    try:
        return max(look(path, options) for path in options.pictures)
    except ValueError as error:
        print(f"look: {error}", file=sys.stderr)
        return 2
