"""Questions to real recordings: a published model less one effect, controls, and edits with exact truth."""
