"""Figures of trajectories, curricula and missions as vector graphics."""
