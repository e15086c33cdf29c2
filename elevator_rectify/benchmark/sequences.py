"""Camera paths past a panel: what the node would publish with tracking, beside every frame fitted alone."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.benchmark.figures import Figures
from elevator_rectify.benchmark.parallel import parallel
from elevator_rectify.core import Config, fit_panel
from elevator_rectify.core.geometry.rotations import rotation, rotation_angle_rad
from elevator_rectify.core.reading.grid_fit import GridFit
from elevator_rectify.core.track import Track, recent, smoothed
from elevator_rectify.recordings.evaluate import cells_right
from elevator_rectify.render.levels import LEVELS, random_panel
from elevator_rectify.render.panel import Panel
from elevator_rectify.render.scene import DetectorModel, Scene, Viewpoint, camera_pose, detected, paper_camera

_FRAMES, _PERIOD_S = 60, 1.0 / 15.0
# Of what is accepted: a rotation further off, fewer right cells or a button further off sideways is wrong.
_WRONG_DEG, _RIGHT_CELLS, _WRONG_PITCH = 6.0, 0.95, 0.35
_FEWEST = 6
_LEVEL = LEVELS["medium"]
_CONFIG = Config()


@dataclass(frozen=True)
class Moment:
    """Where the camera is at one frame: offset of the panel in the image, tilt, and what the detector misses."""

    seconds: float
    offset: tuple[float, float] = (0.0, 0.0)
    tilt_rad: float = 0.35
    fill: float = 0.7
    sigma_px: float = 1.2
    missed: float = 0.05
    false: float = 0.03
    other_panel: bool = False
    # The detections in this share of the picture, from the left, are hidden.
    hidden: float = 0.0


Path = Callable[[np.random.Generator], Iterator[Moment]]


def _steady(rng: np.random.Generator, speed: float = 1.0) -> Iterator[Moment]:
    """Sway as a robot that stops before the panel."""
    phase, width = rng.uniform(0, 2 * np.pi, 4), rng.uniform(0.03, 0.08, 2)
    for k in range(_FRAMES):
        s = k * _PERIOD_S
        x, y = width * np.sin(speed * 1.3 * s + phase[:2])
        tilt = 0.35 + 0.2 * np.sin(speed * 0.7 * s + phase[2])
        yield Moment(s, (float(x), float(y)), float(tilt), 0.65 + 0.1 * float(np.sin(speed * 0.5 * s + phase[3])))


def _fast(rng: np.random.Generator) -> Iterator[Moment]:
    yield from _steady(rng, 6.0)


def _changing_noise(rng: np.random.Generator) -> Iterator[Moment]:
    for m in _steady(rng):
        yield replace(m, sigma_px=float(rng.uniform(0.7, 3.0)), missed=float(rng.uniform(0, 0.35)), false=0.1)


def _bad_start(rng: np.random.Generator) -> Iterator[Moment]:
    for k, m in enumerate(_steady(rng)):
        yield replace(m, sigma_px=3.0, missed=0.4, false=0.2) if k < 10 else m


def _comes_into_view(rng: np.random.Generator) -> Iterator[Moment]:
    for k, m in enumerate(_steady(rng)):
        yield replace(m, offset=(m.offset[0], 0.6 * max(0.0, 1.0 - k / 40.0)), fill=0.85)


def _leaves_and_returns(rng: np.random.Generator) -> Iterator[Moment]:
    for k, m in enumerate(_steady(rng)):
        yield replace(m, offset=(0.85 * float(np.sin(np.pi * k / _FRAMES)), m.offset[1]))


def _another_panel(rng: np.random.Generator) -> Iterator[Moment]:
    for k, m in enumerate(_steady(rng)):
        yield replace(m, other_panel=k >= 30)


def _person_in_front(rng: np.random.Generator) -> Iterator[Moment]:
    for k, m in enumerate(_steady(rng)):
        yield replace(m, hidden=0.5 if 20 <= k < 40 else 0.0)


def _dropped_frames(rng: np.random.Generator) -> Iterator[Moment]:
    later = 0.0
    for m in _steady(rng):
        later += float(rng.uniform(0.3, 3.0)) if rng.random() < 0.15 else 0.0
        yield replace(m, seconds=m.seconds + later)


def _jump(rng: np.random.Generator) -> Iterator[Moment]:
    for k, m in enumerate(_steady(rng)):
        yield replace(m, offset=(m.offset[0] - 0.15, 0.1), tilt_rad=m.tilt_rad - 0.5) if k >= 30 else m


def _clock_goes_back(rng: np.random.Generator) -> Iterator[Moment]:
    for k, m in enumerate(_steady(rng)):
        yield replace(m, seconds=m.seconds + (1000.0 if k < 30 else 0.0))


KINDS: dict[str, Path] = {
    "steady": _steady,
    "fast": _fast,
    "changing noise": _changing_noise,
    "bad start": _bad_start,
    "rows come into view": _comes_into_view,
    "leaves and returns": _leaves_and_returns,
    "another panel": _another_panel,
    "person in front": _person_in_front,
    "dropped frames": _dropped_frames,
    "jump": _jump,
    "clock goes back": _clock_goes_back,
}


@dataclass(frozen=True)
class Judged:
    """One frame's answer: accepted, wrong, and how far its buttons are off sideways at most, in pitches."""

    accepted: bool
    wrong: bool
    lateral_pitch: float


