"""The blind test: flights with hidden causes, sealed labels, and the scorer that opens them afterwards."""
