"""A model as FMUs of the Functional Mock-up Interface 2.0 and 3.0, for co-simulation: its C, wrapped and compiled."""
