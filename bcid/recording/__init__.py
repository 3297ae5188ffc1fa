"""Recordings: one `read_<format>` each, all returning the immutable `Recording`."""
