"""What sweeps over seeds found: recipes and their results as files, and the page made of them.

`recipe.py` reads a recipe, `measured.py` its numbers over the seeds, `beyond.py` writes the page.
"""
