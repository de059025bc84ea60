"""Calibration memory by CANopen SDO, expedited or segmented, through `canopen`."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Literal

import canopen

from drivers import flash_objects
from drivers.coefficients import CoefficientStore
from drivers.errors import DriverError, LinkError, RefusedError
from drivers.flash_objects import NMT_RESET, SDO_ANSWER, SDO_REQUEST, Memory
from drivers.unit_line import ANSWER_S, UnitLine

_ABORT = 0x80
Transfer = Literal["segmented", "expedited"]


class CanopenStore(CoefficientStore):
    """Node `node`; an image is one segmented transfer, or word by word for a unit without segmented transfer."""

    def __init__(self, line: UnitLine, node: int, transfer: Transfer = "segmented") -> None:
        super().__init__(line)
        logging.getLogger("canopen").setLevel(logging.CRITICAL)  # we report its errors
        self._node, self._transfer = node, transfer
        self._answers = 0
        self._broken: DriverError | None = None  # canopen continues for a while after an error: the first one counts
        network = canopen.Network()
        network.send_message = self._send
        self._sdo = network.add_node(canopen.RemoteNode(node, canopen.ObjectDictionary())).sdo
        self._sdo.RESPONSE_TIMEOUT = 1e-3  # the waiting was done when the request was sent
        line.listen(SDO_ANSWER + node, self._on_answer)

    def get(self, what: Memory) -> bytes:
        """Read a value; the header of an image that is read word by word states its length."""
        if self._transfer == "expedited" and what.value.size == 0:
            return self._words(what.value.sub)
        with self._wire(what.name):
            return bytes(self._sdo.upload(what.value.index, what.value.sub))

    def set(self, what: Memory, data: bytes) -> None:
        """Write a value, expedited."""
        with self._wire(what.name):
            self._sdo.download(what.value.index, what.value.sub, data)

    def put_image(self, bank: int, image: bytes) -> None:
        """Write an image."""
        with self._wire(f"bank {bank}"):
            if self._transfer == "segmented":
                what = flash_objects.bank(bank).value
                self._sdo.download(what.index, what.sub, image, force_segment=True)
                return
            for word in range(len(image) // 4):
                self._sdo.download(*flash_objects.word_object(bank, word), image[4 * word : 4 * word + 4])

    def reset(self) -> None:
        """Send NMT reset node."""
        self.line.send(0, bytes([NMT_RESET, self._node]))

    def _words(self, bank: int) -> bytes:
        with self._wire(f"bank {bank}"):
            head = b"".join(self._sdo.upload(*flash_objects.word_object(bank, word)) for word in range(4))
            words = int.from_bytes(head[12:], "little")
            if not 4 < words <= flash_objects.BANK_BYTES // 4:
                return b""
            rest = (self._sdo.upload(*flash_objects.word_object(bank, word)) for word in range(4, words))
            return head + b"".join(rest)

    def _send(self, identifier: int, data: bytes, remote: bool = False) -> None:
        """Send a request and wait for its answer, so that canopen finds it at once."""
        before = self._answers
        if self._broken is not None:
            raise self._broken
        try:
            self.line.send(identifier, bytes(data))
            if identifier == SDO_REQUEST + self._node and data[0] != _ABORT:
                self.line.wait(lambda: self._answers > before, ANSWER_S, f"answer of node {self._node}")
        except DriverError as error:
            self._broken = error
            raise

    def _on_answer(self, data: bytes) -> None:
        self._answers += 1
        if data[:1] == bytes([_ABORT]) and len(data) == 8:
            error = canopen.SdoAbortedError(int.from_bytes(data[4:], "little"))
            self._broken = RefusedError(str(error), error.code)
        self._sdo.on_response(SDO_ANSWER + self._node, bytearray(data), self.line.clock.now())

    @contextmanager
    def _wire(self, what: str) -> Iterator[None]:
        self._broken = None
        try:
            yield
        except (canopen.SdoAbortedError, canopen.SdoCommunicationError, DriverError) as error:
            first = self._broken or error
            if isinstance(first, RefusedError):
                raise RefusedError(f"{self.line}: {what}: {first}", first.code) from error
            raise (first if isinstance(first, LinkError) else LinkError(f"{self.line}: {what}: {first}")) from error
