"""What `landing-train` and `landing-eval` share: command lines, options, run folders, tables, the pool."""
