"""A car to make logs with.  It shares no code with the models that explain them (import-linter guards it)."""
