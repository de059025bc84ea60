"""The bus between processes loses nothing, keeps the order and reports when it is closed."""

import can
import numpy as np
import pytest

from drivers.journal import FRAME
from drivers.sim.loopcan import HELLO, Broker, LoopBus


@pytest.fixture
def broker():
    broker = Broker()
    yield broker
    broker.close()


def drain(bus: can.BusABC, count: int) -> list[can.Message]:
    messages = []
    while len(messages) < count and (message := bus.recv(10.0)) is not None:
        messages.append(message)
    return messages


def test_a_message_reaches_every_other_client_and_not_its_sender(broker):
    with LoopBus(broker.port) as a, LoopBus(f"127.0.0.1:{broker.port}") as b, LoopBus(broker.port) as c:
        a.send(can.Message(arbitration_id=0x1ABCDE, is_extended_id=True, data=b"\1\2\3"))
        for bus in (b, c):
            message = bus.recv(10.0)
            assert (message.arbitration_id, message.is_extended_id, bytes(message.data)) == (0x1ABCDE, True, b"\1\2\3")
            assert message.timestamp > 1.6e9
        assert a.recv(0.0) is None


def test_nothing_is_lost_and_order_is_kept(broker):
    with LoopBus(broker.port) as a, LoopBus(broker.port) as b:
        frames = np.zeros(30_000, dtype=FRAME)
        frames["id"], frames["len"] = 0x100, 4
        frames["data"][:, :4] = np.arange(len(frames), dtype="<u4").view(np.uint8).reshape(-1, 4)
        a.send_block(frames)
        received = [int.from_bytes(m.data, "little") for m in drain(b, len(frames))]
        assert received == list(range(len(frames)))


def test_time_stamps_of_the_sender_are_kept_on_request(broker):
    with LoopBus(broker.port, preserve_timestamps=True) as a, LoopBus(broker.port) as b:
        a.send(can.Message(arbitration_id=1, timestamp=12.5))
        assert b.recv(10.0).timestamp == 12.5


def test_filters_apply(broker):
    rule = {"can_id": 0x10, "can_mask": 0x7FF, "extended": False}
    with LoopBus(broker.port) as a, LoopBus(broker.port, can_filters=[rule]) as b:
        for identifier in (0x11, 0x10):
            a.send(can.Message(arbitration_id=identifier, is_extended_id=False))
        assert b.recv(10.0).arbitration_id == 0x10


def test_a_client_that_hangs_is_dropped_and_the_others_go_on(broker, monkeypatch):
    monkeypatch.setattr("drivers.sim.loopcan.MAX_BACKLOG", 1 << 20)
    with LoopBus(broker.port) as a, LoopBus(broker.port) as hung, LoopBus(broker.port) as b:
        frames = np.zeros(10_000, dtype=FRAME)
        for _ in range(60):  # 14 MB: more than the socket buffers and the allowed backlog
            a.send_block(frames)
            assert len(drain(b, len(frames))) == len(frames)
            if broker.dropped_clients:
                break
        assert broker.dropped_clients == 1
        with pytest.raises(can.CanOperationError, match=r"gone|closed"):
            list(iter(lambda: hung.recv(1.0), None))


def test_the_end_of_the_broker_is_an_error_to_its_clients(broker):
    with LoopBus(broker.port) as a:
        broker.close()
        with pytest.raises(can.CanOperationError, match=r"broker has closed|connection to the broker lost"):
            a.recv(10.0)


def test_no_broker_and_a_foreign_server_are_told_apart(broker):
    import socket

    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
        with socket.create_connection(("127.0.0.1", port)):
            pass
    with pytest.raises(can.CanInitializationError, match="no broker"):
        LoopBus(port)
    with pytest.raises(ValueError, match=r"must be a port on 127\.0\.0\.1"):
        LoopBus("192.168.1.5:4000")
    assert len(HELLO) == 8


def test_can_fd_is_refused(broker):
    with LoopBus(broker.port) as a, pytest.raises(can.CanOperationError, match="classical"):
        a.send(can.Message(is_fd=True, data=bytes(12)))


def test_a_bus_with_can_fd_carries_48_bytes_and_the_other_kind_of_client_is_refused(broker):
    fd = Broker(fd=True)
    data = bytes(range(48))
    with LoopBus(fd.port, fd=True) as a, LoopBus(fd.port, fd=True) as b:
        a.send(can.Message(arbitration_id=0x200, is_extended_id=False, is_fd=True, bitrate_switch=True, data=data))
        message = b.recv(10.0)
        assert (bytes(message.data), message.is_fd, message.bitrate_switch) == (data, True, True)
    with pytest.raises(can.CanInitializationError, match="one with CAN FD, state `fd: true`"):
        LoopBus(fd.port)
    with pytest.raises(can.CanInitializationError, match="is classical, remove `fd: true`"):
        LoopBus(broker.port, fd=True)
    fd.close()
