"""`landing-eval replay`: a page for the browser that shows flights from any side."""
