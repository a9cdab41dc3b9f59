"""Measured flights of others, published with licences that allow it: what the gap workflow makes of them."""
