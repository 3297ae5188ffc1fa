"""Files checked and written in one way: TOML settings, JSON with a digest, Parquet with units, source code."""
