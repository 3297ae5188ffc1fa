"""Faults on purpose: mutants of every kind of file, kills at random moments, flipped bits."""
