"""Code shared by all commands: options, progress, pages, claims, style. It imports no other subpackage."""
