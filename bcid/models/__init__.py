"""Vehicle models that predict the twist from commands; `bcid.models.table` lists them."""
