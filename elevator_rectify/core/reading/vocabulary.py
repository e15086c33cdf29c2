"""What the reader's network can say of a button: a text of up to four characters, a symbol, or none of them."""

from __future__ import annotations

CHARACTERS = "0123456789ABCDEFGHIJKLMNOPQRSTUVWXYZ-*"
SLOTS = 4
# A slot's last class: no character there.
BLANK = len(CHARACTERS)
SYMBOLS = ("open", "close", "alarm", "call", "up", "down", "updown", "stop", "fan", "light", "key", "hat")
# Kinds of what is seen: a text, one of the symbols, a button without print, one that cannot be read, no button.
KINDS = ("text", *SYMBOLS, "empty", "unreadable", "other")
KIND_OF_LABEL = {"empty": "empty", "blur": "unreadable", "unknown": "unreadable"}


def encoded(label: str) -> tuple[str, tuple[int, ...]] | None:
    """Return kind and the classes of the slots of a label as annotated, None where the network cannot say it."""
    if label in SYMBOLS:
        return label, (BLANK,) * SLOTS
    if label in KIND_OF_LABEL:
        return KIND_OF_LABEL[label], (BLANK,) * SLOTS
    # A star before the floor of the main exit is annotated as a small s.
    text = "*" + label[1:] if label.startswith("s") else label
    if not 0 < len(text) <= SLOTS or any(c not in CHARACTERS for c in text):
        return None
    return "text", tuple(CHARACTERS.index(c) for c in text) + (BLANK,) * (SLOTS - len(text))
