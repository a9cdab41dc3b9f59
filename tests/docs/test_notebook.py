"""The notebook: its cells parse, its commands exist, it is kept as it ran, and, slowly, it runs."""

import ast
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests import ROOT, documents

NOTEBOOK = ROOT / "examples" / "first_landing.ipynb"
CELLS = json.loads(NOTEBOOK.read_text("utf-8"))["cells"]
CODE = ["".join(cell["source"]) for cell in CELLS if cell["cell_type"] == "code"]

# As a notebook's kernel does it: one interpreter for all cells, which come as JSON on standard input.
KERNEL = """
import json, sys
from IPython.core.interactiveshell import InteractiveShell
shell = InteractiveShell.instance()
for number, cell in enumerate(json.load(sys.stdin)):
    print(f"--- cell {number}\\n{cell}", flush=True)
    shell.run_cell(cell).raise_error()
    code = shell.user_ns.pop("_exit_code", 0)
    assert code == 0, f"exit code {code}"
"""


def commands(source: str) -> list[str]:
    """The lines of a cell that a shell runs."""
    source = source.replace("\\\n", " ")
    return [line.strip()[1:] for line in source.splitlines() if line.strip().startswith(("!", "%pip"))]


def test_it_is_a_notebook_as_it_ran():
    whole = json.loads(NOTEBOOK.read_text("utf-8"))
    assert (whole["nbformat"], whole["nbformat_minor"]) == (4, 5) and len(CODE) > 10
    assert len({cell["id"] for cell in CELLS}) == len(CELLS)
    code = [cell for cell in CELLS if cell["cell_type"] == "code"]
    for number, cell in enumerate(code, 1):
        assert cell["execution_count"] == number and (number == 1) == (not cell["outputs"])
        text = "".join(line for one in cell["outputs"] for line in one.get("text", ()))
        assert not any(one["output_type"] == "error" for one in cell["outputs"])
        assert "Traceback" not in text and "\x1b" not in text and not re.search(r"(^|\s)/\w+/", text)
    for cell in CELLS:
        assert len(cell["source"]) <= 10, "a short cell is read, a long one is not"


@pytest.mark.parametrize("source", CODE)
def test_a_cell_parses_and_its_commands_exist(source):
    joined = source.replace("\\\n", " ")
    ast.parse(re.sub(r"^( *)[!%].*", r"\1pass", joined, flags=re.MULTILINE))
    for line in commands(source):
        for words in documents.lines(line):
            assert words[0] in (*documents.PROGRAMS, "pip"), words
            documents.check(words)


def test_commands_in_its_sentences_exist():
    for cell in CELLS:
        if cell["cell_type"] == "markdown":
            for span in documents.SPAN.finditer("".join(cell["source"])):
                documents.check_span(span[1])


@pytest.mark.slow
def test_it_runs_from_top_to_bottom(tmp_path):
    """In an interpreter of its own; run with -s to see what it prints."""
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "-c", KERNEL], input=json.dumps(CODE), cwd=tmp_path, env=os.environ | {"PATH": path},
        capture_output=True, text=True,
    )  # fmt: skip
    print(f"{done.stdout}\n{time.monotonic() - began:.0f} s")
    assert done.returncode == 0, f"{done.stdout[-3000:]}\n{done.stderr[-2000:]}"
    assert len(re.findall(r"--- cell \d+\n", done.stdout)) == len(CODE)
    assert "thrust scale" in done.stdout and "rotor drag" in done.stdout  # hidden in the flights
    made = {path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*")}
    assert made >= {
        "demo/landing.html",
        "my_landing/final.zip",
        "my_start.mp4",
        "gap/report.html",
        "corrected/final.zip",
    }
