"""Colours of all figures and of the labels in pictures, without matplotlib."""

# Colours of Okabe and Ito, told apart with any colour vision.
BLUE, ORANGE, GREEN, PURPLE = "#0072b2", "#d55e00", "#009e73", "#b0528d"
INK, MUTED = "#1f2733", "#5f6b7a"
AIR, RULE, SLAB, BASE = "#f1f6fc", "#d3deea", "#c9ced4", "#435062"
