"""Checks of streams and recordings: samples, attitude, tracking, plausibility, clock, mounting, contacts, health."""
