"""The judge of the campaign sees what it is there to see."""

import tomllib

import hypothesis.strategies as st
import pytest
from hypothesis import given

from inclined_landing.models.errors import UserError
from tests.campaign.judge import EVIL, Case, Wrong, command, damaged, examples, judge, spoilt, toml, write


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
    raise UserError(f"file {path.name} is wrong" + " and wrong" * 30)


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


def test_values_are_what_they_say():
    for name, value in EVIL.items():
        read = tomllib.loads(f"a = {toml(value)}")["a"]
        assert read == value or "nan" in name


@examples(5)
@given(data=st.data())
def test_damaged_files_and_spoilt_tables_are_what_they_say(data):
    good = b"0123456789" * 30
    _, make = data.draw(damaged(good))
    assert make() == make() and isinstance(make(), bytes)
    table = {"a": {"b": [1, 2]}, "c": 3}
    name, change = data.draw(spoilt(table))
    new = change(table)
    assert table == {"a": {"b": [1, 2]}, "c": 3} and (new != table or name.endswith("nan"))


def test_a_sample_is_the_same_each_time_and_differs_within_itself():
    def sample() -> list[str]:
        drawn = []

        @examples(4)
        @given(spoilt({"a": {"b": [1, 2]}, "c": 3}))
        def draw(chosen):
            drawn.append(chosen[0])

        draw()
        return drawn

    assert sample() == sample() and len(set(sample())) >= 3
