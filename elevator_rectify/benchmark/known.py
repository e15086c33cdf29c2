"""Taught panels: real ones are taught from one picture, then sought in other views and in other panels' pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify.benchmark.end_to_end import CONFIG, first_accepted, judgeable, true_detections
from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.benchmark.turned_reading import turned
from elevator_rectify.core import Camera, Detection, GridFit, KnownPanel, fit_panel
from elevator_rectify.core.known.teach import View, taught
from elevator_rectify.core.types import Image, IntArray
from elevator_rectify.train.labelled import read_labelled

# Views of a taught panel: turned by so many degrees, of which this share is seen of its width and height.
VIEWS = {
    "whole, 0 to 25 degrees": ((-25.0, 25.0), (1.0, 1.0)),
    "whole, 40 to 55 degrees": ((40.0, 55.0), (1.0, 1.0)),
    "part of it": ((-30.0, 30.0), (0.4, 0.65)),
}
OTHERS = "another panel"
_OTHERS, _FEWEST_SEEN, _SEED = 3, 4, 3001
# The detector's errors: a box's centre over its size, shares of missed and false boxes.
_NOISE, _MISSED, _FALSE = 0.04, 0.1, 0.05


@dataclass(frozen=True)
class Look:
    """One view: whether the known panel and the free fit were accepted, and whether a button was taken for another."""

    kind: str
    read: bool
    known: str
    free: bool
    wrong: bool


@dataclass(frozen=True)
class _Seen:
    """A picture with its camera, its boxes, and which true button (N,) each one is, -1 for none."""

    image: Image
    camera: Camera
    detections: list[Detection]
    button: IntArray


def run_panel(task: tuple[str, str, tuple[str, ...], int]) -> list[Look]:
    """Teach one panel and seek it: (folder, name, other pictures' names, seed); nothing where it is refused."""
    folder, name, others, seed = task
    (picture,) = read_labelled(Path(folder), names=(name,))
    truth, rng = true_detections(picture), np.random.default_rng([seed, int(name)])
    accepted = first_accepted(picture, truth)
    if accepted is None:
        return []
    fit, camera = accepted
    known, at_place = _taught(fit, camera, name)
    looks = [
        _look(kind, _spoilt(_view(picture.image, truth, camera, fit, kind, rng), rng), known, at_place, read)
        for kind in VIEWS
        for read in (True, False)
    ]
    return looks + [_sought(Path(folder), other, camera, known, read) for other in others for read in (True, False)]


def _taught(fit: GridFit, camera: Camera, name: str) -> tuple[KnownPanel, IntArray]:
    """Return the panel, and which true box each of its buttons is."""
    known = taught(View(fit, camera), name)
    buttons = {(b.row, b.column, b.label if b.row < 0 else ""): b.detection for b in fit.buttons}
    keys = [
        (row, column, label if row < 0 else "")
        for (row, column), label in zip(known.cells.tolist(), known.labels, strict=True)
    ]
    return known, np.array([buttons.get(key, -1) for key in keys], dtype=np.int64)


def _view(
    image: Image, truth: list[Detection], camera: Camera, fit: GridFit, kind: str, rng: np.random.Generator
) -> _Seen:
    """Return another view: the panel turned about its upright middle, and cut to a part of the picture."""
    (least, most), shares = VIEWS[kind]
    angle = float(rng.uniform(least, most)) * (1.0 if least < 0 or rng.random() < 0.5 else -1.0)
    seen = turned(image, [replace(d, label="") for d in truth], camera, fit, angle)
    share = rng.uniform(*shares, 2)
    size = (share * [camera.width, camera.height]).astype(int)
    x, y = (int(v) for v in rng.uniform(0.0, 1.0, 2) * ([camera.width, camera.height] - size))
    K = camera.matrix - np.array([[0, 0, x], [0, 0, y], [0, 0, 0]])
    part = np.ascontiguousarray(seen.image[y : y + size[1], x : x + size[0]])
    moved = [replace(d, x_px=d.x_px - x, y_px=d.y_px - y) for d in seen.detections]
    inside = [k for k, d in enumerate(moved) if 0 <= d.x_px < size[0] and 0 <= d.y_px < size[1]]
    return _Seen(
        part, Camera.from_matrix(K, int(size[0]), int(size[1])), [moved[k] for k in inside], np.array(inside, dtype=int)
    )


def _spoilt(seen: _Seen, rng: np.random.Generator) -> _Seen:
    """Return the view as a detector sees it."""
    kept = np.flatnonzero(rng.random(len(seen.detections)) >= _MISSED)
    found = []
    for k in kept:
        d = seen.detections[k]
        off = rng.normal(0.0, _NOISE, 2) * np.array([d.width_px, d.height_px])
        found.append(replace(d, x_px=d.x_px + float(off[0]), y_px=d.y_px + float(off[1])))
    false = rng.binomial(len(kept), _FALSE)
    for _ in range(false):
        x, y = rng.uniform(0, 1, 2) * [seen.camera.width, seen.camera.height]
        found.append(replace(found[0], x_px=float(x), y_px=float(y)))
    return replace(seen, detections=found, button=np.concatenate([seen.button[kept], np.full(false, -1)]))


def _look(kind: str, seen: _Seen, known: KnownPanel, at_place: IntArray, read: bool) -> Look:
    if len(seen.detections) < _FEWEST_SEEN:
        return Look("", read, "", False, False)
    image = seen.image if read else None
    free = fit_panel(seen.detections, seen.camera, CONFIG, image=image).ok
    fit = fit_panel(seen.detections, seen.camera, CONFIG, image=image, known=known)
    on = (fit.matched >= 0) & (seen.button >= 0) if fit.ok else np.zeros(len(seen.button), dtype=bool)
    taken = at_place[fit.matched[on]] if fit.ok else np.zeros(0)
    wrong = bool(((taken >= 0) & (taken != seen.button[on])).any())
    return Look(kind, read, fit.status, free, wrong)


def _sought(folder: Path, other: str, camera: Camera, known: KnownPanel, read: bool) -> Look:
    """Seek the panel in another one's picture, with a camera of the same aspect."""
    (picture,) = read_labelled(folder, names=(other,))
    boxes = [replace(d, label="") for d in true_detections(picture)]
    image = picture.image
    if image.shape[:2] != (camera.height, camera.width):
        image = cv2.resize(image, (camera.width, camera.height))
    fit = fit_panel(boxes, camera, CONFIG, image=image if read else None, known=known)
    return Look(OTHERS, read, fit.status, False, fit.ok)


def known_table(folder: Path, figures: Figures, seed: int = _SEED) -> str:
    """Return the table over the validation part's panels that are accepted as they are."""
    names = [p.name for p in read_labelled(folder, validation=True) if judgeable(p)]
    rng = np.random.default_rng(seed)
    tasks = []
    for name in names:
        others = [str(o) for o in rng.permutation([n for n in names if n != name])[:_OTHERS]]
        tasks.append((str(folder), name, tuple(others), seed))
    looks = [look for several in parallel(run_panel, tasks, "taught panels") for look in several]
    lines = [
        "real panels, taught from one picture, sought in views of it that four detections and more are left of",
        f"{'':<26}{'labels':<8}{'views':>6}{'free fit':>9}{'taught':>8}{'wrong':>7}  refused as",
    ]
    for kind in (*VIEWS, OTHERS):
        for read in (True, False):
            lines.append(_line(kind, read, [x for x in looks if (x.kind, x.read) == (kind, read)], figures))
    return "\n".join(lines)


def _line(kind: str, read: bool, looks: list[Look], figures: Figures) -> str:
    accepted = [look.known == "ok" for look in looks]
    wrong = sum(look.wrong for look in looks)
    label = "read" if read else "none"
    if kind == OTHERS:
        figures.rate(f"taught panel, labels {label}, sought where it is not, accepted-", accepted)
    else:
        figures.rate(f"taught panel, {kind}, labels {label}, accepted+", accepted)
    statuses = sorted({look.known for look in looks} - {"ok"})
    refused = ", ".join(f"{status} {sum(look.known == status for look in looks)}" for status in statuses)
    free = f"{np.mean([look.free for look in looks]):>9.3f}" if kind != OTHERS else f"{'':>9}"
    return f"{kind:<26}{label:<8}{len(looks):>6}{free}{np.mean(accepted):>8.3f}{wrong:>7}  {refused}"
