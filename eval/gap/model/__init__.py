"""Predictions of a vehicle with candidate effects, and the regression of the flights on them."""
