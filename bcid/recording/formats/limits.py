"""Limits of readers: what of a file is refused, read in another way or left out.

"Row N" is a row of docs/recordings.md, which says what becomes of a clean drive that is damaged in one way.  Units
are in the fields' names; ratios have none.
"""

from dataclasses import dataclass


@dataclass(frozen=True)
class TableLimits:
    """Limits on Motive exports and other tables."""

    # largest text that is read whole, as it holds more than plain numbers; not yet justified
    max_bytes: int = 1 << 30
    # rows that are held of a table, 5.8 h at 240 Hz: half a kilobyte each, so 2.5 GB (measure_memory)
    max_rows: int = 5_000_000
    # most columns: what spreadsheets hold, and five times what an export of fifty bodies with markers has
    max_columns: int = 16_384
    # longest text that may be a number or a stamp: a date with its zone has 35, a pair in a cell some 60
    max_cell_bytes: int = 200
    # share of rows with as many cells, from which a row with fewer was never written whole (row 47)
    min_equal_length_share: float = 0.98
    # largest difference of time and frame number; not yet justified
    max_time_error_periods: float = 0.5
    # difference of both by the digits of the Time column, that is allowed, too; not yet justified
    max_time_error_s: float = 1.1e-3
    # share of marker errors of exactly zero, below which those poses were interpolated (row 10)
    max_interpolated_share: float = 0.05
    # marker error that a pose which is no measurement passes (row 9: 80 mm)
    max_marker_error_m: float = 0.005
    # times the usual marker error, which a pose that is no measurement also passes (row 9)
    max_marker_error_factor: float = 5.0
    # angle that radians reach on both sides before they wrap, where Motive writes degrees (row 25)
    min_wrap_rad: float = 3.0


@dataclass(frozen=True)
class StampLimits:
    """Limits on the stamps of tables, in whatever notation."""

    # Unix time in September 2001: recordings are younger; seconds since a start are far smaller
    min_unix_s: float = 1e9
    # Unix time in 2099; a thousandfold of it, and so a count of ms, is no time in seconds of this age
    max_unix_s: float = 4.1e9
    # pause within which a clock that is set back by a day or an hour has passed midnight, or the end of summer time
    max_wrap_pause_s: float = 60.0


@dataclass(frozen=True)
class McapLimits:
    """Limits on MCAP files."""

    # largest record ("bombs" in docs/results/faults.json)
    max_record_bytes: int = 1 << 27
    # largest record that is no chunk, message or attachment: the counts of 65,536 channels take 0.7 MiB (test_mcap)
    max_declaration_bytes: int = 1 << 22
    # size that a chunk may always grow to ("bombs" in docs/results/faults.json)
    free_expansion_bytes: int = 1 << 24
    # times a larger chunk may grow ("bombs" in docs/results/faults.json)
    max_expansion_factor: int = 300
    # messages that any file may hold; more than its bytes are no recording (test_mcap: 4 million in 0.5 MB)
    free_messages: int = 1 << 16
    # messages that are held of the wanted topics: 2.4 h of poses at 240 Hz, of half a kilobyte each (measure_memory)
    max_messages: int = 1 << 21
    # bytes of these messages, which are held until they are decoded (test_broken_messages)
    max_content_bytes: int = 1 << 28
    # bytes of these messages that any file may hold: 20 minutes of poses in JSON (test_broken_messages)
    free_content_bytes: int = 1 << 25
    # times its size that a larger file may hold of them: real ones, whose numbers are noisy, hold 3 (a car at rest: 20)
    max_content_factor: int = 30
    # a stamp a century ahead is invalid (row 20)
    max_stamp_ns: float = float(1 << 62)
    # a plain number is a date in the smallest unit that puts it after March 1973 (row 71: s, ms, µs, ns)
    min_dated_ns: float = 1e17
    # span of stamps by that of log times, or its inverse, in the right unit: units are 1000 apart (test_message_stamps)
    max_span_ratio: float = 3.0
    # larger numbers are no time in any unit: years in ns (test_message_stamps: 1e400)
    max_plain_stamp: float = 1e30
    # a stamp of zero is invalid where the others begin later than a clock's start (row 20)
    min_unused_stamp_ns: float = 1e10
    # step of stamps against log times, from one message to the next, that is a clock jump (test_mcap_times: 3 s)
    max_clock_step_s: float = 0.1
    # steps of a burst: below this share of the mean (row 19)
    crowded_step: float = 0.2
    # share of such steps from which messages come in bursts (row 19)
    min_crowded_share: float = 0.1
    # fewest steps that show bursts: some seconds of poses (test_mcap_times)
    min_burst_steps: int = 20
    # messages over which their period is measured: longer than any burst (row 72)
    burst_window: int = 200
    # share by which the period is taken shorter, so that its error shifts nothing (test_mcap_times)
    period_margin: float = 1e-3
    # lateness of an arrival beyond which all stay as they are: longer than a network stalls (row 72: 0.4 s)
    max_late_s: float = 1.0
    # difference of a step from the period, in which sending is even (row 72)
    max_uneven_step: float = 0.2
    # share of even steps from which arrivals are put back to them (row 72; 2 % of the messages may be lost)
    min_even_share: float = 0.9
    # most messages of a frame whose name is misspelt (test_mcap_times: 1 of 200)
    max_rare_messages: int = 2
    # times as many messages of the body, from which that name is misspelt (test_mcap_times: 1 of 200)
    min_rare_ratio: int = 50


@dataclass(frozen=True)
class MessageLimits:
    """Limits on single messages and their definitions, checked before anything is built of them."""

    # longest message of a pose or command: 2,000 bodies of 128 bytes (test_broken_messages: a bomb is refused)
    max_message_bytes: int = 1 << 18
    # items of all lists in one message: more than any tracking system has bodies (test_broken_messages)
    max_list_items: int = 10_000
    # longest definition of a type: 50 times nav_msgs/Odometry's with all that it uses (test_broken_messages)
    max_definition_bytes: int = 1 << 18
    # types in a definition: 20 times those of nav_msgs/Odometry (test_broken_messages)
    max_definition_types: int = 200
    # types nested in each other: 6 times as deep as nav_msgs/Odometry's (test_broken_messages)
    max_definition_depth: int = 30
    # longest metadata.yaml: some 10,000 parts of a split bag; the parser reads no further (test_rosbag)
    max_metadata_bytes: int = 1 << 20


TABLE = TableLimits()
STAMP = StampLimits()
MCAP = McapLimits()
MESSAGE = MessageLimits()
