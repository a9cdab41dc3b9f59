"""Code shared by `landing-train` and `landing-eval`: command lines, options, progress, run folders, tables, pool."""
