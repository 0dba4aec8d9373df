"""Which reply is whose: order, gaps, doubled and foreign ones; and who is left out."""

from hypothesis import given
from hypothesis import strategies as st

from crtk_driver_dynamixel.framing import Status
from crtk_driver_dynamixel.groups import LEAVE_OUT_AFTER, Absences
from crtk_driver_dynamixel.matching import Matcher, Slot
from crtk_driver_dynamixel.replies import Failure, Reply

SLOTS = [Slot(id, 2, 13, 0.001) for id in (4, 2, 9)]


def status(id, value=0, error=0):
    return Status(id, error, False, bytes((id, value)))


def reply(id, value=0):
    return Reply(id, bytes((id, value)))


def silent(id):
    return Reply(id, None, failure=Failure.SILENT)


def placed(*statuses, slots=SLOTS):
    matcher = Matcher(slots)
    strays = [id for status in statuses for id in matcher.place(status)]
    return matcher, strays


def test_all_in_order():
    matcher, strays = placed(status(4), status(2), status(9))
    assert matcher.complete
    assert matcher.done
    assert matcher.replies(()) == [reply(4), reply(2), reply(9)]
    assert strays == []


def test_one_is_passed_over():
    matcher, _ = placed(status(4), status(9))
    assert matcher.done
    assert not matcher.complete
    assert matcher.replies(()) == [reply(4), silent(2), reply(9)]
    assert matcher.replies([2])[1].failure is Failure.CORRUPT


def test_one_lets_its_time_pass():
    matcher, _ = placed(status(4))
    assert matcher.at == matcher.answered == 1
    assert matcher.replies(()) == [reply(4), silent(2)]


def test_those_that_came_before_their_turn_are_taken_back():
    matcher, strays = placed(status(9, 1), status(4, 2), status(2, 2), status(9, 2))
    assert matcher.replies(()) == [reply(4, 2), reply(2, 2), reply(9, 2)]
    assert strays == [9]


def test_of_two_the_later_counts():
    matcher, strays = placed(status(4, 1), status(4, 2), status(2), status(9))
    assert matcher.replies(()) == [reply(4, 2), reply(2), reply(9)]
    assert strays == [4]


def test_foreign_ones_and_those_of_another_length_are_strays():
    matcher, strays = placed(status(7), Status(4, 0, False, b"abc"))
    assert strays == [7, 4]
    assert matcher.at == 0
    assert not matcher.place(status(4))


def test_an_error_number_is_an_answer_without_data():
    matcher, _ = placed(Status(4, 7, True, b""))
    assert matcher.replies(())[0] == Reply(4, None, 7, True, Failure.REFUSED)
    # Protocol 1.0: the value is there, whatever the angle limit says.
    matcher, _ = placed(Status(4, 2, False, b"ab"), slots=[Slot(4, 2, 8, 0.001, keeps_data=True)])
    assert matcher.replies(())[0] == Reply(4, b"ab", 2)
    matcher, _ = placed(Status(4, 2, False, b""), slots=[Slot(4, 0, 6, 0.001, keeps_data=True)])
    assert matcher.replies(())[0].failure is Failure.REFUSED


@given(st.lists(st.tuples(st.sampled_from([4, 2, 9, 7]), st.integers(0, 3)), max_size=8))
def test_whatever_comes_each_has_its_own(pairs):
    matcher = Matcher(SLOTS)
    count = sum(len(matcher.place(status(id, value))) for id, value in pairs)
    replies = matcher.replies(())
    answered = [r for r in replies if r.data is not None]
    assert len(answered) + count == len(pairs)
    for found, slot in zip(replies, SLOTS, strict=False):
        assert found.id == slot.id
        assert found.data is None or found.data[0] == slot.id


def test_absences():
    absences = Absences()
    quiet = [silent(1), reply(2)]
    for _ in range(LEAVE_OUT_AFTER - 1):
        assert not absences.note(quiet)
    assert not absences.none
    assert absences.note(quiet)
    assert absences.left_out == [1]
    left_out = Reply(1, None, failure=Failure.LEFT_OUT)
    assert not absences.note([left_out, reply(2)])
    assert absences.next() == 1
    assert not absences.note(quiet)
    assert absences.note([reply(1), reply(2)])
    assert absences.left_out == []
    assert absences.none


def test_absences_in_a_row_only():
    absences = Absences()
    for _ in range(2 * LEAVE_OUT_AFTER):
        assert not absences.note([silent(1)])
        assert not absences.note([Reply(1, None, failure=Failure.CORRUPT)])
    assert absences.left_out == []


def test_when_one_is_back_the_others_have_one_more_chance():
    absences = Absences()
    for _ in range(LEAVE_OUT_AFTER):
        absences.note([silent(1), silent(2), silent(3)])
    left_out = [Reply(id, None, failure=Failure.LEFT_OUT) for id in (1, 2)]
    assert absences.note([*left_out, reply(3)])
    assert absences.left_out == []
    assert absences.note([silent(1), reply(2), reply(3)])
    assert absences.left_out == [1]


def test_those_that_are_left_out_are_tried_in_turn():
    absences = Absences()
    for _ in range(LEAVE_OUT_AFTER):
        absences.note([silent(1), silent(2)])
    assert [absences.next() for _ in range(4)] == [1, 2, 1, 2]
