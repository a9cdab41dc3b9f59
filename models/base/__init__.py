"""What every package uses and no physics: errors, typed files, atomic storage, late imports."""
