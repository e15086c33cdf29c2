"""The buttons measured in the picture."""
