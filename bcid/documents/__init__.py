"""The JSON documents that bcid writes: one definition each, by which they are written, read and published as a schema.

`document` (what all have in common), `diagnosis` (diagnosis.json) with its `error_budget`, `model_card`
(model_card.json), `report` (report.json), `health` (`bcid ingest --check`), `prove` (prove.json), `prove_real`
(real.json), `varied_limits` (limits.json), `export` (NAME.json of an export), `fleet` (fleet.json), `adapt`
(adapt.json), `pool` (pool.json), `comparison` (`bcid compare`) and `manifest` (of an artifact); `schemas` publishes
them.
"""
