"""Made-up elevators with known truth: layouts, viewpoints, detections, pictures, bags."""
