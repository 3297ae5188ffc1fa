"""Every hot path against its named peers, in one process, with interleaved repeats (`bcid bench`).

Speed: `run` (what is timed), `rollouts`, `filters`, `fits`, `reading` and `exports` (all beside their peers),
`timing` (in turns), `renewal` (some rows anew).  Peers: `car_in_c` and `c_code` (compiled on the way),
`car_in_arrays`, `networks`; `equations` (the car, written for them).  Accuracy: `accuracy` (on unseen takes) beside
`peers` (other libraries' models).
`parameters` counts how often stated intervals hold, `fleets` weighs what many logs cost; `limits` holds the goals.
"""
