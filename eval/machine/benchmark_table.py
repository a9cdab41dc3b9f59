"""The benchmark report as tables for people."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from inclined_landing.envs.shared.tables import new_table, say, show_table, spread_cell

_ENVIRONMENTS = (
    *("plant, options of the task", "environment", "bare stepping", "task, reward, resets [%]"),
    *("over no options [%]", "by MuJoCo [%]", "in contact [%]"),
)
_SIDES = {
    "": "landing-train",
    "stock_": "landing-train --update stock",
    "plain_": "SB3 defaults, one plain environment",
}


def show(report: dict[str, Any]) -> None:
    """Print the report of `benchmark.command`."""
    versions = report["versions"]
    say(
        f"{versions['cpu']}, {versions['cores']} cores, load {report['load_before'][0]:.1f} before; "
        f"Python {versions['python']}, MuJoCo {versions['mujoco']}, torch {versions['torch']}; "
        f"seed {report['seed']}. Median (smallest to largest)."
    )
    rows = report["environments"]
    table = new_table(f"Control steps per second, {rows[0]['vehicles']} vehicles", *_ENVIRONMENTS)
    for row in rows:
        rates = [_range(row[key], 0) for key in ("steps_per_second", "bare_steps_per_second")]
        shares = f"{100 * row['in_engine']:.1f}", f"{100 * row['in_contact']:.0f}"
        added = "" if row["over_plain"] is None else _range(row["over_plain"], factor=100)
        table.add_row(row["plant"], *rates, _range(row["overhead"], factor=100), added, *shares)
    show_table(table)
    table = new_table("Policy, pictures, training", "", "")
    for part in (_policy(report["policy"]), _pictures(report["video"]), _training(report)):
        for cells in part:
            table.add_row(*cells)
        table.add_section()
    show_table(table)
    latency, plain = report["policy"]["predict_us"]["median"], rows[0]
    said = f"{plain['steps_per_second']['median']:,.0f} control steps per second ({plain['plant']})"
    said += f", {latency:.0f} us for an action"
    if training := report.get("training"):
        said += f", {training['steps_per_second']['median']:,.0f} training steps per second"
    say(f"This machine makes {said}.")


def _policy(latency: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield what one action costs."""
    yield "one action, this package [us]", _range(latency["predict_us"])
    yield "one action, SB3 predict [us]", _range(latency["sb3_predict_us"])
    yield "one of 256 actions at once [us]", _range(latency["predict_batch_us_per_row"], 2)
    exported = latency["exported_us"]
    for format, words in (("c", "C"), ("numpy", "NumPy"), ("onnx", "ONNX Runtime")):
        yield f"one action, exported as {words} [us]", _measured(exported[format], 2 if format == "c" else 1)
        if "skipped" not in exported[format]:
            yield (
                "  its largest difference from the policy's",
                f"{exported[format]['largest_difference']:.1e}",
            )
    low, high = exported["cost"]["stm32f405_estimate_us"]
    yield "floating-point operations of an action", str(exported["cost"]["floating_point_operations"])
    yield "on a Crazyflie's STM32F405, estimated [us]", f"{low} to {high}"


def _pictures(rows: list[dict[str, Any]]) -> Iterator[tuple[str, str]]:
    """Yield what one picture costs."""
    for row in rows:
        label = f"frame 640x480, fixed camera, {row['backend']}"
        if "skipped" in row:
            yield label, _measured(row)
        else:
            yield f"{label}, wall [ms]", _range(row["wall_ms"])
            yield f"{label}, CPU [ms]", _range(row["cpu_ms"])


def _training(report: dict[str, Any]) -> Iterator[tuple[str, str]]:
    """Yield how fast training is, and how long it took in finished runs."""
    if training := report.get("training"):
        for side, words in _SIDES.items():
            yield f"training, {words} [steps/s]", _range(training[f"{side}steps_per_second"], 0)
        yield "ratio to --update stock", _range(training["ratio_to_stock"])
        yield f"ratio to {_SIDES['plain_']}", _range(training["ratio"])
    if reached := report["time_to_99_percent"]:
        yield "runs that reached 99 %", f"{reached['reached']} of {len(reached['runs'])}"
        yield "training time to 99 % [s]", _range(reached["seconds"])
        yield "steps to 99 %", _range(reached["steps"], 0)


def _measured(value: dict[str, Any], digits: int = 1) -> str:
    return f"skipped: {value['skipped']}" if "skipped" in value else _range(value, digits)


def _range(value: dict[str, Any], digits: int = 1, factor: float = 1.0) -> str:
    return spread_cell(value, digits, factor, ("min", "max"))
