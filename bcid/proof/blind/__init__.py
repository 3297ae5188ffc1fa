"""The blind test: takes that conceal effects, sealed answers, and what the diagnosis makes of them."""
