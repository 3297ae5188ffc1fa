"""Every hot path against its named peer, in one process, with interleaved repeats (`bcid bench`)."""
