"""Does the gap workflow work? `gap-example`, `gap-blind`, `gap-real`. The workflow never imports this."""
