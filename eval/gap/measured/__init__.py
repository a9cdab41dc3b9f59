"""Measured flights: windows, landings, noise model, whitening."""
