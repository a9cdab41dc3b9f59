"""The benchmark report as tables for people."""

from __future__ import annotations

from rich.table import Table

from inclined_landing.eval.base.tables import new_table, printer


def show(report: dict) -> None:
    """Print the report of `benchmark.run`."""
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
        *("plant", "environment", "bare stepping", "task, reward, resets [%]", "in contact [%]"),
    )
    for row in rows:
        table.add_row(
            row["plant"],
            _spread(row["steps_per_second"]),
            _spread(row["bare_steps_per_second"]),
            _spread(row["overhead"], 100, 1),
            f"{100 * row['in_contact']:.0f}",
        )
    return table


def _single(report: dict) -> Table:
    table = new_table("Policy, pictures, training", "", "")
    latency = report["policy"]
    table.add_row("one action, this package [us]", _spread(latency["predict_us"], 1, 1))
    table.add_row("one action, SB3 predict [us]", _spread(latency["sb3_predict_us"], 1, 1))
    many = latency["predict_batch_us_per_row"]
    table.add_row("one of 256 actions at once [us]", _spread(many, 1, 2))
    table.add_section()
    for row in report["video"]:
        label = f"frame 640x480, fixed camera, {row['backend']}"
        if "skipped" in row:
            table.add_row(label, f"skipped: {row['skipped']}")
        else:
            table.add_row(f"{label}, wall [ms]", _spread(row["wall_ms"], 1, 1))
            table.add_row(f"{label}, CPU [ms]", _spread(row["cpu_ms"], 1, 1))
    training = report.get("training")
    if training:
        table.add_section()
        rate, plain = training["steps_per_second"], training["plain_steps_per_second"]
        table.add_row("training, landing-train [steps/s]", _spread(rate))
        table.add_row("training, SB3 defaults, one plain environment [steps/s]", _spread(plain))
        table.add_row("ratio", _spread(training["ratio"], 1, 1))
    reached = report["time_to_99_percent"]
    if reached:
        table.add_section()
        total = len(reached["runs"])
        table.add_row("runs that reached 99 %", f"{reached['reached']} of {total}")
        table.add_row("training time to 99 % [s]", _spread(reached["seconds"], 1, 1))
        table.add_row("steps to 99 %", _spread(reached["steps"]))
    return table


def _spread(value: dict, factor: float = 1.0, digits: int = 0) -> str:
    if value["median"] is None:
        return "-"
    f = f",.{digits}f"
    middle, low, high = (factor * value[key] for key in ("median", "min", "max"))
    return f"{middle:{f}} ({low:{f}} to {high:{f}})"
