"""Cameras, rotations and poses of planes."""
