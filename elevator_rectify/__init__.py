"""Elevator panels seen straight: grid of the buttons, pose of the panel, fronto-parallel view."""

__version__ = "0.1.0"
