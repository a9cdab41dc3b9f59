"""Flights of Crazyflies: the pilot, and the simulated vehicle with the same interface."""
