"""The artifact folders that are also the cache: content-addressed, published whole, verified on use."""
