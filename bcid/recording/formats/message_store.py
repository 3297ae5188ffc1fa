"""Messages of an MCAP file, held in few bytes until they are decoded."""

from array import array
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from bcid.aliases import Ints


class StoredMessages(NamedTuple):
    """N messages by number: their channels and log times (ns), and where each lies in the bytes of all."""

    channels: Ints
    log_ns: Ints
    begins: Ints
    ends: Ints
    content: memoryview

    def select(self, rows: Ints) -> "StoredMessages":
        """The messages of these numbers."""
        channels, log_ns, begins, ends = (x[rows] for x in self[:4])
        return StoredMessages(channels, log_ns, begins, ends, self.content)

    def data(self, row: int) -> bytes:
        """The bytes of one message."""
        return bytes(self.content[self.begins[row] : self.ends[row]])


class MessageStore:
    """Messages in file order: each its channel, its log time (ns) and its bytes, some 30 bytes beside these."""

    def __init__(self) -> None:
        """A store without messages."""
        self._channels, self._log_ns, self._ends = array("q"), array("Q"), array("q")
        self._content = bytearray()

    def __len__(self) -> int:
        """The number of messages."""
        return len(self._channels)

    def __iter__(self) -> Iterator[tuple[int, int, bytes]]:
        """Channel, log time (ns) and bytes of each message."""
        begin, content = 0, memoryview(self._content)
        for channel, log_ns, end in zip(self._channels, self._log_ns, self._ends, strict=True):
            yield channel, log_ns, bytes(content[begin:end])
            begin = end

    @property
    def channels(self) -> set[int]:
        """The channels that messages are of."""
        return set(np.unique(np.array(self._channels, dtype=np.int64)).tolist())

    @property
    def content_bytes(self) -> int:
        """The number of bytes of all messages."""
        return len(self._content)

    def add(self, channel: int, log_ns: int, data: bytes) -> None:
        """Add a message behind the others."""
        self._channels.append(channel)
        self._log_ns.append(log_ns)
        self._content += data
        self._ends.append(len(self._content))

    def add_all(self, channels: Ints, log_ns: Ints, contents: list[bytes]) -> None:
        """Add messages of these channels (N,), log times (N,) in ns, as unsigned numbers, and N `contents`."""
        sizes = np.fromiter(map(len, contents), dtype=np.int64, count=len(contents))
        self._channels.frombytes(channels.astype(np.int64).tobytes())
        self._log_ns.frombytes(log_ns.astype(np.uint64).tobytes())
        self._ends.frombytes((len(self._content) + np.cumsum(sizes)).tobytes())
        self._content += b"".join(contents)

    def of_channels(self, channels: set[int]) -> StoredMessages:
        """The messages of these channels, in file order."""
        ends = np.array(self._ends, dtype=np.int64)
        stored = StoredMessages(
            np.array(self._channels, dtype=np.int64), np.array(self._log_ns, dtype=np.uint64), np.r_[0, ends[:-1]],
            ends, memoryview(self._content),
        )  # fmt: skip
        return stored.select(np.flatnonzero(np.isin(stored.channels, list(channels))))

    def keep(self, channels: set[int]) -> None:
        """Drop the messages of all but these channels."""
        if self.channels <= channels:
            return
        kept = MessageStore()
        for channel, log_ns, data in self:
            if channel in channels:
                kept.add(channel, log_ns, data)
        self._channels, self._log_ns, self._ends = kept._channels, kept._log_ns, kept._ends
        self._content = kept._content
