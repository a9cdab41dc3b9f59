"""Parameters, equations, MJCF, native plugins and the two plants."""
