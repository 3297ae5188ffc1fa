"""bcid: from motion-capture logs of small ground vehicles to fitted planar models.

Data flows one way: recording -> estimate -> models -> evaluation -> report.  The equations live in
`bcid.physics` and `bcid.models`; everything that reads, writes or draws knows them, never the reverse.
"""

__version__ = "0.1.0"
