"""Crazyflies flown: the pilot, and the simulated vehicle that answers the same calls."""
