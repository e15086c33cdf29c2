"""What came out of a bag as one HTML page: pictures inline, needs no other file and no network; for telephones too."""

from __future__ import annotations

import base64
import html
import platform
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np

from elevator_rectify import __version__
from elevator_rectify.core.types import Image
from elevator_rectify.recordings.report import Outcome, Pictures, Report

_WIDEST_PX, _JPEG_QUALITY = 560, 80
_PLOT_WIDTH, _PLOT_HEIGHT, _DOT = 1000, 160, 5
_OK, _REFUSED = "#2a9d3a", "#d9822b"
_STYLE = """
body { font: 16px/1.45 system-ui, sans-serif; margin: 0 auto; max-width: 70rem; padding: .5rem 1rem; }
h1 { font-size: 1.4rem } h2 { font-size: 1.15rem; border-top: 1px solid #bbb; padding-top: .6rem }
pre { overflow-x: auto; background: #f3f3f3; padding: .5rem; font-size: .85rem }
.frames { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(100%, 21rem), 1fr)); gap: 1rem }
figure { margin: 0 } figcaption { font-size: .85rem } img { display: block; width: 100% }
.pair { position: relative } .pair .after { position: absolute; inset: 0; clip-path: inset(0 0 0 var(--cut, 50%)) }
.pair img { aspect-ratio: 4 / 3; object-fit: contain; background: #111 }
input[type=range] { width: 100%; margin: .2rem 0 }
svg { width: 100%; height: auto; background: #f8f8f8 }
@media (prefers-color-scheme: dark) { body, pre, svg { background: #161616; color: #ddd } }
"""
_SLIDE = "this.previousElementSibling.style.setProperty('--cut', this.value + '%')"


def page(
    title: str,
    tables: str,
    outcomes: Mapping[str, Sequence[Outcome]],
    pictures: Mapping[str, Mapping[int, Pictures]],
    grids: Mapping[str, Mapping[int, str]],
    settings: Mapping[str, str],
) -> str:
    """Return the page of a bag. By method: outcomes, pictures and text grids by stamp; settings: of the parameters."""
    parts = [f"<h1>{html.escape(title)}</h1>", _pre(tables)]
    for method, rows in outcomes.items():
        parts.append(_method(method, rows, pictures[method], grids.get(method, {})))
    parts.append("<h2>Versions, and parameters that are not the defaults</h2>")
    parts.append(_pre("\n".join(f"{name}: {value}" for name, value in {**settings, **versions()}.items())))
    head = f"<meta charset=utf-8><meta name=viewport content='width=device-width'><title>{html.escape(title)}</title>"
    return (
        f"<!doctype html><html lang=en><head>{head}<style>{_STYLE}</style></head><body>{''.join(parts)}</body></html>"
    )


def write_page(
    source: Path,
    folder: Path,
    report: Report,
    settings: Mapping[str, str],
) -> None:
    """Write the page of a bag beside its tables, and say where it is."""
    grids = {method: read_grids(folder / f"panels_{method}.txt") for method in report.outcomes}
    text = page(source.resolve().name, report.table, report.outcomes, report.pictures, grids, settings)
    path = folder / "report.html"
    path.write_text(text, encoding="utf-8")
    print(f"open this: {path}")


def versions() -> dict[str, str]:
    """Return what the results were made with."""
    return {
        "elevator_rectify": __version__,
        "Python": platform.python_version(),
        "NumPy": np.__version__,
        "OpenCV": cv2.__version__,
    }


def read_grids(path: Path) -> dict[int, str]:
    """Return the panels as text by stamp, as `replay` wrote them; none where there is no such file."""
    if not path.exists():
        return {}
    blocks = [block.partition("\n") for block in path.read_text().split("\n\n")]
    # A panel with buttons beside its grid has a blank line in it; what follows belongs to it.
    found: dict[int, str] = {}
    stamp = 0
    for first, _, rest in blocks:
        if first.strip().isdigit() and len(first.strip()) > 9:
            stamp = int(first)
            found[stamp] = rest
        elif stamp and (first or rest):
            found[stamp] += f"\n\n{first}\n{rest}".rstrip()
    return found


