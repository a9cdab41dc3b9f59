"""Wrong input, generated: everything that is read gets every kind of evil value (see `judge`)."""
