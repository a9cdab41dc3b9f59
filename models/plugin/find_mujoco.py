"""Print `include directory;library;version` of the installed MuJoCo wheel, without importing it."""

import importlib.util
import re
import sys
from pathlib import Path

spec = importlib.util.find_spec("mujoco")
if spec is None:
    sys.exit("MuJoCo is not installed in the Python that builds the plugins.")
for folder in map(Path, spec.submodule_search_locations):
    libraries = sorted([*folder.glob("libmujoco.so.*"), *folder.glob("libmujoco.*.dylib")])
    header = folder / "include" / "mujoco" / "mujoco.h"
    if libraries and header.exists():
        break
else:
    sys.exit(f"No libmujoco and headers in {list(spec.submodule_search_locations)}.")
number = int(re.search(r"#define mjVERSION_HEADER (\d+)", header.read_text("utf-8"))[1])
version = f"{number // 1_000_000}.{number // 1_000 % 1_000}.{number % 1_000}"
if not any(version in library.name for library in libraries):
    sys.exit(f"MuJoCo's header is of version {version}, its library is {libraries[0].name}.")
print(f"{folder / 'include'};{libraries[0]};{version}")
