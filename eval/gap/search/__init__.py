"""Which effects explain the flights."""
