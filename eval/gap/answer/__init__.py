"""From flights to a diagnosis."""
