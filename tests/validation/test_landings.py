"""How answers to landings are counted; tests/eval/gap/test_touchdown.py flies some."""

from tests.validation.landings import CASES, rows


def name(members, sure):
    return {"class": members, "probability": 0.95, "sure": sure, "value": 1.0, "ci95": (0.9, 1.1)}


def test_sure_names_and_those_in_doubt_are_counted_apart():
    calls = [("springs", cause, size, (s, k)) for s in (1, 2) for k, (cause, size) in enumerate(CASES)]
    answers = [[] for _ in calls]
    soft, tilt = (CASES.index((cause, "strong")) for cause in ("soft_feet", "platform_tilt"))
    answers[soft] = [name(["foot_height", "contact_stiffness"], sure=False)]
    answers[soft + len(CASES)] = [name(["foot_height"], sure=True)]
    answers[tilt] = [name(["platform_tilt"], sure=True)]
    found = {row["hidden"]: row for row in rows(calls, answers)}
    counts = {key: found["soft_feet, strong"][key]["count"] for key in ("sure and alone", "among the names")}
    assert counts == {"sure and alone": 0, "among the names": 1}
    assert found["soft_feet, strong"]["sure names wrong"] == "1 of 1"
    assert found["platform_tilt, strong"]["sure and alone"]["count"] == 1
    assert found["nothing"]["no name"] == {**found["nothing"]["no name"], "count": 6, "of": 6}
