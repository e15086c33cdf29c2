"""The publication's method, by itself."""
