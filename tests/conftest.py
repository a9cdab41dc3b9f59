"""Settings of the whole suite."""

import hypothesis

# Compiled functions take seconds at their first call; the same examples on every machine and run.
hypothesis.settings.register_profile("suite", deadline=None, derandomize=True)
hypothesis.settings.load_profile("suite")
