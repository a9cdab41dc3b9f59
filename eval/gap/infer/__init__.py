"""Which effects explain the flights: fits, marginal likelihoods, sets of effects, contact, residual."""
