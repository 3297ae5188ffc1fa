"""The six vehicle models, one small module each; `bcid.models.table` lists them."""
