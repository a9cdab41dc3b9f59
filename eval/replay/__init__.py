"""Flights to look at from all sides: `replay`, a page for the browser, and `view`, MuJoCo's viewer."""
