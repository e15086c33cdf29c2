"""Panels that were taught: their buttons' places and labels are known, only the pose is sought."""
