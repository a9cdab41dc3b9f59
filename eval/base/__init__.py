"""Code shared by all commands: options, pages, claims, style. It imports no other subpackage."""
