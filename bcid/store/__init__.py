"""The store of artifacts: folders that are also the cache, keyed by content, published whole, verified on use.

`artifact` holds all of it; `receipt` is for results that lie in a folder of the user's without one.
"""
