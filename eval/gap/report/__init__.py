"""The report of a diagnosis: a page, its figures, a short text for the terminal, and the corrected model."""
