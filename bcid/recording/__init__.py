"""From log files to a `Recording`.

`cuts` (a recording as it is named, or a part of it) over `read` (any file, by its content), over `formats` (readers),
`checks` (of what they read) and `assemble` (the recording, with all irregularities counted); `measured_speed` (a
throttle that is one), `neighbours` (whose commands fit); `types` (the recording), `recorded_on` (when it was made),
`saving` (its files), `limits` (the numbers that decide on poses).
"""
