"""What a vehicle with candidate effects predicts of a flight, and the regression of the flights on it."""
