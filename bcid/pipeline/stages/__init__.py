"""The stages of the pipeline, one module each, so that a change of code makes only those stages anew that run it."""
