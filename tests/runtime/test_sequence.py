"""Who publishes: the one that is heard, until it is silent; and no number leads astray."""

from hypothesis import given
from hypothesis import strategies as st

from downbeat.lcm_types.channels import CHANNELS
from downbeat.runtime.sequence import PublisherGuard, Verdict

STATE = CHANNELS["G1_LOW_STATE"]
T0 = 10**15


def judge(guard, messages):
    """[(epoch, seq, ms)] -> verdicts."""
    return [guard.judge(epoch, seq, T0 + ms * 1000)[0] for epoch, seq, ms in messages]


def test_second_publisher_never_takes_over_from_one_that_is_heard():
    messages = [m for k in range(50) for m in ((1, k, 2 * k), (2, k, 2 * k))]
    verdicts = judge(PublisherGuard(STATE), messages)
    assert verdicts[0::2] == [Verdict.GOOD] * 50
    assert verdicts[1::2] == [Verdict.FOREIGN] * 50


def test_successor_is_believed_once_the_first_is_silent():
    guard = PublisherGuard(STATE)
    assert judge(guard, [(1, 0, 0), (2, 0, 39)]) == [Verdict.GOOD, Verdict.FOREIGN]
    assert judge(guard, [(2, 1, 41), (1, 1, 42)]) == [Verdict.GOOD, Verdict.FOREIGN]


def test_newest_epoch_takes_over_an_event_channel_and_the_old_one_is_foreign():
    guard = PublisherGuard(CHANNELS["SKILL_REQUEST"])
    verdicts = judge(guard, [(1, 0, 0), (2, 0, 1), (1, 1, 2), (2, 1, 3)])
    assert verdicts == [Verdict.GOOD, Verdict.GOOD, Verdict.FOREIGN, Verdict.GOOD]


def test_anybody_may_publish_an_open_channel():
    guard = PublisherGuard(CHANNELS["HEARTBEAT"])
    verdicts = judge(guard, [(1, 0, 0), (2, 0, 1), (1, 1, 2), (2, 1, 3), (1, 1, 4)])
    assert verdicts == [Verdict.GOOD] * 4 + [Verdict.OLD]


def test_one_wild_sequence_number_is_dropped_and_forgotten():
    guard = PublisherGuard(STATE)
    verdicts = judge(guard, [(1, 5, 0), (1, 2**62, 2), (1, 6, 4), (1, 7, 6)])
    assert verdicts == [Verdict.GOOD, Verdict.LEAP, Verdict.GOOD, Verdict.GOOD]


def test_long_silence_is_no_wild_number_once_two_messages_agree():
    guard = PublisherGuard(STATE)
    far = 10_000_000
    verdicts = judge(guard, [(1, 5, 0), (1, far, 2), (1, far + 1, 4), (1, far + 2, 6)])
    assert verdicts == [Verdict.GOOD, Verdict.LEAP, Verdict.GOOD, Verdict.GOOD]


@given(st.lists(st.tuples(st.integers(0, 3), st.integers(0, 2**62), st.integers(0, 500))))
def test_what_is_good_is_always_newer_than_what_was_good(messages):
    guard = PublisherGuard(STATE)
    newest = {}
    for epoch, seq, ms in messages:
        verdict, lost = guard.judge(epoch, seq, T0 + ms * 1000)
        assert lost >= 0
        if verdict is Verdict.GOOD:
            assert seq > newest.get(epoch, -1)
            newest[epoch] = seq
