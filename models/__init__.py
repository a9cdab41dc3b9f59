"""Parameters, equations, MJCF, native plugins and the plants."""
