"""Readers, one `read_<format>` for each file format, which return a `RawTake` without judging it."""
