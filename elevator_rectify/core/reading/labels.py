"""What buttons are called: the spellings of detectors and people, brought to one."""

from __future__ import annotations

import json
import re
import unicodedata
from functools import cache, lru_cache
from pathlib import Path

# One function button a line, with its other spellings; users may extend the file.
ALIASES = Path(__file__).with_name("labels.json")
_LONGEST = 32
_NUMBER = re.compile(r"([+-]?)0*(\d+)")
# Printed before or after the floor of the main exit.
_STARS = "*★☆"


@cache
def aliases(path: Path = ALIASES) -> dict[str, str]:
    """Return {spelling: label} of a file of aliases; every label spells itself. Raises ValueError, with the line."""
    try:
        table = json.loads(path.read_text(encoding="utf-8"))
    except json.JSONDecodeError as error:
        raise ValueError(f"{path}, line {error.lineno}: {error.msg}") from error
    if not isinstance(table, dict) or not all(
        isinstance(several, list) and all(isinstance(text, str) for text in several) for several in table.values()
    ):
        raise ValueError(f"{path}: an object is expected, of lists of spellings by label")
    return {_plain(spelling): name for name, spellings in table.items() for spelling in (name, *spellings)}


def canonical(text: str) -> str:
    """Return the one spelling of a label: 'open' for '<|>', '7' for ' 07 ', 'B1' for 'b1', '1' for '*1'; '' for none.

    Whatever is not printable is dropped, and all but the first 32 characters.
    """
    return _canonical(text[: 4 * _LONGEST])


@lru_cache(maxsize=4096)
def _canonical(text: str) -> str:
    """Return the same of a text that is short enough to be kept."""
    plain = _plain(text)
    short = plain.strip(_STARS + " ") or plain
    for spelling in (plain, short):
        if spelling in aliases():
            return aliases()[spelling]
    number = _NUMBER.fullmatch(short)
    if number:
        return ("-" if number[1] == "-" and number[2] != "0" else "") + number[2]
    return short.upper()


def _plain(text: str) -> str:
    """Return the text with compatible characters unified, lower case, single spaces, printable only."""
    unified = unicodedata.normalize("NFKC", text[: 4 * _LONGEST]).casefold()
    printable = "".join(c if c.isprintable() else " " for c in unified)
    return " ".join(printable.split())[:_LONGEST].rstrip()
