"""What every room uses: run folders, statistics, tables, pages, claims, style. Knows of no room."""
