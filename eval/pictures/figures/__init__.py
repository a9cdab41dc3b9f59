"""Figures of trajectories and missions as vector graphics."""