def _method(method: str, rows: Sequence[Outcome], pictures: Mapping[int, Pictures], grids: Mapping[int, str]) -> str:
    accepted = sum(row.ok for row in rows)
    parts = [f"<h2>{html.escape(method)}: {accepted} of {len(rows)} images accepted</h2>", _plot(rows), _reasons(rows)]
    shown = [row for row in rows if row.stamp in pictures]
    if len(shown) < len(rows):
        parts.append(f"<p>{len(shown)} of the images are shown.</p>")
    figures = [_figure(row, pictures[row.stamp], grids.get(row.stamp, "")) for row in shown]
    return "".join([*parts, "<div class=frames>", *figures, "</div>"])


def _pre(text: str) -> str:
    return f"<pre>{html.escape(text)}</pre>"


def _plot(rows: Sequence[Outcome]) -> str:
    """Return the confidence of every image over time: full dots are accepted."""
    if not rows:
        return ""
    begin, span = rows[0].stamp, max(1, rows[-1].stamp - rows[0].stamp)
    dots = []
    for row in rows:
        x = _DOT + (row.stamp - begin) / span * (_PLOT_WIDTH - 2 * _DOT)
        y = _PLOT_HEIGHT - _DOT - float(row.values.get("confidence", 0.0)) * (_PLOT_HEIGHT - 2 * _DOT)
        colour, fill = (_OK, _OK) if row.ok else (_REFUSED, "none")
        label = html.escape(f"{1e-9 * (row.stamp - begin):.2f} s: {row.verdict}")
        dots.append(
            f"<circle cx={x:.1f} cy={y:.1f} r={_DOT} fill='{fill}' stroke='{colour}'><title>{label}</title></circle>"
        )
    seconds = 1e-9 * span
    words = f"confidence, 0 to 1, over {seconds:.1f} s: green is accepted, orange is refused"
    box = f"0 0 {_PLOT_WIDTH} {_PLOT_HEIGHT}"
    return f"<figure><svg viewBox='{box}' role=img>{''.join(dots)}</svg><figcaption>{words}</figcaption></figure>"


def _reasons(rows: Sequence[Outcome]) -> str:
    """Return why images were refused, the commonest first."""
    counts = Counter(row.verdict.partition(":")[0] for row in rows if not row.ok)
    if not counts:
        return ""
    newest = {row.verdict.partition(":")[0]: row.verdict for row in rows if not row.ok}
    items = [f"<li>{count} x {html.escape(newest[status])}</li>" for status, count in counts.most_common()]
    return f"<ul>{''.join(items)}</ul>"


def _figure(row: Outcome, shown: Pictures, grid: str) -> str:
    """Return one image: input and rectified view with a slider between them, the verdict, the panel as text."""
    name = html.escape(" ".join(part for part in (row.name, row.verdict) if part))
    parts = []
    if shown.overlay is not None and shown.view is not None:
        before, after = _inline(shown.overlay), _inline(shown.view)
        pair = f"<img src='{before}' alt='input'><img class=after src='{after}' alt='rectified'>"
        slider = f"<input type=range min=0 max=100 value=50 aria-label='before and after' oninput=\"{_SLIDE}\">"
        parts = [f"<div class=pair>{pair}</div>{slider}"]
    elif shown.overlay is not None:
        parts = [f"<div class=pair><img src='{_inline(shown.overlay)}' alt='input'></div>"]
    text = f"<details><summary>the panel as text</summary>{_pre(grid)}</details>" if grid else ""
    return f"<figure>{''.join(parts)}<figcaption>{name}</figcaption>{text}</figure>"


def _inline(image: Image) -> str:
    """Return the image as a data URL, reduced to what a page shows."""
    scale = min(1.0, _WIDEST_PX / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA) if scale < 1.0 else image
    data = cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY])[1]
    return f"data:image/jpeg;base64,{base64.b64encode(data.tobytes()).decode()}"
