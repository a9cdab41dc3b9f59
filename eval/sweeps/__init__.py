"""The page of what sweeps over seeds found; recipes and their numbers are read by `envs/shared`."""
