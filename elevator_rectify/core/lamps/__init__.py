"""Whether a button's lamp went on: what changed of the buttons between two moments."""
