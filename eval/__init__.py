"""Success tables, figures, videos and the `landing-eval` command."""
