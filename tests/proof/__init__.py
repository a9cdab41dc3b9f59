"""Evidence for the gap workflow and the pilot, with an independent simulator: `python -m tests.proof`."""
