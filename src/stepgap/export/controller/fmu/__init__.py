"""A learned controller as a Functional Mock-up Unit, FMI 2.0 or 3.0, with compiled C inside."""
