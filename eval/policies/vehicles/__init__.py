"""Landing policies on other quadrotors: `landing-eval vehicles`."""
