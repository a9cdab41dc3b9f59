"""Known causes in real flights: the file of rows, and the judgement; made-up flights only."""

import dataclasses
from fnmatch import fnmatch
from types import SimpleNamespace

import pytest

from inclined_landing.models.effects import LIBRARY
from inclined_landing.models.parameters import load_vehicle
from tests.validation import causes

ROW = causes.Row(
    *("lab", "a weight", "cause", "development", ("before/*.csv",), ("after/*.csv",), "crazyflie-2.1"),
    right=("mass", "thrust_scale"),
    beside=("attitude_trim",),
)


def test_rows_are_well_formed():
    known = causes.known_rows()
    assert len({r.key for r in known}) == len(known)  # one file each
    for r in known:
        assert r.kind in ("cause", "nothing", "unknown", "dose"), r
        assert r.strength in ("weak", "medium", "strong"), r
        assert set(r.right) | set(r.beside) <= set(LIBRARY) and not set(r.right) & set(r.beside), r
        assert bool(r.right) or r.kind != "cause", r
        assert not r.right or r.kind != "nothing", r
        assert causes.base_vehicle(r).body_mass == (r.mass or load_vehicle(r.vehicle).body_mass)
        assert not r.size or (r.size["of"] in ("thrust", "wind") and r.size["value"] > 0), r
        assert (r.kind == "dose") == (r.dose is not None and hasattr(load_vehicle(), r.parameter or "-")), r


def test_halves_are_kept_apart():
    """No development row reads a flight that another half judges, and no row its own reference."""

    def flights(r, patterns):
        return {(r.set, one) for pattern in patterns for one in causes._expanded(pattern)}

    def meet(some, others):
        return any(
            a[0] == b[0] and (fnmatch(a[1], b[1]) or fnmatch(b[1], a[1])) for a in some for b in others
        )

    known = causes.known_rows()
    held_out = set().union(*(flights(r, r.flights) for r in known if r.half == "heldout"))
    assert len(held_out) > 20
    for r in known:
        own, reference = flights(r, r.flights), flights(r, r.reference)
        if r.half == "development":
            assert not meet(own | reference, held_out), r.name
        if r.reference_above is None:  # otherwise the same flights, cut by height
            assert not meet(own, reference), r.name


def effect(name, members, sure=True, **parameters):
    estimates = {k: SimpleNamespace(value=v, ci95=(low, high)) for k, (v, low, high) in parameters.items()}
    values = {k: p.value for k, p in estimates.items()}
    return SimpleNamespace(name=name, members=members, sure=sure, parameters=estimates, fitted={name: values})


def diagnosis(*effects, possible=(), verdict="effects", inconsistent=(), set_aside=()):
    one = [SimpleNamespace(flights=inconsistent)] if inconsistent else []
    aside = [SimpleNamespace(flight=name) for name in set_aside]
    return SimpleNamespace(
        effects=effects,
        possible=dict.fromkeys(possible, 0.3),
        verdict=verdict,
        inconsistent_flights=one,
        set_aside=aside,
    )


SENSOR = dataclasses.replace(ROW, kind="unknown", inconsistent=("b", "c"))


@pytest.mark.parametrize(
    ("row", "answer", "expected"),
    [
        # Sure and right by itself, or by a class that holds a right name; possible; wrong; flagged.
        (ROW, diagnosis(effect("mass", ["mass"])), (True, True, [], False)),
        (ROW, diagnosis(effect("thrust_bias", ["thrust_bias", "mass"])), (True, True, [], False)),
        (ROW, diagnosis(effect("mass", ["mass"], sure=False)), (False, True, [], False)),
        (ROW, diagnosis(possible=["mass"]), (False, True, [], False)),
        (ROW, diagnosis(effect("wind", ["wind"], sure=False)), (False, False, [], False)),
        # What goes with the cause is neither right nor wrong; anything else is wrong.
        (ROW, diagnosis(effect("attitude_trim", ["attitude_trim"])), (False, False, [], False)),
        (ROW, diagnosis(effect("wind", ["wind"])), (False, False, ["wind"], False)),
        (ROW, diagnosis(verdict="unknown"), (False, False, [], True)),
        # Flights that must be inconsistent, or set aside; in ROW there are none.
        (SENSOR, diagnosis(inconsistent=("data/b",), set_aside=("data/c",)), (False, False, [], True)),
        (SENSOR, diagnosis(inconsistent=("data/b", "data/a")), (False, False, [], False)),
        (ROW, diagnosis(inconsistent=("b",)), (False, False, [], False)),
    ],
)
def test_judgement(row, answer, expected):
    got = causes.judged(row, answer)
    assert (got["right sure"], got["right possible"], got["wrong"], got["flagged"]) == expected


def test_found_thrust_is_that_over_mass():
    vehicle = load_vehicle("crazyflie-2.1")
    told = dataclasses.replace(ROW, size={"of": "thrust", "value": 0.9, "tolerance": 0.02})
    scaled = effect("mass", ["mass"], scale=(1.25, 1.0, 1.6))
    got = causes._found(told, diagnosis(scaled), vehicle, vehicle.hover_pwm)
    # Specific thrust goes with 1/mass.
    assert got["value"] == pytest.approx(1 / 1.25)
    assert got["ci95"] == pytest.approx([1 / 1.6, 1.0])
    both = diagnosis(scaled, effect("thrust_scale", ["thrust_scale"], scale=(1.25, 1.2, 1.3)))
    assert causes._found(told, both, vehicle, vehicle.hover_pwm)["value"] == pytest.approx(1.0)
    assert causes._found(told, diagnosis(effect("wind", ["wind"])), vehicle, vehicle.hover_pwm) is None
    assert causes._found(ROW, diagnosis(scaled), vehicle, vehicle.hover_pwm) is None  # no size was told
