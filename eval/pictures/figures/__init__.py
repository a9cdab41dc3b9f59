"""Figures of trajectories, curricula and missions, with curves, shapes and text as vectors."""
