"""Co-simulation: the C of a model in FMUs of FMI 2.0 and 3.0, with no Python at run time.

`description` (the XML), `fmu` (sources, compiled library, archive), `check_fmus` (validated and driven by fmpy).  In C:
`fmu-vehicle.h` (one vehicle, whatever the version), `fmu-fmi2.c`, `fmu-fmi3.c` and their interfaces; a name with a
hyphen is none that an exported model can have.
"""
