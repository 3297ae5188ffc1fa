"""One module per stage, each with a `make(folder, ...)`; its import closure is the code its cache key covers."""
