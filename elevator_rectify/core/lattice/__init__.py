"""The lattice of buttons and the pose, fitted together to the detections."""
