"""The vocabulary of missing physics: one short entry an effect, beside its equation."""
