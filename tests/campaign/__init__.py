"""Wrong input of every kind, drawn by Hypothesis: used, or refused in one sentence."""
