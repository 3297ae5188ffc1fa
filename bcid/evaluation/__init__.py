"""Fitted models judged closed loop on takes that they have not seen."""
