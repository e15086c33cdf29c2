"""Teaches a panel: from photographs, or a bag of one panel, to a panel file that the node knows it by (`panel.file`).

Without --pitch-m lengths are in column pitches. One good view is enough; several from different sides make the places
more exact. Look the file over: a wrong label in it is a wrong button.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import cv2

from elevator_rectify.arguments import count, positive
from elevator_rectify.core import Camera, Config, Detection, GridFit, KnownPanel, ScaleConfig, detect_buttons, fit_panel
from elevator_rectify.core.find import with_labels
from elevator_rectify.core.known.file import panel_text
from elevator_rectify.core.known.teach import View, joined, taught, unteachable
from elevator_rectify.core.types import Image
from elevator_rectify.core.view.text_grid import LEGEND, text_grid
from elevator_rectify.progress import progress
from elevator_rectify.recordings.answering import paired_frames
from elevator_rectify.recordings.look import add_calibration, camera_of
from elevator_rectify.recordings.topics import InputTopics, find_topics
from elevator_rectify.ros.bag import BadBag, bag_topics, read_bag
from elevator_rectify.ros.config import NodeConfig, PairingConfig
from elevator_rectify.ros.inputs import inputs
from elevator_rectify.ros.pairing import Pairing
from elevator_rectify.ros.pictures import BadMessage


@dataclass(frozen=True)
class Taken:
    """One view before it is fitted."""

    name: str
    image: Image
    camera: Camera
    detections: list[Detection]


def pictures(paths: list[Path], options: argparse.Namespace) -> Iterator[Taken]:
    """Yield photographs with what our own detector finds. Raises ValueError for what is no picture."""
    for path in paths:
        image = cv2.imread(str(path), cv2.IMREAD_COLOR)
        if image is None:
            raise ValueError(f"{path} is no picture that OpenCV reads, and no bag")
        camera, source = camera_of(path, image, options)
        print(f"{path}: focal length {camera.focal_px:.0f} px, {source}")
        yield Taken(path.name, image, camera, detect_buttons(image))


def frames(path: Path, topics: InputTopics, most: int) -> Iterator[Taken]:
    """Yield `most` frames from all over a bag, with its own detections. Raises BadBag where it breaks off."""
    every = max(1, -(-_number(path, topics) // most))
    records = read_bag(path, {topics.image, topics.camera_info, topics.detections})
    for k, (frame, _) in enumerate(paired_frames(records, topics, Pairing(PairingConfig()))):
        if k % every:
            continue
        try:
            given = inputs(frame, NodeConfig())
        except BadMessage as error:
            print(f"frame {k}: {error}", file=sys.stderr)
            continue
        assert given.image is not None
        yield Taken(f"frame {k}", given.image, given.camera, given.detections)


def _number(path: Path, topics: InputTopics) -> int:
    return sum(n for name, (_, n) in bag_topics(path).items() if name == topics.detections)


def learnt(views: list[Taken], name: str, config: Config) -> tuple[KnownPanel, list[View]] | None:
    """Return the panel as the surest view shows it, and the fits to it of all that show it; None without any."""
    fits: list[tuple[Taken, GridFit]] = []
    for view in progress(views, "fit", len(views)):
        fit = fit_panel(view.detections, view.camera, config, image=view.image)
        fits.append((view, with_labels(fit, view.image, view.camera)))
        if why := unteachable(fit):
            print(f"{view.name}: left out: {why}")
    accepted = [(view, fit) for view, fit in fits if not unteachable(fit)]
    if not accepted:
        return None
    view, fit = max(accepted, key=lambda item: (item[1].inliers, item[1].confidence))
    known, others = taught(View(fit, view.camera), name), []
    for other, free in accepted:
        again = fit_panel(list(free.detections), other.camera, config, image=other.image, known=known)
        if again.ok:
            others.append(View(again, other.camera))
        else:
            print(f"{other.name}: left out: {again.reason}")
    print(f"the panel as {view.name} shows it, in {len(others)} view(s):\n\n{text_grid(fit.buttons)}\n\n{LEGEND}")
    return known, others


def read_views(options: argparse.Namespace) -> list[Taken]:
    """Return the views that the command line names. Raises ValueError and BadBag for what cannot be read."""
    if len(options.source) == 1 and options.source[0].is_dir():
        path = options.source[0]
        chosen = {stream: getattr(options, stream) for stream in ("image", "detections")}
        topics = find_topics(path, {"camera_info": None, **chosen})
        number = _number(path, topics)
        used = -(-number // max(1, -(-number // options.frames)))
        return list(progress(frames(path, topics, options.frames), "read", used))
    return list(pictures(options.source, options))


def add_source(parser: argparse.ArgumentParser) -> None:
    """Add what `read_views` takes."""
    parser.add_argument("source", type=Path, nargs="+", help="photographs of one panel, or the folder of a bag")
    parser.add_argument("--frames", type=count, default=20, help="frames of a bag that are used")
    add_calibration(parser)
    for stream in ("image", "detections"):
        parser.add_argument(f"--{stream}", help=f"topic of the {stream} in a bag; else found by its type")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="teach", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add_source(parser)
    parser.add_argument("-o", "--output", type=Path, default=Path("panel.yaml"), help="the panel file")
    parser.add_argument("--name", default="", help="the panel's name; default: the file's")
    parser.add_argument("--pitch-m", type=positive, help="metres between neighbouring buttons of a row: the scale")
    parser.add_argument("--pitch-std-m", type=positive, default=0.0005, help="its standard deviation")
    return parser


def main(arguments: list[str] | None = None) -> int:
    """Command line: 0 where the panel was taught, 1 where no view was accepted, 2 for wrong input."""
    options = _parser().parse_args(arguments)
    scale = ScaleConfig()
    if options.pitch_m is not None:
        scale = ScaleConfig(column_pitch_m=options.pitch_m, column_pitch_std_m=options.pitch_std_m)
    try:
        views = read_views(options)
        found = learnt(views, options.name or options.output.stem, replace(Config(), scale=scale))
    except (ValueError, BadBag) as error:
        print(f"teach: {error}", file=sys.stderr)
        return 2
    if found is None:
        print("teach: no view was accepted, nothing is written", file=sys.stderr)
        return 1
    known, seen = found
    if len(seen) > 1:
        known = joined(known, seen)
    options.output.parent.mkdir(parents=True, exist_ok=True)
    options.output.write_text(panel_text(known), encoding="utf-8")
    nameless = known.labels.count("")
    print(f"\n{options.output}: {len(known.labels)} buttons; places to {known.place_std:.2g} {_unit(known)}")
    if nameless:
        print(f"{nameless} of them have no label: write it into the file where the robot is to press them")
    print(f"the node uses it with: -p panel.file:={options.output.resolve()}")
    return 0


def _unit(known: KnownPanel) -> str:
    return "m" if known.metric else "column pitches"
