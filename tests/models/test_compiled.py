"""What is compiled is never older than its sources."""

import os

from inclined_landing.models.compiled import remove_outdated


def test_compiled_functions_older_than_what_they_call_are_removed(tmp_path):
    files = {
        "models/forces.py": ("from inclined_landing.models.compiled import kernel", 200),
        "models/words.py": ("nothing is compiled here", 900),
        "envs/batch.py": ("import numba", 300),
        "models/__pycache__/forces.thrust.nbi": ("", 250),
        "envs/__pycache__/batch.reset.nbi": ("", 250),  # older than its own source
        "eval/__pycache__/fit.solve.nbi": ("", 250),  # older than a source of a floor below
        "eval/__pycache__/fit.score.nbi": ("", 350),
        "eval/__pycache__/fit.cpython.pyc": ("", 100),
    }
    for name, (text, when) in files.items():
        path = tmp_path / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)
        os.utime(path, (when, when))
    remove_outdated(tmp_path)
    left = {str(p.relative_to(tmp_path)) for p in tmp_path.rglob("*") if p.is_file()}
    assert files.keys() - left == {"envs/__pycache__/batch.reset.nbi", "eval/__pycache__/fit.solve.nbi"}
