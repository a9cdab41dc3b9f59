"""Measured flights as the search wants them."""
