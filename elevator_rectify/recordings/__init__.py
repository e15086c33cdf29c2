"""Programs on bags and pictures."""
