"""`landing-eval robustness`: what landing policies survive of what the model may lack."""
