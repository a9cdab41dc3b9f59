"""Policy files: the exported C takes those that fit, answers as their policy, and refuses all others."""

import copy
import dataclasses
import functools
import hashlib
import itertools
import struct
import subprocess
from pathlib import Path

import hypothesis
import hypothesis.strategies as st
import numpy as np
import pytest

from inclined_landing.envs.policy import SHIPPED
from inclined_landing.eval.export import c_source, compiled, contract, policy_file, vectors
from inclined_landing.eval.export.network import Network
from inclined_landing.eval.export.policy_file import HASH, HEADER, SUBJECTS, WORDS, Answer
from inclined_landing.models.errors import UserError
from tests.policies import about_another_hover

pytestmark = pytest.mark.skipif(compiled.compiler() is None, reason="no C compiler on this machine")
PLAIN, LONG = "landing-nominal", "landing"  # which is given past steps too
HERE = Path(__file__).with_name("firmware")


@dataclasses.dataclass
class Made:
    """A policy with everything that its policy file is made of."""

    policy: object
    network: Network
    terms: dict
    tested: vectors.Vectors

    @property
    def vehicle(self):
        return self.policy.task.vehicle

    def file(self, terms=None, vehicle=None, **changes):
        network = dataclasses.replace(self.network, **changes)
        return policy_file.encode(terms or self.terms, vehicle or self.vehicle, network, self.tested)

    def export(self, folder):
        """Write the C source of another policy of the same contract: one whose last layer is negated."""
        weights, biases = [*self.network.weights], [*self.network.biases]
        weights[-1], biases[-1] = -weights[-1], -biases[-1]
        network = dataclasses.replace(self.network, weights=tuple(weights), biases=tuple(biases))
        c_source.write(folder, self.policy.task, network, self.terms, self.tested)
        return folder


@functools.cache
def made(name):
    policy = contract.load(name).with_fixed_vehicle()
    network = Network.from_policy(policy)
    return Made(policy, network, contract.describe(policy, network), vectors.record(policy))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return made(PLAIN).export(tmp_path_factory.mktemp("landing"))


@pytest.fixture
def library(folder, tmp_path):
    return compiled.Library(folder, tmp_path, "-O1")


@pytest.fixture(scope="module")
def kept(folder, tmp_path_factory):
    """One library for all examples of a test, with the landing policy loaded."""
    library = compiled.Library(folder, tmp_path_factory.mktemp("kept"), "-O1")
    assert library.load(made(PLAIN).file()) == Answer.OK
    return library


def sealed(content):
    """A file of this content with its size and SHA-256 put right."""
    content = content[:12] + struct.pack("<I", len(content) + HASH) + content[16:]
    return content + hashlib.sha256(content).digest()


def offsets(file):
    """Where in a file the contract's text begins, and where the numbers do."""
    text, layers = struct.unpack_from("<I", file, 16)[0], struct.unpack_from("<I", file, 36)[0]
    return HEADER + 4 * layers, HEADER + 4 * layers + text


def some_inputs(policy, count=200):
    rng = np.random.default_rng(2)
    inputs = policy.centre + 2.0 * policy.scale * rng.normal(size=(count, len(policy.centre)))
    return inputs.astype(np.float32)


@pytest.mark.parametrize("name", SHIPPED)
def test_a_loaded_policy_answers_as_the_policy(name, tmp_path):
    """In place of another one; sums of float32 through three layers differ by some 1e-6."""
    one = made(name)
    inputs, actions = some_inputs(one.policy), len(one.terms["action"])
    (tmp_path / "c").mkdir()
    library = compiled.Library(one.export(tmp_path / "c"), tmp_path, "-O1")
    before = library.infer_loaded(inputs, actions)
    np.testing.assert_array_equal(before, library.infer(inputs, actions))
    wanted = one.policy.predict(inputs)
    assert np.abs(before - wanted).max() > 0.5
    assert library.load(one.file()) == Answer.OK
    np.testing.assert_allclose(
        library.infer_loaded(inputs, actions), wanted, rtol=0.0, atol=vectors.TOLERANCE
    )
    np.testing.assert_array_equal(library.infer(inputs, actions), before)  # the compiled one is still there


