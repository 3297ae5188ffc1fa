"""The compiler and vectors of numbers.

`njit` (numba, each function compiled once), `late_code` (machine code made of whole kernels only), `kernel_cache` and
`kernel_key` (kept on disk under what a kernel names), `rebuild` (one text compiled more than once); `lanes`,
`lane_access` (vectors).
"""
