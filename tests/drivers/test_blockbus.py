"""The block bus works as an ordinary python-can bus, and transfers blocks fast."""

import threading

import can
import numpy as np
import pytest

from drivers.journal import FLAG_EXTENDED, FRAME


def open_pair(**options):
    return can.Bus(interface="blocks", channel="pair", **options), can.Bus(
        interface="blocks", channel="pair", **options
    )


@pytest.fixture
def pair():
    a, b = open_pair()
    yield a, b
    a.shutdown()
    b.shutdown()


def frames_of(*identifiers: int) -> np.ndarray:
    frames = np.zeros(len(identifiers), dtype=FRAME)
    frames["id"], frames["len"] = identifiers, 2
    frames["t_ns"] = 1_500_000_000
    return frames


def test_messages_arrive_as_they_were_sent(pair):
    a, b = pair
    sent = [
        can.Message(arbitration_id=0x7FF, is_extended_id=False, data=b"12345678"),
        can.Message(arbitration_id=0x1FFFFFFF, is_extended_id=True, data=b""),
        can.Message(arbitration_id=5, is_extended_id=False, is_remote_frame=True, dlc=4),
        can.Message(is_error_frame=True),
    ]
    for message in sent:
        a.send(message)
    for message in sent:
        got = b.recv(1.0)
        assert got.equals(message, timestamp_delta=None, check_channel=False, check_direction=False)
        assert got.timestamp > 1.6e9
    assert b.recv(0.0) is None
    assert a.recv(0.0) is None


def test_blocks_and_messages_mix_in_order(pair):
    a, b = pair
    a.send_block(frames_of(1, 2, 3))
    a.send(can.Message(arbitration_id=4))
    assert b.recv(0.0).arbitration_id == 1
    assert b.recv_block()["id"].tolist() == [2, 3, 4]
    assert len(b.recv_block()) == 0
    a.send_block(frames_of(5))
    assert b.recv(0.0).timestamp == 1.5


def test_the_sender_may_use_its_array_again(pair):
    a, b = pair
    frames = frames_of(1)
    a.send_block(frames)
    frames["id"] = 9
    assert b.recv_block()["id"].tolist() == [1]


def test_filters_apply_to_both_ways_of_receiving(pair):
    a, b = pair
    b.set_filters([{"can_id": 0x10, "can_mask": 0x7F0, "extended": False}])
    frames = frames_of(0x11, 0x20, 0x12, 0x13)
    frames["flags"][3] = FLAG_EXTENDED
    a.send_block(frames)
    assert b.recv_block()["id"].tolist() == [0x11, 0x12]
    a.send_block(frames)
    assert [message.arbitration_id for message in iter(lambda: b.recv(0.01), None)] == [0x11, 0x12]


def test_own_messages_come_back_on_request():
    a, b = open_pair(receive_own_messages=True, preserve_timestamps=True)
    with a, b:
        a.send(can.Message(arbitration_id=1, timestamp=2.5))
        assert (a.recv(0.0).timestamp, b.recv(0.0).timestamp) == (2.5, 2.5)


def test_recv_waits_for_another_thread(pair):
    a, b = pair
    thread = threading.Thread(target=lambda: a.send(can.Message(arbitration_id=7)))
    thread.start()
    assert b.recv(10.0).arbitration_id == 7
    thread.join()


def test_a_notifier_works(pair):
    a, b = pair
    reader = can.BufferedReader()
    notifier = can.Notifier(b, [reader], timeout=0.01)
    a.send(can.Message(arbitration_id=3))
    assert reader.get_message(10.0).arbitration_id == 3
    notifier.stop()


def test_a_closed_bus_and_can_fd_are_refused(pair):
    a, b = pair
    with pytest.raises(can.CanOperationError, match="classical"):
        a.send(can.Message(is_fd=True, data=bytes(12)))
    b.shutdown()
    for use in (lambda: b.recv(0.0), lambda: b.send(can.Message()), b.recv_block):
        with pytest.raises(can.CanOperationError, match="closed"):
            use()


def test_a_closed_bus_receives_nothing_more(pair):
    a, b = pair
    b.shutdown()
    a.send_block(frames_of(1))
    assert not b._blocks