def test_what_is_trained_on_another_model_of_the_vehicle_is_taken(library, tmp_path):
    """Other hover PWM, other widths, another activation: they come with the file. In either order."""
    for name in (about_another_hover(PLAIN, tmp_path), PLAIN):
        assert library.load(made(name).file()) == Answer.OK
        inputs = some_inputs(made(name).policy)
        wanted = made(name).policy.predict(inputs)
        np.testing.assert_allclose(library.infer_loaded(inputs, 2), wanted, rtol=0.0, atol=vectors.TOLERANCE)
    one, rng = made(PLAIN), np.random.default_rng(3)
    sizes = [5, 7, 64, 3, 2]
    other = dataclasses.replace(
        one.policy,
        weights=tuple(rng.normal(size=pair) for pair in itertools.pairwise(sizes)),
        biases=tuple(rng.normal(size=n) for n in sizes[1:]),
        activation="ReLU",
        squashed=True,
        bound=2.0,
        limit=1.5,
    )
    network, inputs = Network.from_policy(other), some_inputs(other)
    tested = vectors.sequence(other, np.zeros((8, 13)), inputs[:8])
    terms = contract.describe(other, network)
    assert library.load(policy_file.encode(terms, one.vehicle, network, tested)) == Answer.OK
    np.testing.assert_allclose(
        library.infer_loaded(inputs, 2), other.predict(inputs), rtol=0.0, atol=vectors.TOLERANCE
    )


def test_files_of_every_length_of_the_last_block_are_hashed(folder, tmp_path):
    """More line ends after the contract change nothing but the size."""
    library = compiled.Library(folder, tmp_path, "-DLANDING_POLICY_FILE_LARGEST=65536")
    file = made(PLAIN).file()
    text, numbers = offsets(file)
    for k in range(0, 64, 4):
        longer = file[:16] + struct.pack("<I", numbers - text + k) + file[20:numbers] + b"\n" * k
        longer = sealed(longer + file[numbers:-HASH])
        assert library.load(longer) == Answer.OK
        assert library.load(longer[:-1] + bytes([longer[-1] ^ 1])) == Answer.CORRUPT
    with_word = file[:16] + struct.pack("<I", numbers - text + 4) + file[20:numbers] + b"hi!\n"
    assert library.load(sealed(with_word + file[numbers:-HASH])) == Answer.VERSION


def stays(library):
    """The loaded policy acts as before."""
    inputs = some_inputs(made(PLAIN).policy, 5)
    reply = library.receive(b"\3" + made(PLAIN).file()[-HASH:][:2], False)
    assert reply[8:] == made(PLAIN).file()[-HASH:][:8]
    np.testing.assert_allclose(
        library.infer_loaded(inputs, 2), made(PLAIN).policy.predict(inputs), rtol=0.0, atol=vectors.TOLERANCE
    )


@hypothesis.given(data=st.data())
def test_a_flipped_bit_anywhere_is_refused(kept, data):
    file = bytearray(made(PLAIN).file())
    numbers = offsets(bytes(file))[1]
    region = data.draw(
        st.sampled_from(
            [(0, HEADER), (HEADER, numbers), (numbers, len(file) - HASH), (len(file) - HASH, len(file))]
        )
    )
    k = data.draw(st.integers(region[0], region[1] - 1))
    file[k] ^= 1 << data.draw(st.integers(0, 7))
    wanted = (
        Answer.NO_POLICY
        if k < 8
        else Answer.VERSION
        if k < 12
        else Answer.LENGTH
        if k < 16
        else Answer.CORRUPT
    )
    assert kept.load(bytes(file)) == wanted
    stays(kept)
    with pytest.raises(UserError):
        policy_file.check(bytes(file), "it")


