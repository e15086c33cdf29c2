"""One to five buttons, single rows and columns: the pose from outlines."""
