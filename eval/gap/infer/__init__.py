"""Inference of effects from flights: fits, marginal likelihoods, sets of effects, contact, residual."""
