"""Code shared by `landing-train` and `landing-eval`: command lines, progress, run folders, tables, pool."""
