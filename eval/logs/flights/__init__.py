"""Public sets of measured flights: where to get each, and its files as documented CSV."""
