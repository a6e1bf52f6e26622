"""Numbers as text."""

import numpy as np


def decimal(value: float, digits: int = 3) -> str:
    """Number with a few significant digits, without exponent where possible; a dash for NaN."""
    if not np.isfinite(value):
        return "–"
    if value == 0:
        return "0"
    if 1e-6 < abs(value) < 1e6:
        decimals = digits - 1 - int(np.floor(np.log10(abs(value))))
        return f"{value:.{max(decimals, 0)}f}".replace("-", "−")
    return f"{value:.{digits}g}".replace("-", "−")
