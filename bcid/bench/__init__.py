"""Every hot path against its named peer, in one process, with interleaved repeats (`bcid bench`).

Speed: `run` (what is timed), `rollouts`, `fits` (both beside other libraries), `timing` (in turns), `equations` (the
car, written for the peers).  Accuracy: `accuracy` (on unseen takes) beside `peers` (other libraries' models).
`parameters` counts how often stated intervals hold; `limits` holds the goals.
"""
