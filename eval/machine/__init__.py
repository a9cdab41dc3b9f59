"""Checks of this installation and its speed: `doctor`, `benchmark`."""
