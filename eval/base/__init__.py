"""What all commands share: options, progress, pages, claims, style. Imports no other subpackage."""
