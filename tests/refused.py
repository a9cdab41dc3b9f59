"""Wrong input of a program, as a person meets it."""

import contextlib
import io
from collections.abc import Callable
from pathlib import Path


def refused(main: Callable[[list[str]], int], words: list[str], sentence: str, folder: Path) -> str:
    """Fail unless exit code 2 and one sentence are all that a program leaves behind, also in a folder."""
    before, out, error = sorted(folder.rglob("*")), io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        assert main(words) == 2
    said = error.getvalue()
    assert out.getvalue() == "" and said.count("\n") == 1 and sentence in said, said
    assert sorted(folder.rglob("*")) == before
    return said
