"""Questions to real recordings: a published model without one of its effects, controls, and edits of known size."""
