"""The whole mission: set-point flight, landing and touchdown as one flight."""
