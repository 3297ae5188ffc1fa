"""Fitted models compared, closed loop, with takes that they have not seen."""
