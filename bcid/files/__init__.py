"""Files of general formats, checked and written the same way everywhere.

TOML settings, JSON with a digest, Parquet with units; the digest of source code.
"""
