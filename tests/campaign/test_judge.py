"""The judge of the campaign sees what it is there to see."""

import pytest

from campaign.judge import EVIL, Case, Wrong, command, judge, mutations, process, toml, write
from inclined_landing.models.errors import UserError


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


def lines(path):
    code = f"import sys; print('{path.name}', 'is', sep='\\n', file=sys.stderr); sys.exit(2)"
    return process(["-c", code])


def case(take, **options):
    return Case("a", lambda folder: write(folder / "a.toml", "x"), take, **options)


def test_a_refusal_and_a_success_are_right(tmp_path):
    assert judge(case(refuse), tmp_path).endswith("a.toml is wrong")
    assert judge(case(lambda path: path.read_text()), tmp_path) == "works"


@pytest.mark.parametrize(
    "take", [crash, leave_behind, change, name_nothing, talk, take_gigabytes, stop, lines]
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


def test_values_and_mutations_are_what_they_say():
    import tomllib

    for name, value in EVIL.items():
        read = tomllib.loads(f"a = {toml(value)}")["a"]
        assert read == value or "nan" in name
    found = dict(mutations(b"0123456789" * 30, 21))
    assert len(found) == 21
    assert found == dict(mutations(b"0123456789" * 30, 21))
