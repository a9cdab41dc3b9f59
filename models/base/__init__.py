"""Shared utilities without physics: errors, typed files, atomic storage, late imports."""
