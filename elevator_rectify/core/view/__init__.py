"""Pictures and text made of a fit."""
