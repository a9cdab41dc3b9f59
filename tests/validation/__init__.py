"""Evidence that takes minutes, with an independent simulator, simulators by others and recorded flights."""
