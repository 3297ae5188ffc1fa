"""Messages of an MCAP file, held in few bytes until they are decoded."""

from array import array
from collections.abc import Iterator


class MessageStore:
    """Messages in file order: each its channel, its log time (ns) and its bytes, some 30 bytes beside these."""

    def __init__(self) -> None:
        """A store without messages."""
        self._channels, self._log_ns, self._ends = array("L"), array("Q"), array("Q")
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
        return set(self._channels)

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
