"""The blind test: takes that conceal effects, sealed answers, their diagnoses, and other methods on the same takes."""