def scenes(kind: str, seed: int, number: int) -> Iterator[tuple[int, Scene]]:
    """Yield stamps and scenes of one path; the same arguments give the same."""
    rng = np.random.default_rng([seed, number, len(kind)])
    camera, panel = paper_camera(), random_panel(_LEVEL, rng)
    other = _same_size(panel, rng)
    axis, roll = float(rng.uniform(0, 2 * np.pi)), float(rng.normal(0, 0.03))
    for m in KINDS[kind](rng):
        shown = other if m.other_panel else panel
        R, t = camera_pose(shown, camera, Viewpoint(m.tilt_rad, axis, roll, m.fill))
        # The offset turns the camera aside: the panel keeps its distance and may leave the picture.
        R_aside = rotation(np.array([-m.offset[1], m.offset[0], 0.0]))
        model = DetectorModel(m.sigma_px, m.missed, m.false)
        scene = detected(shown, camera, R_aside @ R, R_aside @ t, model, rng)
        yield round(1e9 * (m.seconds + 1.0)), _hidden(scene, m.hidden)


def _same_size(panel: Panel, rng: np.random.Generator) -> Panel:
    """Return another panel of as many rows and columns, if one is drawn soon."""
    for _ in range(200):
        other = random_panel(_LEVEL, rng)
        if len(other.buttons) == len(panel.buttons) and (other.cells.max(axis=0) == panel.cells.max(axis=0)).all():
            return other
    return panel


def _hidden(scene: Scene, share: float) -> Scene:
    keep = np.array([d.x_px >= share * scene.camera.width for d in scene.detections], dtype=bool)
    kept = tuple(d for d, k in zip(scene.detections, keep, strict=True) if k)
    return replace(scene, detections=kept, button=scene.button[keep])


def judged_frame(fit: GridFit, scene: Scene) -> Judged:
    """Compare a frame's answer with the truth."""
    if not fit.ok:
        return Judged(False, False, float("nan"))
    real = scene.button >= 0
    button = scene.button[real]
    right = cells_right(fit.cells[real], scene.panel.cells[button], scene.panel.blocks[button])
    error_deg = np.rad2deg(rotation_angle_rad(fit.R_camera_panel.T @ scene.R_camera_panel))
    lateral = _lateral_pitch(fit, scene)
    return Judged(True, bool(error_deg > _WRONG_DEG or right < _RIGHT_CELLS or lateral > _WRONG_PITCH), lateral)


def _lateral_pitch(fit: GridFit, scene: Scene) -> float:
    """Return the largest distance of a detected button's cell from the true button in the picture, in pitches there."""
    on = (fit.cells[:, 0] >= 0) & (scene.button >= 0)
    if not on.any():
        return float("inf")
    found = fit.grid_px[fit.cells[on, 0], fit.cells[on, 1]]
    off = np.linalg.norm(found - scene.pixels[scene.button[on]], axis=1)
    steps = np.linalg.norm(np.diff(fit.grid_px, axis=1), axis=-1)
    return float(off.max() / np.median(steps))


def run_sequence(task: tuple[str, int, int]) -> tuple[list[Judged], list[Judged]]:
    """Return each frame's answer, fitted alone and tracked: (kind, seed, number)."""
    alone, tracked = [], []
    track: Track | None = None
    last_ns = 0
    for stamp_ns, scene in scenes(*task):
        if len(scene.detections) < _FEWEST:
            continue
        alone.append(judged_frame(fit_panel(scene.detections, scene.camera, _CONFIG), scene))
        # The node forgets when the clock goes back (`Pairing.jumps`).
        track = track if stamp_ns > last_ns else None
        last_ns = stamp_ns
        previous = recent(track, stamp_ns, _CONFIG.smoothing)
        fit = fit_panel(scene.detections, scene.camera, _CONFIG, previous)
        track, fit = smoothed(track, fit, scene.camera, stamp_ns, _CONFIG.smoothing)
        tracked.append(judged_frame(fit, scene))
    return alone, tracked


HEADER = (
    f"{'camera paths':<22}{'frames':>7} | {'alone: accepted':>15}{'wrong':>7}{'p95 pitch':>11} | "
    f"{'tracked: accepted':>17}{'wrong':>7}{'p95 pitch':>11}"
)


def sequence_table(number: int, seed: int, figures: Figures, kinds: Iterable[str] = KINDS) -> str:
    """Return the table of `number` paths a kind."""
    lines = [HEADER]
    for kind in kinds:
        results = parallel(run_sequence, [(kind, seed, k) for k in range(number)], f"paths, {kind}")
        parts = []
        for which, (name, width) in enumerate((("alone", 15), ("tracked", 17))):
            frames = [f for result in results for f in result[which]]
            figures.rate(f"camera paths, {kind}, {name} accepted+", [f.accepted for f in frames])
            figures.rate(f"camera paths, {kind}, {name} wrong-", [f.wrong for f in frames])
            parts.append(_half_line(frames, width))
        lines.append(f"{kind:<22}{sum(len(r[0]) for r in results):>7} | " + " | ".join(parts))
    return "\n".join(lines)


def _half_line(frames: list[Judged], width: int) -> str:
    lateral = [f.lateral_pitch for f in frames if f.accepted]
    p95 = np.percentile(lateral, 95) if lateral else np.nan
    wrong = sum(f.wrong for f in frames)
    return f"{len(lateral) / max(1, len(frames)):>{width}.3f}{wrong:>7}{p95:>11.3f}"
