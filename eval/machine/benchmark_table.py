"""The benchmark report as tables for people."""

from __future__ import annotations

from rich.table import Table

from inclined_landing.eval.base.tables import new_table, printer, spread_cell


def show(report: dict) -> None:
    """Print the report of `benchmark.command`."""
    console = printer()
    versions = report["versions"]
    console.print(
        f"{versions['cpu']}, {versions['cores']} cores, load {report['load_before'][0]:.1f} before; "
        f"Python {versions['python']}, MuJoCo {versions['mujoco']}, torch {versions['torch']}; "
        f"seed {report['seed']}. Median (smallest to largest)."
    )
    console.print(_environments(report))
    console.print(_single(report))


def _environments(report: dict) -> Table:
    rows = report["environments"]
    table = new_table(
        f"Control steps per second, {rows[0]['vehicles']} vehicles",
        *(
            "plant, options of the task",
            "environment",
            "bare stepping",
            "task, reward, resets [%]",
            "by MuJoCo [%]",
            "in contact [%]",
        ),
    )
    for row in rows:
        rates = [_range(row[key], 0) for key in ("steps_per_second", "bare_steps_per_second")]
        shares = (f"{100 * row[key]:.{digits}f}" for key, digits in (("in_engine", 1), ("in_contact", 0)))
        table.add_row(row["plant"], *rates, _range(row["overhead"], factor=100), *shares)
    return table


def _single(report: dict) -> Table:
    table = new_table("Policy, pictures, training", "", "")
    latency = report["policy"]
    table.add_row("one action, this package [us]", _range(latency["predict_us"]))
    table.add_row("one action, SB3 predict [us]", _range(latency["sb3_predict_us"]))
    table.add_row("one of 256 actions at once [us]", _range(latency["predict_batch_us_per_row"], 2))
    for format, words in (("c", "C"), ("numpy", "NumPy"), ("onnx", "ONNX Runtime")):
        measured = latency["exported_us"][format]
        skipped = measured.get("skipped")
        label = f"one action, exported as {words} [us]"
        if skipped:
            table.add_row(label, f"skipped: {skipped}")
            continue
        table.add_row(label, _range(measured, 2 if format == "c" else 1))
        table.add_row("  its largest difference from the policy's", f"{measured['largest_difference']:.1e}")
    cost = latency["exported_us"]["cost"]
    low, high = cost["stm32f405_estimate_us"]
    table.add_row("floating-point operations of an action", str(cost["floating_point_operations"]))
    table.add_row("on a Crazyflie's STM32F405, estimated [us]", f"{low} to {high}")
    table.add_section()
    for row in report["video"]:
        label = f"frame 640x480, fixed camera, {row['backend']}"
        if "skipped" in row:
            table.add_row(label, f"skipped: {row['skipped']}")
        else:
            table.add_row(f"{label}, wall [ms]", _range(row["wall_ms"]))
            table.add_row(f"{label}, CPU [ms]", _range(row["cpu_ms"]))
    if training := report.get("training"):
        table.add_section()
        for side, words in (
            ("", "landing-train"),
            ("stock_", "landing-train --update stock"),
            ("plain_", "SB3 defaults, one plain environment"),
        ):
            table.add_row(f"training, {words} [steps/s]", _range(training[f"{side}steps_per_second"], 0))
        table.add_row("ratio to --update stock", _range(training["ratio_to_stock"]))
        table.add_row("ratio to SB3 defaults, one plain environment", _range(training["ratio"]))
    if reached := report["time_to_99_percent"]:
        table.add_section()
        table.add_row("runs that reached 99 %", f"{reached['reached']} of {len(reached['runs'])}")
        table.add_row("training time to 99 % [s]", _range(reached["seconds"]))
        table.add_row("steps to 99 %", _range(reached["steps"], 0))
    return table


def _range(value: dict, digits: int = 1, factor: float = 1.0) -> str:
    return spread_cell(value, digits, factor, ("min", "max"))
