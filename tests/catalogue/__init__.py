"""Every row of the catalogue of bad input, made by code from one clean drive."""

from catalogue import damage, driven, headings, messages, poses, tables, texts, times, topics, units
from catalogue.rows import ROWS

__all__ = ["ROWS", "damage", "driven", "headings", "messages", "poses", "tables", "texts", "times", "topics", "units"]
