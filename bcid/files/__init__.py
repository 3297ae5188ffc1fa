"""Files checked and written in one way: TOML settings, JSON with a digest, Parquet with units, source code.

`toml`, `json`, `parquet`, one for each format; `regular` (what is read whole), `source_code` (digests of the code
that a stage runs), `outputs` (files that appear whole or not at all), `names` (what files can be called on
every system), `limits` (sizes).
"""
