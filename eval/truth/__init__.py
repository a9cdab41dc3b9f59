"""Is the simulator right? `equivalence`, `contact-truth`."""
