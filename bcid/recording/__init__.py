"""From log files to a `Recording`: `read`, over `assemble`, over `formats` (readers) and `checks`; `saving`."""
