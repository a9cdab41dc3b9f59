"""Public sets of measured flights: where each is to be had, and its own files as documented CSV."""
