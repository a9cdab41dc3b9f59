"""The rules of the curricula, as their docstrings and the run's documentation state them."""

import dataclasses
import itertools
import math
from types import SimpleNamespace

import pytest
import torch

from inclined_landing.envs.tasks import landing, setpoint
from inclined_landing.models.base.errors import UserError
from inclined_landing.train import callbacks
from inclined_landing.train.config import TrainConfig
from inclined_landing.train.curriculum import (
    BOLD,
    FADING,
    LEAST_NOISE,
    PARTS,
    PATIENT,
    READY,
    USUAL,
    AdaptiveCurriculum,
    BalancedCurriculum,
    Curriculum,
    PaperCurriculum,
    make_curriculum,
)
from inclined_landing.train.ending import Ending
from inclined_landing.train.learner import Learner

TASK = landing.LandingConditions()  # what is evaluated


def episodes(curriculum, successes, failures=0, length=50):
    for k in range(successes + failures):
        curriculum.episode(k < successes, length)


def as_task(conditions: landing.LandingConditions) -> landing.LandingConditions:
    """Conditions without the training aids."""
    return dataclasses.replace(
        conditions,
        contact_limit=TASK.contact_limit,
        leave_limit=TASK.leave_limit,
        out_of_bounds_penalty=TASK.out_of_bounds_penalty,
        goal_while_touching=TASK.goal_while_touching,
        start_reach_z=TASK.start_reach_z,
    )


def at_level(level) -> landing.LandingConditions:
    curriculum = AdaptiveCurriculum()
    curriculum.level = level
    return curriculum.conditions()


# --- adaptive ----------------------------------------------------------------------------------------


def test_adaptive_begins_easy_and_ends_at_the_task():
    first = at_level(0.0)
    assert (first.start_reach, first.tilt, first.goal_size, first.platform) == (0.5, 0.0, 0.25, False)
    assert first.start_reach > first.goal_size  # a first stage inside the goal box teaches nothing
    last = at_level(1.0)
    assert dataclasses.replace(as_task(last), start_reach=3.3, goal_size=0.1) == TASK
    assert last.start_reach == pytest.approx(3.3) and last.goal_size == pytest.approx(0.1)
    # the aids of the MuJoCo plant
    assert last.contact_limit == 8 and last.leave_limit == 0.3 and not last.goal_while_touching


@pytest.mark.parametrize("level, reach, tilt, goal, platform", [
    (0.2, 1.2, 1 / 3, 0.25, 0.0), (0.25, 1.375, 0.25 / 0.6, 0.25, 0.0), (0.3, 1.55, 0.5, 0.25, 0.25),
    (0.4, 1.9, 2 / 3, 0.25, 0.75), (0.6, 2.6, 1.0, 0.20, 1.0), (0.8, 3.3, 1.0, 0.15, 1.0),
])  # fmt: skip
def test_adaptive_stages(level, reach, tilt, goal, platform):
    c = at_level(level)
    assert (c.start_reach, c.tilt, c.goal_size, c.platform) == pytest.approx((reach, tilt, goal, platform))


def test_difficulty_only_grows_with_the_level():
    levels = [at_level(k / 100) for k in range(101)]
    for a, b in itertools.pairwise(levels):
        assert b.start_reach >= a.start_reach and b.tilt >= a.tilt
        assert b.goal_size <= a.goal_size and b.platform >= a.platform
        # A tilt step larger than the angle tolerance would lose the policy at once.
        assert (b.tilt - a.tilt) * math.pi / 7 < 0.25 * b.goal_size


def test_the_gate_needs_a_full_window_above_its_rate():
    c = AdaptiveCurriculum(rules=USUAL._replace(floor=0.3), window=60, step=0.06, creep=0.003)
    episodes(c, 59)
    c.advance(1)
    assert c.level == 0.003  # not full yet: creep only
    episodes(c, 1)
    c.advance(2)
    assert c.level == pytest.approx(0.063)
    assert c.success == 0.0  # the window is emptied
    c.advance(3)
    assert c.level == pytest.approx(0.063)


@pytest.mark.parametrize("successes, level", [(0, 0.0), (24, 0.0), (25, 0.003), (42, 0.003), (43, 0.08)])
def test_floor_creep_and_gate(successes, level):
    c = AdaptiveCurriculum()
    episodes(c, successes, 60 - successes)
    c.advance(1)
    assert c.level == pytest.approx(level)


def test_a_failing_policy_is_led_back_as_far_as_it_takes():
    c = AdaptiveCurriculum()
    c.level = 0.5
    episodes(c, 24, 36)  # 40 %: the floor itself
    c.advance(0)
    assert c.level == pytest.approx(0.49)
    for k in range(10):
        episodes(c, 0, 20)
        c.advance(k)
    assert c.level == pytest.approx(0.39)
    for k in range(100):
        c.advance(k)
    assert c.level == 0.0


