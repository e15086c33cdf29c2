"""Watch a button while it is pressed: frames before are the reference, frames after tell whether its lamp went on."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from elevator_rectify.core.geometry.same_places import same_places
from elevator_rectify.core.lamps.change import features, lamp_log_odds, lit_share
from elevator_rectify.core.lamps.lit import lit_log_odds
from elevator_rectify.core.lamps.patches import Patches
from elevator_rectify.core.types import Array, IntArray

# So many frames before the press are kept, and so many after it judged: the last ones that show the button.
REFERENCES, JUDGED = 3, 5
# Of these so many must be sure that the lamp went on, by log odds, and their mean too. Together with so many times the
# mean log odds that it is lit, by each of them alone, that is more than the last: a finger changes as much, but looks
# otherwise.
_AGREEING, _LIT, _LIT_WEIGHT, _CHANGED_AND_LIT = 3, 3.0, 1.5, 9.3
# What counts as said by a frame that says nothing alone: a grey one, or one with too few buttons.
_UNKNOWN_LIT = 2.0
# It surely did not go on below this mean.
_NOT_LIT = -2.0
# Of lamps that went on so many change nothing that is seen (white on white, a small dot): against that no frame helps.
_INVISIBLE = 0.08
# A lamp that is surely lit in so many of these frames, and surely dark in as many, blinks.
_BLINKS = 2
# So many frames without the panel in the end: it was left, or a door opened.
_LEFT = 5
# Odds are those of pictures that were painted over: reality is trusted with no more.
_LARGEST = 7.0
# What is said of a frame that shows buttons, but not these.
ANOTHER = "another panel is seen"
# What is said where so large a share of the panel's buttons look as if their lamps went on.
ALL_LIT, _ALL_LIT_SHARE = "the lamps of most buttons went on", 0.6


@dataclass(frozen=True)
class Sight:
    """What one frame says of the button: the log odds that its lamp went on, or why nothing can be said.

    lit: those that it is lit, by this frame alone, where it may have gone on; panel: whether its panel is seen.
    """

    log_odds: float = float("nan")
    lit: float = float("nan")
    problem: str = ""
    panel: bool = True

    @property
    def seen(self) -> bool:
        """Tell whether it says anything."""
        return bool(np.isfinite(self.log_odds))

    @property
    def probability(self) -> float:
        """Return that of the lamp having gone on, NaN where nothing can be said."""
        return _probability(self.log_odds)


@dataclass(frozen=True)
class Watch:
    """A button that is watched: how its panel looked before, and what the frames since then say, the last ones."""

    label: str
    references: tuple[Patches, ...] = ()
    sights: tuple[Sight, ...] = ()
    frames: int = 0

    @property
    def ready(self) -> bool:
        """Tell whether it is known what the button looks like before it is pressed."""
        return len(self.references) >= REFERENCES

    @property
    def seen(self) -> int:
        """Return the number of frames since then that show the button."""
        return sum(sight.seen for sight in self.sights)


@dataclass(frozen=True)
class Pressed:
    """The answer: status, its probability where it was seen, and the reason in words."""

    status: str
    reason: str = ""
    probability: float = 0.0

    @property
    def succeeds(self) -> bool:
        """Tell whether the press is confirmed."""
        return self.status == "confirmed"


def watched(watch: Watch, now: Patches | None, problem: str = "") -> Watch:
    """Return the watch after one more frame; now: its observed buttons, None where there is no panel, with the reason.

    The first frames that show the button are the reference, where there is none yet.
    """
    watch = replace(watch, frames=watch.frames + 1)
    if not watch.ready:
        known = now is not None and watch.label in now.labels
        return replace(watch, references=(*watch.references, now)) if known and now is not None else watch
    sight = Sight(problem=problem or "no panel", panel=False) if now is None else _sight(watch, now)
    return replace(watch, sights=(*watch.sights, sight)[-100:])


def _sight(watch: Watch, now: Patches) -> Sight:
    """Compare the frame with every frame before the press; the least of what they say counts."""
    found = [changed(before, now, watch.label) for before in watch.references]
    known = [lamp_log_odds(x) for x in found if not isinstance(x, str)]
    if not known:
        problem = next(x for x in found if isinstance(x, str))
        return Sight(problem=problem, panel=problem != ANOTHER)
    odds = float(np.clip(min(known), -_LARGEST, _LARGEST))
    lit = float(lit_log_odds(now)[now.labels.index(watch.label)]) if odds > _LIT else float("nan")
    return Sight(odds, lit)


def changed(before: Patches, now: Patches, label: str) -> Array | str:
    """Return the features of what changed of the button of a label, or why nothing can be said."""
    pairs = same_places(before, now)
    of_it = [k for k, (i, _) in enumerate(pairs) if before.labels[i] == label]
    if before.labels.count(label) > 1:
        return f"{label} is read on {before.labels.count(label)} buttons"
    if len(of_it) != 1:
        return f"{label} is hidden" if len(pairs) else ANOTHER
    was, then = _chosen(before, pairs[:, 0]), _chosen(now, pairs[:, 1])
    found = features(was, then, of_it[0])
    if found is None:
        return "too little is seen around it"
    return ALL_LIT if lit_share(was, then) >= _ALL_LIT_SHARE else found


def _chosen(patches: Patches, which: IntArray) -> Patches:
    labels = tuple(patches.labels[k] for k in which)
    return Patches(patches.colour[which], patches.places[which], labels, patches.side_px[which], patches.whole[which])


def confirmed(watch: Watch) -> Pressed | None:
    """Return the answer that can be given at once, None where more frames are needed."""
    last = _last(watch)
    mean, lit = _mean_odds(last), [sight.lit for sight in last if sight.log_odds > _LIT]
    if len(lit) < _AGREEING or last[-1].log_odds <= 0 or mean <= _LIT:
        return None
    alone = float(np.mean(np.nan_to_num(lit, nan=_UNKNOWN_LIT)))
    if mean + _LIT_WEIGHT * alone <= _CHANGED_AND_LIT:
        return None
    return Pressed("confirmed", f"the lamp of {watch.label} went on", _probability(mean))


def ended(watch: Watch) -> Pressed:
    """Return the answer when the time is over."""
    if not watch.frames:
        return Pressed("no_frames", "no frame was answered in time: no image, or no detections")
    if not watch.ready:
        return Pressed("unseen", f"{watch.label} was not seen in {REFERENCES} frames before the press")
    # Only now: an arm before the camera hides the panel for a while, too.
    if len(watch.sights) >= _LEFT and not any(sight.panel for sight in watch.sights[-_LEFT:]):
        return Pressed("panel_left", f"the last {_LEFT} frames do not show the panel: {watch.sights[-1].problem}")
    last = _last(watch)
    if sum(sight.problem == ALL_LIT for sight in watch.sights[-JUDGED:]) >= _AGREEING:
        return Pressed("all_lit", f"{ALL_LIT}, as in a test: they tell nothing of {watch.label}")
    if len(last) < _AGREEING:
        why = watch.sights[-1].problem if watch.sights else ""
        return Pressed("unseen", f"{len(last)} frames show {watch.label} since{': ' + why if why else ''}")
    mean, lit = _mean_odds(last), sum(sight.log_odds > _LIT for sight in last)
    if min(lit, sum(sight.log_odds < _NOT_LIT for sight in last)) >= _BLINKS:
        reason = f"{lit} of {len(last)} frames show the lamp of {watch.label} lit, others dark"
        return Pressed("blinks", reason, _probability(mean))
    if mean < _NOT_LIT:
        probability = float(1.0 / (1.0 + np.exp(mean) + _INVISIBLE))
        return Pressed("not_lit", f"nothing of {watch.label} changed: not lit, or lit before", probability)
    return Pressed("unseen", f"what is seen of {watch.label} tells neither", _probability(mean))


def _last(watch: Watch) -> list[Sight]:
    return [sight for sight in watch.sights if sight.seen][-JUDGED:]


def _mean_odds(sights: list[Sight]) -> float:
    return float(np.mean([sight.log_odds for sight in sights])) if sights else float("nan")


def _probability(log_odds: float) -> float:
    return float(1.0 / (1.0 + np.exp(-log_odds)))


def reference_of(seen: Sequence[Patches]) -> tuple[Patches, ...]:
    """Return the frames that serve as the reference: the last ones, repeated where there are fewer than are needed."""
    return tuple(seen[-REFERENCES:]) + tuple(seen[-1:]) * max(0, REFERENCES - len(seen)) if seen else ()
