"""Readers, one `read_<format>` for each file format, which return a `RawTake` without judging it.

`detect` (the format of a file), `raw` (what all readers share), `tables` (CSV, Parquet), `csv_text` (CSV before its
cells are read), `motive` and `motive_header` (Motive exports), `mcap` over `mcap_contents` (wanted topics),
`mcap_records` (all records), `mcap_times` (one time base) and `ros_messages` (poses and commands in messages).
"""
