"""Interactive views of flights: `replay`, a page for the browser, and `view`, MuJoCo's viewer."""
