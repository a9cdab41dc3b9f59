"""The judge of the campaign sees what it is there to see."""

import tomllib

import pytest

from inclined_landing.models.errors import UserError
from tests.campaign.judge import (
    EVIL,
    Case,
    Wrong,
    command,
    judge,
    mutations,
    parametrised,
    spoilt,
    toml,
    write,
)


def refuse(path):
    raise UserError(f"file {path} is wrong")


def crash(path):
    raise KeyError("x")


def leave_behind(path):
    write(path.with_name("part"), "x")
    refuse(path)


def change(path):
    write(path, "y")
    refuse(path)


def name_nothing(path):
    raise UserError("something is wrong")


def talk(path):
    raise UserError(f"file {path} is wrong" + " and wrong" * 40)


def take_gigabytes(path):
    return bytearray(2**33)


def stop(path):
    return command(lambda arguments: print("wrong", arguments) or 1, [])


def talk_python(path):
    try:
        float(path.name)
    except ValueError as error:
        raise UserError(str(error)) from error


def case(take, **options):
    return Case("a", lambda folder: write(folder / "a.toml", "x"), take, **options)


def test_a_refusal_and_a_success_are_right(tmp_path):
    assert judge(case(refuse), tmp_path).endswith("a.toml is wrong")
    assert judge(case(lambda path: path.read_text()), tmp_path) == "works"


@pytest.mark.parametrize(
    "take", [crash, leave_behind, change, name_nothing, talk, take_gigabytes, stop, talk_python]
)
def test_everything_else_is_wrong(tmp_path, take):
    with pytest.raises(Wrong):
        judge(case(take), tmp_path)


def test_what_is_taken_must_work_and_in_time(tmp_path):
    def falls(result):
        raise Wrong("it falls")

    with pytest.raises(Wrong, match="it falls"):
        judge(case(str, works=falls), tmp_path)
    with pytest.raises(Wrong, match="took"):
        judge(case(lambda path: sum(range(10**6)), seconds=1e-3), tmp_path)


def test_values_mutations_and_spoilt_tables_are_what_they_say():
    for name, value in EVIL.items():
        read = tomllib.loads(f"a = {toml(value)}")["a"]
        assert read == value or "nan" in name
    good = b"0123456789" * 30
    found = {name: make() for name, make in mutations(good, 21)}
    assert len(found) == 21 and found == {name: make() for name, make in mutations(good, 21)}
    table = {"a": {"b": [1, 2]}, "c": 3}
    ways = {name: change(table) for name, change in spoilt(table)}
    assert table == {"a": {"b": [1, 2]}, "c": 3}
    assert ways["a.b.0 text"] == {"a": {"b": ["heavy", 2]}, "c": 3} and ways["a missing"] == {"c": 3}
    assert ways["a.unknown zero"] == {"a": {"b": [1, 2], "unknown": 0}, "c": 3}
    assert len(ways) == 6 * len(EVIL) + 4  # a, a.b, a.b.0, c can be missing; two more are unknown


def test_a_sample_is_a_matter_of_names_and_has_all_generators():
    def generator(first, count):
        return lambda: (Case(f"{first} {k}", lambda folder: folder, str) for k in range(count))

    def chosen(*generators):
        params = parametrised(*generators, each=3).args[1]
        return {param.id for param in params if not param.marks}

    few = chosen(generator("a", 100), generator("b", 2))
    assert len(few) == 5 and {"b 0", "b 1"} < few
    assert len(few & chosen(generator("b", 2), generator("a", 101))) >= 4
    with pytest.raises(AssertionError, match="two cases"):
        parametrised(generator("a", 2), generator("a", 2), each=1)