@hypothesis.given(length=st.integers(0, 21_000))
def test_a_cut_or_continued_file_is_refused(kept, length):
    file = made(PLAIN).file()
    hypothesis.assume(length != len(file))
    other = file[:length] + b"\0" * (length - len(file))
    wanted = (
        Answer.NO_POLICY
        if length < 8
        else Answer.TOO_LARGE
        if length > -(-len(file) // 1024) * 1024
        else Answer.LENGTH
    )
    assert kept.load(other) == wanted
    stays(kept)
    with pytest.raises(UserError):
        policy_file.check(other, "it")


CHANGES = {
    "task": lambda terms: terms["task"].update(name="touchdown"),
    "slope": lambda terms: terms["task"].update(inclination=0.1),
    "goal": lambda terms: terms["task"]["goal_half_widths"].update(x=0.2),
    "arena": lambda terms: terms["arena"].update(z=[0.0, 3.0]),
    "period": lambda terms: terms.update(control_period=0.01),
    "observations": lambda terms: terms["observation"].reverse(),
    "history": lambda terms: terms["input"]["history"].update(steps=3),
    "actions": lambda terms: terms["action"][1].update(high=0.9),
}


@pytest.mark.parametrize("subject", SUBJECTS)
def test_another_contract_is_refused_by_what_differs(kept, subject):
    terms, one = copy.deepcopy(made(PLAIN).terms), made(PLAIN)
    vehicle = one.vehicle.changed(rotor_arm=0.0354) if subject == "vehicle" else None
    CHANGES.get(subject, lambda terms: None)(terms)
    answer = kept.load(one.file(terms, vehicle))
    assert Answer(answer).name == f"OTHER_{subject.upper()}"
    stays(kept)


def test_policies_of_another_kind_are_refused(folder, kept, tmp_path):
    assert kept.load(made(LONG).file()) == Answer.TOO_LARGE
    roomy = compiled.Library(folder, tmp_path, "-DLANDING_POLICY_FILE_LARGEST=65536")
    others = (LONG, "touchdown", "setpoint", "landing-steep", "landing-3d")
    said = [Answer(roomy.load(made(name).file())).name for name in others]
    # landing-steep and landing-3d observe the slope they are on.
    assert said == ["OTHER_HISTORY", "OTHER_TASK", "OTHER_TASK", "OTHER_SLOPE", "OTHER_SLOPE"]
    assert kept.load(made(PLAIN).file(), is_flying=True) == Answer.FLYING
    stays(kept)


def floats(values):
    return struct.pack(f"<{len(values)}f", *values)


def test_numbers_that_cannot_be_are_refused(kept):
    """Behind a hash that is right: somebody wrote such a file, nothing damaged it."""
    file = made(PLAIN).file()
    numbers = offsets(file)[1]
    scales = numbers + 4 * (2 * 2 + 5)
    places = {"limit": 24, "bound": 28, "centre": numbers, "scale": scales, "weight": scales + 4000}
    wrong = {name: [np.nan, np.inf, -np.inf] for name in places}
    wrong["limit"].append(-1.0)
    wrong["bound"].append(-1.0)
    wrong["centre"] += [9999.0, 60001.0]  # PWM that the limits would cut
    wrong["scale"] += [0.0, -1.0, 1e-40]
    for name, values in wrong.items():
        for value in values:
            k = places[name]
            assert kept.load(sealed(file[:k] + floats([value]) + file[k + 4 : -HASH])) == Answer.NUMBERS, name
    stays(kept)
    relu = made(PLAIN).file(activation="ReLU")  # max(NaN, 0) is 0: the self test would not see it
    k = scales + 4000
    assert kept.load(sealed(relu[:k] + floats([np.nan]) + relu[k + 4 : -HASH])) == Answer.NUMBERS


def test_another_network_behind_the_same_test_pairs_fails_the_self_test(kept):
    one = made(PLAIN)
    weights = list(one.network.weights)
    weights[1] = weights[1] + np.float32(0.01)
    assert kept.load(one.file(weights=tuple(weights))) == Answer.SELF_TEST
    assert kept.load(one.file(activation="ReLU")) == Answer.SELF_TEST
    file = one.file()
    last = len(file) - HASH - 4  # the last action of the last pair, off by twice what is allowed
    action = struct.unpack_from("<f", file, last)[0] + 2 * vectors.TOLERANCE
    assert kept.load(sealed(file[:last] + floats([action]))) == Answer.SELF_TEST
    stays(kept)


def test_layouts_without_room_are_refused(kept):
    one, file = made(PLAIN), made(PLAIN).file()
    word = lambda k, value: sealed(file[:k] + struct.pack("<I", value) + file[k + 4 : -HASH])  # noqa: E731
    for k, values in {
        16: (2, 2**31, 2**32 - 4),
        20: (4, 2**32 - 1),
        32: (0, 9, 65),
        36: (0, 1, 5, 2**30),
    }.items():
        for value in values:
            assert kept.load(word(k, value)) in (Answer.LAYOUT, Answer.OTHER_TASK, Answer.VERSION), (k, value)
    for value in (0, 65, 2**32 - 1):
        assert kept.load(word(HEADER, value)) == Answer.LAYOUT
    w, b = one.network.weights, one.network.biases
    wide = np.zeros((5, 65), np.float32), np.zeros((65, 2), np.float32)
    assert kept.load(one.file(weights=wide, biases=(np.zeros(65), b[2]))) == Answer.LAYOUT
    eye = np.eye(2, dtype=np.float32)
    deep = (w[0][:, :2], eye, eye, eye, eye), (b[0][:2], *[np.zeros(2, np.float32)] * 4)
    assert kept.load(one.file(weights=deep[0], biases=deep[1])) == Answer.LAYOUT
    stays(kept)


def test_whatever_the_bytes_nothing_undefined_happens(folder, tmp_path):
    """Some 1700 files with changed bytes and a right hash, under the compiler's sanitizers."""
    source = folder / "src"
    flags = ("-O1", "-fsanitize=address,undefined", "-fno-sanitize-recover=all", f"-I{source}")
    sources = [HERE / "files.c", source / "landing_policy.c", source / "landing_policy_file.c"]
    try:
        program = compiled.build(sources, tmp_path / "files", *flags)
    except UserError as error:
        pytest.skip(f"no sanitizer: {error}")
    rng, good = np.random.default_rng(0), made(PLAIN).file()
    numbers, files = offsets(good)[1], [b"", good]
    for _ in range(1500):
        content = bytearray(good[: rng.integers(0, len(good))] if rng.random() < 0.2 else good[:-HASH])
        for _ in range(rng.integers(1, 5)):
            limit = min(len(content), rng.choice([HEADER + 12, numbers, len(good)]))
            if limit:
                content[rng.integers(limit)] = rng.choice([0, 1, 127, 128, 255, rng.integers(256)])
        files.append(sealed(bytes(content)) if rng.random() < 0.9 else bytes(content))
    for length in range(16, 120):  # too short for what belongs into a file
        files.append(good[:12] + struct.pack("<I", length) + good[16:length])
        files.append(sealed(good[:length]))
    given = b"".join(struct.pack("<I", len(file)) + file for file in files)
    done = subprocess.run([program], input=given, capture_output=True)
    assert done.returncode == 0, done.stderr.decode()[-2000:]
    said = [Answer(int(line)) for line in done.stdout.split()]
    assert len(said) == len(files) and said[:2] == [Answer.NO_POLICY, Answer.OK]
    assert len({*said}) > 12 and said.count(Answer.OK) < 200  # some changes are harmless


def test_with_memory_for_one_file_the_compiled_policy_acts_meanwhile(folder, tmp_path):
    one = made(PLAIN)
    library = compiled.Library(folder, tmp_path, "-DLANDING_POLICY_FILE_COPIES=1")
    inputs = some_inputs(one.policy)
    compiled_ones = library.infer(inputs, 2)
    assert library.load(one.file()) == Answer.OK
    assert np.abs(library.infer_loaded(inputs, 2) - compiled_ones).max() > 0.5
    assert library.load(one.file()[:-1] + b"\0") == Answer.CORRUPT
    np.testing.assert_array_equal(library.infer_loaded(inputs, 2), compiled_ones)
    assert library.load(one.file()) == Answer.OK


def test_the_words_and_the_memory_of_the_source(folder):
    source = (folder / "src/landing_policy_file.c").read_text()
    assert [Answer[f"OTHER_{subject.upper()}"] for subject in SUBJECTS] == [*range(32, 32 + len(SUBJECTS))]
    assert set(WORDS) == set(Answer) and all(f'return "{words}";' in source for words in WORDS.values())
    for line in policy_file.contract_text(made(PLAIN).terms, made(PLAIN).vehicle).splitlines():
        assert f'"{line}\\n"' in source
    assert not [word for word in ("malloc", "free(", "calloc") if word in source]
