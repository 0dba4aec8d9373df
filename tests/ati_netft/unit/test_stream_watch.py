"""When the stream is asked for again, second by second."""

import pytest

from crtk_driver_ati_netft.stream_watch import LONGEST_PAUSE, PATIENCE, StreamWatch

STEP = 0.01


class Story:
    """A watch, a clock, and a sensor that sends unless it was taken away or switched off."""

    def __init__(self) -> None:
        self.watch = StreamWatch()
        self.now = 100.0
        self.ours = False
        self.there = True
        self.held_up = False
        self.new_series = False
        self.asked: list[float] = []
        self.taken = 0

    def run(self, seconds: float) -> None:
        end = self.now + seconds
        while self.now < end - 1e-9:
            if self.ours and self.there and not self.held_up:
                self.taken += self.watch.heard(self.now, self.new_series)
                self.new_series = False
            if self.watch.due(self.now, self.now):
                self.asked.append(round(self.now - 100.0, 6))
                self.new_series = self.there and not self.held_up
                self.ours = self.ours if self.held_up else self.there
            self.now += STEP


@pytest.fixture
def story() -> Story:
    story = Story()
    story.watch.begin(story.now)
    return story


def test_a_stream_that_comes_is_asked_for_once(story) -> None:
    story.run(5.0)
    assert story.asked == [0.0]
    assert story.taken == 0


def test_nothing_is_asked_for_that_is_not_wanted() -> None:
    story = Story()
    story.run(1.0)
    assert story.asked == []


def test_silence_is_answered_with_growing_pauses(story) -> None:
    story.there = False
    story.run(10.0)
    gaps = [b - a for a, b in zip(story.asked, story.asked[1:], strict=False)]
    assert gaps == pytest.approx([0.1, 0.2, 0.4, 0.8, 1.6, 2.0, 2.0, 2.0], abs=STEP)


def test_a_sensor_that_was_away_was_not_taken(story) -> None:
    story.run(1.0)
    story.there = story.ours = False
    story.run(3.0)
    story.there = True
    story.run(3.0)
    assert story.ours
    assert story.taken == 0


def test_a_stream_that_is_back_at_the_first_request_was_taken(story) -> None:
    story.run(1.0)
    story.ours = False
    story.run(1.0)
    assert story.asked == pytest.approx([0.0, 1.0 + PATIENCE], abs=2 * STEP)
    assert story.taken == story.watch.takeovers == 1


def test_a_stream_that_was_held_up_was_not_taken(story) -> None:
    story.run(1.0)
    story.held_up = True
    story.run(PATIENCE + 2 * STEP)
    assert len(story.asked) == 2
    story.held_up = False
    story.run(1.0)
    assert story.taken == 0


def test_a_quarrel_is_not_fought_out(story) -> None:
    story.run(1.0)
    pauses = []
    for _ in range(8):
        lost = story.now
        story.ours = False
        while not story.ours:
            story.run(STEP)
        pauses.append(story.now - lost)
        story.run(0.5)
    assert pauses[0] == pytest.approx(PATIENCE, abs=3 * STEP)
    assert pauses[-1] == pytest.approx(LONGEST_PAUSE, abs=3 * STEP)
    assert pauses == sorted(pauses)
    story.run(30.0)
    story.ours = False
    lost = story.now
    story.run(5.0)
    assert story.asked[-1] + 100.0 - lost <= LONGEST_PAUSE + 3 * STEP
    story.run(30.0)
    lost, story.ours = story.now, False
    story.run(5.0)
    assert story.asked[-1] + 100.0 - lost == pytest.approx(PATIENCE, abs=3 * STEP)


def test_a_quarrel_goes_on_over_a_new_connection(story) -> None:
    story.run(1.0)
    for _ in range(8):
        story.ours = False
        story.run(3.0)
    before = story.taken
    story.ours = False
    lost = story.now
    story.run(0.6)
    story.watch.begin(story.now)  # given up, connected anew
    story.run(5.0)
    assert story.taken == before + 1
    assert story.asked[-1] + 100.0 - lost == pytest.approx(LONGEST_PAUSE, abs=3 * STEP)


def test_what_we_ended_ourselves_nobody_took(story) -> None:
    story.run(1.0)
    story.watch.end()
    story.ours = False
    story.run(3.0)
    assert story.asked == [0.0]
    story.watch.begin(story.now)
    story.run(1.0)
    assert len(story.asked) == 2
    story.watch.begin(story.now)  # again, while it runs: after setting a bias
    story.run(1.0)
    assert len(story.asked) == 3
    assert story.taken == 0
