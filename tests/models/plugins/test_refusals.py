"""Models with wrong attributes or actuators of the plugins do not compile, and the sentence says why."""

import pytest

ATTRIBUTES = [
    *(("attitude", name, text, "") for text in ("0", "-1")
      for name in ("gain", "time_constant", "bandwidth", "yaw_gain", "yaw_bandwidth")),
    ("rotors", "lag_rate", "0", "greater than 0"),
    ("rotors", "state_gain", "-1", "at least 0"),
    ("rotors", "direct_gain", "-1", "at least 0"),
    ("rotors", "drag", "-1 -1 1", "at most 0"),
    ("rotors", "pwm_to_force", "1e-11 0 0", "at least 0, greater than 0, at least 0"),
    ("rotors", "pwm_to_speed", "-1 1", "at least 0"),
    ("rotors", "motors", "2.5", "a whole number"),
    ("rotors", "motors", "0", "a whole number"),
    ("rotors", "disc_radius", "0", "greater than 0"),
    ("rotors", "sag_reference", "0", "other than 0"),
    ("rotors", "spin_down", "-1", "greater than -1"),
    ("rotors", "body_drag", "-0.1", "at least 0"),
]  # fmt: skip


@pytest.mark.parametrize(("plugin", "attribute", "text", "rule"), ATTRIBUTES)
def test_wrong_attribute_is_refused_in_a_sentence(build, plugin, attribute, text, rule):
    with pytest.raises(ValueError, match=f"{plugin}: attribute '{attribute}' must be .*{rule}"):
        build(**{plugin: {attribute: text}})


SITES = '<site name="com"/><site name="tilted" euler="0 0 10"/><geom name="ball" size="0.1"/>'


@pytest.mark.parametrize(
    ("actuator", "changed", "sentence"),
    [
        ("roll", {"gear": "1 0 0 0 0 0"}, "gear of an actuator must be one rotational component"),
        ("roll", {"gear": "0 0 0 1 1 0"}, "gear of an actuator must be one rotational component"),
        ("roll", {"gear": "0 0 0 0 1 0"}, "must not drive the same axis"),
        ("roll", {"site": "other"}, "must act on one body"),
        ("roll", {"site": "tilted"}, "must have the axes of its body"),
        ("roll", {"actdim": "2"}, 'must have actdim="1" with the attribute'),
        ("roll", {"site": None, "joint": "hinge", "gear": "1"}, "'roll' must act on a site"),
        ("thrust", {"actdim": None}, 'must have actdim="1"'),
        ("thrust", {"actdim": "2"}, 'must have actdim="1", it has 2'),
        ("thrust", {"site": None, "joint": "hinge", "gear": "1"}, "'thrust' must act on a site"),
    ],
)
def test_wrong_actuator_is_refused_in_a_sentence(build, actuator, changed, sentence):
    names = ("thrust", "pitch", "roll")
    actuators = [build.actuator(name, **(changed if name == actuator else {})) for name in names]
    with pytest.raises(ValueError, match=sentence):
        build(actuators="".join(actuators), site=SITES)


@pytest.mark.parametrize(
    ("options", "sentence"),
    [
        ({"attitude": {"integral": "0.5"}}, "roll and pitch actuators must have actdim"),
        ({"rotors": {"lagrate": "1"}}, "unrecognized attribute 'plugin:lagrate'"),
        ({"rotors": {"ground_effect": "1"}}, "must be names of planes and boxes, there is none named"),
        ({"rotors": {"ground_effect": "1", "surfaces": "ball"}, "site": SITES}, "none named 'ball'"),
        ({"actuators": ["thrust"]}, "attitude: the instance must drive at least one actuator"),
        ({"actuators": ["roll"]}, "rotors: the instance must drive at least one actuator"),
    ],
)
def test_what_does_not_go_together_is_refused(build, options, sentence):
    if "actuators" in options:
        options = {"actuators": "".join(map(build.actuator, options["actuators"]))}
    with pytest.raises(ValueError, match=sentence):
        build(**options)
