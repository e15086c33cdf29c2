"""Buttons found in the picture by a network of our own, run by OpenCV."""
