"""Calibration memory by UDS: read and write data by identifier, through `udsoncan` and `can-isotp`."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Callable
from typing import Any

from drivers import flash_objects
from drivers.coefficients import CoefficientStore
from drivers.errors import ConfigError, LinkError, RefusedError
from drivers.flash_objects import Memory
from drivers.unit_line import ANSWER_S, UnitLine

try:
    import isotp
    import udsoncan
    from udsoncan.client import Client
    from udsoncan.connections import BaseConnection
except ImportError as missing:
    raise ConfigError(f"protocol uds needs {missing.name}: pip install 'gyro-thermal-bench[flash]'") from None

PROGRAMMING = 2
HARD_RESET = 1
_MOST_WAIT_S = 10.0


class UdsStore(CoefficientStore):
    """A unit that receives on `request` and answers on `answer` (CAN identifiers, normal addressing)."""

    def __init__(self, line: UnitLine, request: int, answer: int) -> None:
        super().__init__(line)
        logging.getLogger("UdsClient").setLevel(logging.CRITICAL)  # we report its errors
        connection = _Connection(line, request, answer)
        config = dict(udsoncan.configs.default_client_config)
        config["data_identifiers"] = {entry.value.did: _Bytes for entry in Memory}
        config |= {"request_timeout": _MOST_WAIT_S, "p2_timeout": ANSWER_S, "p2_star_timeout": _MOST_WAIT_S}
        self._client = Client(connection, config=config)

    def get(self, what: Memory) -> bytes:
        """Read a value."""
        answer = self._ask(what.name, lambda: self._client.read_data_by_identifier(what.value.did))
        return bytes(answer.service_data.values[what.value.did])

    def set(self, what: Memory, data: bytes) -> None:
        """Write a value."""
        self._ask(what.name, lambda: self._client.write_data_by_identifier(what.value.did, data))

    def put_image(self, bank: int, image: bytes) -> None:
        """Write an image in one message, in the programming session."""
        self._ask("session", lambda: self._client.change_session(PROGRAMMING))
        self.set(flash_objects.bank(bank), image)

    def reset(self) -> None:
        """Request a hard ECU reset."""
        self._ask("reset", lambda: self._client.ecu_reset(HARD_RESET))

    def _ask(self, what: str, request: Callable[[], Any]) -> Any:
        try:
            return request()
        except udsoncan.exceptions.NegativeResponseException as error:
            response = error.response
            text = f"{self.line}: {what}: negative answer 0x{response.code:02X} ({response.code_name})"
            raise RefusedError(text, int(response.code)) from error
        except udsoncan.exceptions.TimeoutException as error:
            raise LinkError(f"{self.line}: {what}: no answer within {ANSWER_S:g} s") from error
        except (udsoncan.exceptions.UnexpectedResponseException, udsoncan.exceptions.InvalidResponseException) as error:
            raise LinkError(f"{self.line}: {what}: {' '.join(str(error).split())}") from error


class _Bytes(udsoncan.DidCodec):  # type: ignore[misc]
    """Values as raw bytes."""

    def encode(self, value: bytes) -> bytes:
        return value

    def decode(self, data: bytes) -> bytes:
        return data

    def __len__(self) -> int:
        raise udsoncan.DidCodec.ReadAllRemainingData


class _Connection(BaseConnection):  # type: ignore[misc]
    """ISO-TP on the line; it is processed only while a caller waits."""

    def __init__(self, line: UnitLine, request: int, answer: int) -> None:
        super().__init__("bench")
        self._line, self._request = line, request
        self._frames: deque[isotp.CanMessage] = deque()
        address = isotp.Address(isotp.AddressingMode.Normal_11bits, txid=request, rxid=answer)
        self._errors: list[str] = []
        self._layer = isotp.TransportLayerLogic(
            rxfn=lambda timeout: self._frames.popleft() if self._frames else None,
            txfn=lambda message: line.send(message.arbitration_id, bytes(message.data)),
            address=address,
            error_handler=lambda error: self._errors.append(str(error)),
            params={"blocking_send": False, "stmin": 0, "blocksize": 0},
        )
        line.listen(answer, lambda data: self._frames.append(isotp.CanMessage(answer, dlc=len(data), data=data)))

    def specific_send(self, payload: bytes, timeout: float | None = None) -> None:
        """Send a whole message."""
        self._errors.clear()
        self._layer.send(payload)
        self._layer.process()
        self._wait(lambda: not self._layer.transmitting(), _MOST_WAIT_S, "flow control")

    def specific_wait_frame(self, timeout: float | None = None) -> bytes:
        """The next whole message."""
        try:
            self._wait(self._layer.available, timeout or ANSWER_S, "answer")
        except LinkError as error:
            if self._line.deadline_s is not None and self._line.clock.now() >= self._line.deadline_s:
                raise
            raise udsoncan.exceptions.TimeoutException(str(error)) from error
        message = self._layer.recv()
        assert message is not None
        return bytes(message)

    def _wait(self, condition: Callable[[], bool], limit_s: float, what: str) -> None:
        def done() -> bool:
            self._layer.process()
            if self._errors:
                raise LinkError(f"{self._line}: ISO-TP: {self._errors[0]}")
            return condition()

        self._line.wait(done, limit_s, what)

    def open(self) -> _Connection:
        """Nothing to do: the line is open."""
        return self

    def close(self) -> None:
        """Nothing to do: the caller closes the line."""

    def empty_rxqueue(self) -> None:
        """Discard late frames."""
        self._frames.clear()
        self._layer.clear_rx_queue()

    def is_open(self) -> bool:
        """Always true."""
        return True
