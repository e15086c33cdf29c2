"""The page for people that replay writes: complete in itself, and what a browser makes of it."""

from __future__ import annotations

import re
import shutil
import subprocess
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from elevator_rectify.recordings.page import page, read_grids
from elevator_rectify.recordings.report import Outcome, Pictures

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
VIEW = np.full((480, 640, 3), 90, np.uint8)
REASON = "no_lattice: <none> explains & fits"


def outcome(k: int, ok: bool) -> Outcome:
    pose = (np.eye(3), np.zeros(3)) if ok else None
    values = {"confidence": f"{0.9 if ok else 0.2}"}
    stamp = 1_577_000_000_000_000_000 + k * 500_000_000
    return Outcome(stamp, name=f"<b>{k}.jpg", values=values, verdict="ok" if ok else REASON, pose=pose)


ROWS = [outcome(k, k % 3 > 0) for k in range(7)]
SHOWN = {row.stamp: Pictures(VIEW, VIEW if row.ok else None) for row in ROWS}
GRIDS = {ROWS[1].stamp: " 3 4\n 1 2"}
PAGE = page(
    "a <bag>", "a table", {"joint": ROWS}, {"joint": SHOWN}, {"joint": GRIDS}, {"scale.column_pitch_m": "0.045"}
)


class Seen(HTMLParser):
    """Collects a page's elements and its text."""

    def __init__(self) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str]]] = []
        self.text = ""

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}))

    def handle_data(self, data: str) -> None:
        self.text += data

    def all(self, tag: str) -> list[dict[str, str]]:
        return [attributes for name, attributes in self.elements if name == tag]


@pytest.fixture
def seen() -> Seen:
    parsed = Seen()
    parsed.feed(PAGE)
    return parsed


def test_the_page_needs_no_other_file(seen: Seen) -> None:
    assert not seen.all("link") and not seen.all("script")
    pictures = seen.all("img")
    # Three refused images with their input, four accepted ones with both.
    assert len(pictures) == 3 + 2 * 4
    assert all(p["src"].startswith("data:image/jpeg;base64,") for p in pictures)
    assert "http" not in re.sub(r"data:[^']*", "", PAGE)


def test_it_says_what_was_accepted_and_why_the_others_were_not(seen: Seen) -> None:
    assert "joint: 4 of 7 images accepted" in seen.text
    assert f"3 x {REASON}" in seen.text and "<none>" not in PAGE and not seen.all("b")
    circles = seen.all("circle")
    assert [c["fill"] != "none" for c in circles] == [row.ok for row in ROWS]
    heights = [float(c["cy"]) for c in circles]
    assert max(heights[1], heights[2]) < min(heights[0], heights[3])
    assert " 3 4\n 1 2" in seen.text and "scale.column_pitch_m: 0.045" in seen.text and "OpenCV" in seen.text


def test_panels_as_text_are_read_as_replay_writes_them(tmp_path: Path) -> None:
    path = tmp_path / "panels.txt"
    grids = {1577000000000000000: " 3 4\n 1 2", 1577000000500000000: " 1\n\nbeside the grid: open"}
    path.write_text("legend\n\n" + "".join(f"{stamp}\n{grid}\n\n" for stamp, grid in grids.items()))
    assert {stamp: grid.rstrip() for stamp, grid in read_grids(path).items()} == grids
    assert read_grids(tmp_path / "none.txt") == {}


_PROBE = """<script>
const slider = document.querySelector('input[type=range]');
slider.value = 80; slider.dispatchEvent(new Event('input'));
const cut = slider.previousElementSibling.style.getPropertyValue('--cut');
const wide = document.documentElement.scrollWidth > innerWidth;
const shown = [...document.images].filter(i => i.complete && i.naturalWidth).length;
document.title = `cut ${cut} wide ${wide} shown ${shown}`;
</script>"""


@pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed: apt install chromium")
def test_a_browser_shows_it_on_a_small_screen(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text(PAGE.replace("</body>", f"{_PROBE}</body>"), encoding="utf-8")
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--no-first-run", "--disable-background-networking"]
    options += ["--disable-component-update", "--disable-sync", f"--user-data-dir={tmp_path / 'profile'}"]
    shown = subprocess.run(
        [str(CHROMIUM), *options, "--window-size=500,900", "--virtual-time-budget=3000", "--dump-dom", path.as_uri()],
        capture_output=True,
        text=True,
        timeout=60,
        check=False,
    )
    assert "<title>cut 80% wide false shown 11</title>" in shown.stdout, shown.stderr[-500:]
