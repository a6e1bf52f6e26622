"""Colours of figures and charts, after Okabe and Ito; colour-blind readers can distinguish them."""

from typing import Final

BLACK: Final = "#000000"
BLUE: Final = "#0072b2"
VERMILLION: Final = "#d55e00"
SKY: Final = "#56b4e9"
GREY: Final = "#767676"
LIGHT: Final = "#b8b8b8"
