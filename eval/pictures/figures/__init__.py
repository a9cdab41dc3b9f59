"""Figures on paper: trajectories, curricula, missions. Curves, shapes and text are vectors."""
