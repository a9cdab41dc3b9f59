"""The identified vehicles of models/vehicles: from which public flights, and how they predict others."""
