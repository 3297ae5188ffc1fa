"""The vocabulary of missing physics: in each family's module the equations as compiled functions, and their entries."""
