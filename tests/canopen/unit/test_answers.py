"""Which SYNC a TPDO answers, where frames are lost or held back."""

from crtk_driver_canopen.answers import KEPT, SyncAnswers

PERIOD = 0.01


def synced(answers: SyncAnswers, times: int = 1) -> None:
    for _ in range(times):
        answers.sync((answers.number + 1) * PERIOD)


def test_each_answer_is_to_the_sync_before_it() -> None:
    answers = SyncAnswers([1, 2])
    for number in range(1, 2 * KEPT):
        synced(answers)
        assert not answers.owing
        answers.take(0)
        answers.take(1)
        assert answers.time == number * PERIOD


def test_answers_held_back_from_the_beginning_are_old() -> None:
    answers = SyncAnswers([1])
    synced(answers, 2)
    for number in range(1, 100):
        synced(answers)
        answers.take(0)
        assert answers.time == number * PERIOD
        assert answers.owing == {1}


def test_the_stamp_is_that_of_the_drive_farthest_behind() -> None:
    answers = SyncAnswers([1, 2, None])
    synced(answers, 2)
    answers.take(0)
    answers.take(0)
    answers.take(1)
    assert answers.time == PERIOD


def test_a_lost_answer_is_owed_until_a_probe_is_answered() -> None:
    answers = SyncAnswers([1, 2])
    synced(answers, 2)
    for slot in (0, 1, 1):  # one of the first node is lost
        answers.take(slot)
    synced(answers)
    assert answers.owing == {1}
    answers.take(0)
    answers.take(1)
    assert answers.time == 2 * PERIOD
    answers.settle(1, 3)
    assert answers.time == 3 * PERIOD
    synced(answers)
    assert not answers.owing


def test_a_probe_held_back_too_settles_no_later_sync() -> None:
    answers = SyncAnswers([1])
    synced(answers, 3)
    asked = answers.number
    for _ in range(2):  # the answers to the first two are still on their way
        synced(answers)
        answers.take(0)
    answers.take(0)
    answers.settle(1, asked)
    assert answers.time == 3 * PERIOD
    assert answers.number == 5


def test_an_answer_that_comes_twice_is_to_no_later_sync() -> None:
    answers = SyncAnswers([1])
    synced(answers)
    answers.take(0)
    answers.take(0)
    synced(answers)
    assert answers.time == PERIOD


def test_a_silent_node_holds_nobody_up() -> None:
    answers = SyncAnswers([1, 2])
    for _ in range(5):  # the second one has started anew
        synced(answers)
        answers.take(0)
        answers.doubt({2})
        assert answers.time == answers.number * PERIOD
    synced(answers)
    answers.take(0)
    answers.take(1)
    assert answers.owing == {2}, "it may answer any of them"
    assert answers.time == 6 * PERIOD
    answers.settle(2, 6)
    assert not answers.owing
    synced(answers)
    answers.take(0)
    assert answers.time == 6 * PERIOD, "it counts again"


def test_nodes_that_are_all_silent_leave_old_samples() -> None:
    answers = SyncAnswers([1, 2])
    synced(answers)
    answers.take(0)
    answers.take(1)
    synced(answers, 3)
    answers.doubt({1, 2})
    assert answers.time == PERIOD
