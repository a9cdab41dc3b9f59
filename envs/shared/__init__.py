"""Code shared by `landing-train` and `landing-eval`: command lines, options, run folders, tables, pool."""