def test_episodes_solved_within_two_steps_do_not_count():
    c = AdaptiveCurriculum()
    episodes(c, 500, length=2)
    c.advance(1)
    assert c.level == 0.0 and c.success == 0.0
    episodes(c, 60, length=3)
    c.advance(2)
    assert c.level == pytest.approx(0.08)


def test_the_level_stops_at_one_and_the_learning_rate_falls_from_there():
    c = AdaptiveCurriculum(step=0.5)
    total = 1000
    for k in (1, 2):
        assert c.learning_rate_share(100 * k, total) == 1.0
        episodes(c, 60)
        c.advance(100 * k)
    assert c.level == 1.0 and c.learning_rate_share(200, total) == 1.0
    episodes(c, 60)
    c.advance(200)  # success at full difficulty
    assert c.learning_rate_share(200, total) == 1.0
    assert c.learning_rate_share(600, total) == pytest.approx(0.5)
    assert c.learning_rate_share(1000, total) == 0.0
    assert c.learning_rate_share(1100, total) == 0.0


def test_in_a_run_that_ends_by_success_the_learning_rate_settles_at_a_tenth():
    c = AdaptiveCurriculum(step=1.0)
    assert c.learning_rate_share(5_000_000, None) == 1.0
    for _ in range(2):  # to full difficulty, and success there
        episodes(c, 60)
        c.advance(100_000)
    shares = [c.learning_rate_share(100_000 + k * c.settling, None) for k in (0, 0.5, 1, 10)]
    assert shares == pytest.approx([1.0, 0.5, 0.1, 0.1])
    assert [c.may_plateau(100_000 + steps) for steps in (0, c.settling // 2, c.settling)] == [
        False,
        False,
        True,
    ]
    assert Curriculum(0.97).learning_rate_share(c.settling // 2, None) == pytest.approx(0.5)


# --- balanced ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("right, change", [(12, "step"), (11, "creep"), (7, "creep"), (6, None)])
def test_the_level_rises_with_success_from_both_sides_of_the_goal(right, change):
    """Of 30 from each side; more than 0.375 for a step, and 0.225 to creep."""
    c = BalancedCurriculum(0.98)
    c.level = 0.5
    for k in range(30):
        c.episode(k < 25, 50, start_x=-1.0)
        c.episode(k < right, 50, start_x=1.0)
    c.advance(0)
    assert c.level == pytest.approx(0.5 + (getattr(c, change) if change else 0.0))
    assert [len(x) for x in (c.left, c.right, c.recent)] == ([0, 0, 0] if change == "step" else [30, 30, 60])


def test_nothing_succeeding_leads_back_and_one_side_alone_does_not():
    c = BalancedCurriculum(0.98)
    c.level = 0.5
    for k in range(60):
        c.episode(k % 2 == 0, 50, start_x=-1.0 if k % 2 else 1.0)
    c.advance(0)
    assert c.level == 0.5
    for _ in range(60):
        c.episode(False, 50, start_x=1.0)
    c.advance(0)
    assert c.level == 0.5 - c.back


def test_the_learning_rate_follows_the_divergence_of_the_updates():
    c, model = BalancedCurriculum(0.98), SimpleNamespace(logger=SimpleNamespace(name_to_value={}))
    callback = callbacks.CurriculumCallback(c, None, 1e-3)
    callback.model = model
    model.get_env = lambda: SimpleNamespace(env_method=lambda *_: None)
    model.policy = SimpleNamespace(log_std=torch.nn.Parameter(torch.tensor([-3.0, 0.0])))
    for divergence, pace in (
        (0.05, 1 / 1.5),
        (0.02, 1 / 1.5),
        (0.05, 1 / 2.25),
        (1e-3, 1 / 1.5),
        (1e-3, 1.0),
        (1e-3, 1.0),
    ):
        model.logger.name_to_value["train/approx_kl"] = divergence
        callback._on_rollout_start()
        callback._apply()
        assert model.lr_schedule(1.0) == pytest.approx(1e-3 * pace)
    assert model.policy.log_std.exp().tolist() == pytest.approx([c.least_noise, 1.0])
    other = AdaptiveCurriculum()
    other.follow(1.0)
    assert other.pace == 1.0


def test_the_learning_rate_falls_with_the_steps_of_a_run_alone_and_success_is_waited_for_long():
    c = BalancedCurriculum(0.98)
    c.level, c.full_at = 1.0, 200_000
    later = [200_000 + k for k in (0, READY, PATIENT)]
    assert [c.learning_rate_share(steps, None) for steps in later] == [1.0, 1.0, 1.0]
    assert c.learning_rate_share(600_000, 1_000_000) == 0.5
    assert [c.is_ready(steps) for steps in later] == [False, True, True]
    assert [c.may_plateau(steps) for steps in later] == [False, False, True]


@pytest.mark.parametrize(
    "scores, explores",
    [
        ((0.93, 0.92, 0.94, 0.93), True),
        ((0.93, 0.92, 0.94), False),  # too few
        ((0.92, 0.93, 0.94, 0.96), False),  # still rising
        ((0.93, 0.95, 0.92, 0.987), False),  # close to 0.99
    ],
)
def test_noise_is_raised_where_success_has_stopped_rising(scores, explores):
    c = BalancedCurriculum(0.98)
    c.level = 1.0
    rows = [{"steps": 400_000 + k, "score": x, "score_varied": x} for k, x in enumerate(scores)]
    rows = [row | {"score_nominal": 1.0} for row in rows]
    ending = Ending(SimpleNamespace(success=0.99, randomise="robust"), 0, c, [], rows)
    assert ending.should_explore() == explores
    c.explore_again(400_003)
    assert not ending.should_explore()  # only later evaluations count
    noises = []
    for after in (0, FADING // 2, FADING, 2 * FADING):
        c.steps = 400_003 + after
        noises.append(c.least_noise)
    assert noises == pytest.approx([BOLD, (BOLD + LEAST_NOISE) / 2, LEAST_NOISE, LEAST_NOISE])
    other = AdaptiveCurriculum()
    other.explore_again(1)
    assert (other.least_noise, other.explored_at) == (0.0, 0)


def test_averaged_weights_are_lent_and_taken_back(tmp_path):
    config = TrainConfig(out=tmp_path / "a", curriculum="balanced", environments=2, steps=256).resolved()
    learner = Learner(config, {}, fresh=True)
    policy = learner.model.policy
    averaging = callbacks.Averaging(learner.averages)
    averaging.model = learner.model
    averaging._on_rollout_end()
    first = policy.action_net.bias.detach().clone()
    with torch.no_grad():
        policy.action_net.bias += 1.0
    averaging._on_rollout_end()
    with learner.averaged():
        torch.testing.assert_close(learner.model.policy.action_net.bias.detach(), first + 0.2)
        assert learner.model.policy.optimizer is policy.optimizer
    assert learner.model.policy is policy
    torch.testing.assert_close(policy.action_net.bias.detach(), first + 1.0)


# --- paper -------------------------------------------------------------------------------------------


def paper(episode_count=0, steps=0, tilting=0) -> PaperCurriculum:
    c = PaperCurriculum()
    c.restore(c.state() | {"episodes": episode_count, "steps": steps, "tilting_episodes": tilting})
    return c


@pytest.mark.parametrize("count, reach, reach_z, size", [
    (0, 0.2, 0.2, 0.25), (2500, 0.2 + 2.5 / 6, 0.2 + 1.875 / 6, 0.25), (5000, 0.2 + 5 / 6, 0.825, 0.175),
    (8000, 0.2 + 8 / 6, 1.2, 0.1), (12_000, 2.2, 1.2, 0.1), (18_600, 3.3, 1.2, 0.1), (40_000, 3.3, 1.2, 0.1),
])  # fmt: skip
def test_paper_starts_spread_and_the_goal_box_shrinks(count, reach, reach_z, size):
    c = paper(count).conditions()
    assert (c.start_reach, c.start_reach_z, c.goal_size) == pytest.approx((reach, reach_z, size))


def test_paper_tilt_begins_at_400_000_steps():
    c = PaperCurriculum()
    episodes(c, 1000)
    c.advance(399_999)
    episodes(c, 1000)
    assert c.conditions().tilt == 0.0
    c.advance(400_000)
    episodes(c, 0, 3000)
    assert c.conditions().tilt == 0.5


@pytest.mark.parametrize("steps, platform, gamma", [
    (0, False, 0.97), (400_000, False, 0.98), (799_999, False, 0.99), (800_000, True, 0.99),
    (3_000_000, True, 0.99),
])  # fmt: skip
def test_paper_platform_and_gamma(steps, platform, gamma):
    c = paper(steps=steps)
    assert c.conditions().platform == platform
    assert c.gamma(steps) == pytest.approx(gamma, abs=1e-6)


def test_the_paper_has_no_training_aids_and_a_constant_learning_rate():
    c = paper(30_000, 3_000_000, 9000)
    assert as_task(c.conditions()) == dataclasses.replace(TASK, lowest_start=1.0)
    assert c.conditions().contact_limit == 0 and c.conditions().goal_while_touching
    assert c.level == 1.0
    assert {c.learning_rate_share(k, 10) for k in range(11)} == {1.0}


# --- none and effort ---------------------------------------------------------------------------------


def test_no_curriculum_is_the_task_with_a_falling_learning_rate():
    c = make_curriculum("none", "landing", 0.98)
    assert as_task(c.conditions()) == TASK and c.gamma(0) == 0.98
    assert [c.learning_rate_share(k, 1000) for k in (0, 500, 1000, 2000)] == [1.0, 0.5, 0.0, 0.0]
    assert Curriculum(0.97).conditions() is None


def test_effort_eases_the_set_point_and_holds_the_learning_rate_for_60_percent():
    c = make_curriculum("effort", "setpoint", 0.97)
    conditions = c.conditions()
    assert conditions.effort_floor >= setpoint.EFFORT_FLOOR
    assert conditions.episode_limit <= setpoint.Setpoint.max_steps
    shares = [c.learning_rate_share(k, 1000) for k in (0, 600, 800, 1000)]
    assert shares == pytest.approx([1.0, 1.0, 0.5, 0.0])
    assert c.gamma(0) == 0.97


def test_touchdown_begins_without_a_price_of_impact_and_ends_at_the_task():
    curriculum = make_curriculum("touchdown", "touchdown", 0.99)
    first = curriculum.conditions()
    assert (
        first.impact_share == 0.0 and min(first.out_of_bounds_penalty, first.close, first.around_edge) > 0.0
    )
    assert first.friction == (0.5, 1.2)
    curriculum.advance(curriculum.RAMP)
    last = curriculum.conditions()
    assert curriculum.level == 1.0 and last.impact_share == 1.0 and last.close == 0.0
    again = make_curriculum("touchdown", "touchdown", 0.99)
    again.restore(curriculum.state())
    assert again.conditions() == last
    assert curriculum.learning_rate_share(0, 100) == 1.0 and curriculum.learning_rate_share(100, 100) == 0.0


# --- parts left out ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["adaptive", "fixed", "paper", "none"])
@pytest.mark.parametrize("part", list(PARTS))
def test_what_is_left_out_is_the_task_and_nothing_else_changes(name, part):
    whole, c = (make_curriculum(name, "landing", 0.98, without) for without in ("", part))
    for k in range(6):
        for one in (whole, c):
            episodes(one, 60)
            one.advance(30_000 * k)
        expected = {field: getattr(TASK, field) for field in PARTS[part]}
        assert c.conditions() == dataclasses.replace(whole.conditions(), **expected)
        assert c.level == whole.level and c.name == whole.name
        assert c.state() == whole.state() | {"_without": list(PARTS[part])}
        assert c.log() == whole.log() | {n: v for n, v in expected.items() if n in whole.log()}


@pytest.mark.parametrize("task, name, without", [
    ("landing", "adaptive", "slope"), ("landing", "adaptive", "tilt,,goal"), ("setpoint", "effort", "tilt"),
    ("setpoint", "none", "start"), ("landing", "adaptive", "tilt goal"),
])  # fmt: skip
def test_unknown_parts(task, name, without):
    with pytest.raises(UserError, match=f"--without: the curriculum {name} has no part"):
        make_curriculum(name, task, 0.98, without)


def test_the_discount_rises_as_in_the_paper_whatever_the_curriculum():
    c, whole = make_curriculum("adaptive", "landing", "paper"), make_curriculum("adaptive", "landing", 0.98)
    assert c.gamma(400_000) == pytest.approx(PaperCurriculum().gamma(400_000)) == pytest.approx(0.98)
    assert (c.gamma(0), c.gamma(10**7)) == pytest.approx((0.97, 0.99))
    assert c.conditions() == whole.conditions()


def test_the_fixed_schedule_has_the_adaptive_levels_by_steps_alone():
    c = make_curriculum("fixed", "landing", 0.98)
    for steps, level in ((0, 0.0), (c.RAMP // 2, 0.5), (c.RAMP, 1.0), (2 * c.RAMP, 1.0)):
        episodes(c, 0, 60)  # all fail
        c.advance(steps)
        assert c.level == pytest.approx(level, abs=1e-5)
        assert c.conditions() == at_level(c.level)
    assert c.learning_rate_share(10**6, None) == 1.0  # as nothing has succeeded at the task
    episodes(c, 60)
    c.advance(2 * c.RAMP)
    assert c.learning_rate_share(2 * c.RAMP + c.settling, None) == 0.1
