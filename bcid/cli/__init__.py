"""The command line: thin commands over the pipeline, one place for output, one table of errors."""
