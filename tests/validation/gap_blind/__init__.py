"""The blind test: flights with hidden causes in random realities, sealed labels, and the scorer."""
