"""Does the gap workflow work? `gap-example`, `gap-blind`, `gap-real`, `nanobench`. It never imports this."""
