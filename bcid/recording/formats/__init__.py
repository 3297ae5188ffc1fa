"""Readers, one `read_<format>` for each file format, which return a `RawTake` without judging it.

All: `detect` (the format of a file), `foreign` (formats that are not read), `raw` (what readers return), `floor` (poses
on the floor, by unit and vertical), `held_commands` (halves that come on their own), `names` (as they are shown).
Tables: `tables` and `commands_file` over `logged_table` (columns by name), `csv_table`, `table_head` (names, units),
`csv_text`, `csv_rows` and `csv_plain` (before cells are read; rows of plain numbers), `parquet_table`, `numbers` and
`stamps` (notations of cells).
Motive: `motive` and `motive_header`. MCAP: `mcap` over `mcap_poses` and `mcap_commands` (of a topic's messages),
`mcap_times` (one time base), `number_tables` and `fixed_layout` (numbers as arrays where messages are alike),
`mcap_contents` (wanted topics), `mcap_part` (of a cut), `mcap_records` (all records), `mcap_chunks`, `message_store`,
`message_decoding` and `ros_encoding` (JSON, ROS, protobuf), `message_fields` and `message_stamps` (what stands in a
message), `ros_messages` and `transforms` (known types), `rosbag` (a bag's folder).
All numbers that decide are in `limits`.
"""
