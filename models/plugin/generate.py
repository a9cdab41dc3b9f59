"""Generates C++ at build time, and the manual on demand, from `attributes.toml` and the vehicle file.

usage: generate.py build MUJOCO_VERSION OUTPUT_FOLDER   write attributes.h and _build.json
       generate.py manual                               rewrite the attribute tables of README.md
"""

import itertools
import json
import re
import sys
import tomllib
from pathlib import Path

HERE = Path(__file__).resolve().parent
_WORDS = {">": "greater than", "<": "less than", ">=": "at least", "<=": "at most", "!=": "other than"}


class Attribute:
    """One line of the table, with its entry of the vehicle file."""

    def __init__(self, name: str, line: dict, vehicle: dict):
        self.name, self.meaning = name, line["meaning"]
        self.names = line.get("names")  # a list of names, else None
        self.entry = line.get("entry")
        self.unit, self.values = "names", []
        if self.entry:
            table, key = self.entry.split(".")
            value = vehicle[table][key]["value"]
            self.default = value
            self.unit = vehicle[table][key]["unit"]
            self.values = [float(x) for x in (value if isinstance(value, list) else [value])]
        rule = line.get("rule", [])
        self.rules = [rule] * len(self.values) if isinstance(rule, str) else rule

    def condition(self) -> str:
        """Return the condition on the numbers `x` in C++."""
        parts = []
        for k, rule in enumerate(self.rules):
            if rule.startswith("whole "):
                parts.append(f"x[{k}] == std::floor(x[{k}])")
            parts.append(f"x[{k}] {rule.removeprefix('whole ')}")
        return " && ".join(parts) or "true"

    def rule(self) -> str:
        """Return the rule for the numbers in words that follow 'must be'."""
        words = []
        for rule in dict.fromkeys(self.rules) if len(set(self.rules)) == 1 else self.rules:
            *whole, sign, number = rule.split()
            words.append(f"{'a whole number of ' if whole else ''}{_WORDS[sign]} {number}")
        count = len(self.values)
        each = "" if count == 1 else f"{count} numbers, each " if len(words) == 1 else f"{count} numbers: "
        unit = "" if self.unit == "1" else f" ({self.unit})"
        return each + ", ".join(words) + unit if words else ""

    def member(self) -> str:
        """Return the member of the C++ struct."""
        if self.names:
            values = ", ".join(json.dumps(name) for name in self.names)
            return f"  std::vector<std::string> {self.name} = {{{values}}};  // {self.meaning}"
        numbers = ", ".join(map(repr, self.values))
        if len(self.values) == 1:
            return f"  double {self.name} = {numbers};  // {self.unit}: {self.meaning}"
        return f"  double {self.name}[{len(self.values)}] = {{{numbers}}};  // {self.unit}: {self.meaning}"

    def taken(self, begin: int) -> list[str]:
        """Return C++ code that copies its numbers from `x`, beginning at `begin`."""
        places = (
            [self.name] if len(self.values) == 1 else [f"{self.name}[{k}]" for k in range(len(self.values))]
        )
        return [f"    {place} = x[{begin + k}];" for k, place in enumerate(places)]

    def line(self) -> str:
        """Return the line of the C++ table."""
        if self.names:
            return f'        {{"{self.name}", nullptr, 0, nullptr, "", &{self.name}}},'
        address = self.name if len(self.values) > 1 else f"&{self.name}"
        check = f"[](const double* x) {{ return {self.condition()}; }}" if self.rules else "nullptr"
        return f'        {{"{self.name}", {address}, {len(self.values)}, {check}, "{self.rule()}", nullptr}},'

    def row(self) -> str:
        """Return the row of the manual."""
        if self.names:
            return f"| `{self.name}` | `{' '.join(self.names)}` | names | | {self.meaning} |"
        table, key = self.entry.split(".")
        signs = dict.fromkeys(self.rules) if len(set(self.rules)) == 1 else self.rules
        return f"| `{self.name}` | `[{table}] {key}` | {self.unit} | {', '.join(signs)} | {self.meaning} |"


def attributes() -> dict[str, list[Attribute]]:
    """Plugin -> attributes, in the order of the table."""
    vehicle = tomllib.loads((HERE.parent / "crazyflie.toml").read_text("utf-8"))
    table = tomllib.loads((HERE / "attributes.toml").read_text("utf-8"))
    return {
        plugin: [Attribute(name, line, vehicle) for name, line in lines.items()]
        for plugin, lines in table.items()
    }


def header(plugins: dict[str, list[Attribute]]) -> str:
    """Return the C++ structs."""
    lines = [
        "// Generated from attributes.toml and the vehicle file; do not edit.",
        "#pragma once",
        "",
        "#include <cmath>",
        "",
        '#include "attribute.h"',
        "",
        "namespace inclined_landing {",
    ]
    for plugin, table in plugins.items():
        names = ", ".join(f'"{a.name}"' for a in table)
        begins = [0, *itertools.accumulate(len(a.values) for a in table)]
        lines += [
            "",
            f"struct {plugin.title()}Attributes {{",
            f"  static constexpr const char* kNames[] = {{{names}}};",
            *(a.member() for a in table),
            "",
            "  std::vector<Attribute> Table() {",
            "    return {",
            *(a.line() for a in table),
            "    };",
            "  }",
            "",
            "  // All numbers, in the order of the table.",
            f"  static constexpr int kNumbers = {begins[-1]};",
            "  void Take(const double* x) {",
            *(line for a, begin in zip(table, begins) for line in a.taken(begin)),
            "  }",
            "};",
        ]
    return "\n".join([*lines, "", "}  // namespace inclined_landing", ""])


def manual(text: str, plugins: dict[str, list[Attribute]]) -> str:
    """Return `text` of the manual with its attribute tables rewritten."""
    for plugin, table in plugins.items():
        rows = [
            "| attribute | default | unit | must be | meaning |",
            "|---|---|---|---|---|",
            *(a.row() for a in table),
        ]
        begin = rf"(<!-- attributes of {plugin}: [^\n]* -->\n).*?(<!-- end -->)"
        text = re.sub(begin, lambda m, rows=rows: m[1] + "\n".join(rows) + "\n" + m[2], text, flags=re.S)
    return text


def main(command: str, *arguments: str) -> None:
    plugins = attributes()
    if command == "manual":
        readme = HERE / "README.md"
        readme.write_text(manual(readme.read_text("utf-8"), plugins), "utf-8")
        return
    version, folder = arguments[0], Path(arguments[1])
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "attributes.h").write_text(header(plugins), "utf-8")
    build = {"mujoco": version} | {
        plugin: {a.name: a.default for a in table if a.entry} for plugin, table in plugins.items()
    }
    (folder / "_build.json").write_text(json.dumps(build, indent=2) + "\n", "utf-8")


if __name__ == "__main__":
    main(*sys.argv[1:])
