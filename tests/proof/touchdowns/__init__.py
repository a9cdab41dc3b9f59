"""Measured touchdowns on a flat floor, and the same touchdowns simulated."""
