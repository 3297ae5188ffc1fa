"""What stands in a file, format by format, handed on unjudged as a `RawTake`."""
