"""The figure of `stepgap fit`: predicted against actual errors of the nominal map in held-out steps."""

from collections.abc import Sequence
from io import BytesIO
from typing import Any

from matplotlib.figure import Figure

from stepgap.logs.fits.validation import Validation
from stepgap.report.drawing import BLACK, BLUE, VERMILLION, axis_label
from stepgap.step import Quantity

PANEL = 4.2  # Width and height of a panel [inches]

LOOKS: tuple[dict[str, Any], ...] = (
    {"color": VERMILLION, "marker": "x", "linestyle": "", "markersize": 4},
    {"color": BLUE, "marker": "o", "linestyle": "", "markersize": 3, "markerfacecolor": "none"},
)
"""Colours and markers of the residuals."""


def fit_picture(state: Sequence[Quantity], validation: Validation, form: str) -> bytes:
    """Draws predicted against actual errors of the nominal map, with a panel for each state coordinate.

    The figure, in one of `base.output_files.PICTURE_FORMATS`, shows the constant and the residual that predicts best.
    """
    drawn = [validation.held_out[kind] for kind in dict.fromkeys(("constant", validation.best.kind))]
    figure = Figure(figsize=(PANEL * len(state), PANEL + 0.5), layout="constrained")
    panels = figure.subplots(1, len(state), squeeze=False)[0]
    for index, (panel, quantity) in enumerate(zip(panels, state, strict=True)):
        for held_out, look in zip(drawn, LOOKS, strict=False):
            label = f"{held_out.kind}, fitted to other steps"
            panel.plot(held_out.error[:, index], held_out.mean[:, index], **look, label=label)
        panel.axline((0, 0), slope=1, color=BLACK, linewidth=0.8, label="predicted = actual")
        name = axis_label(quantity, capital=False)
        panel.set(xlabel=f"Actual error of {name}", ylabel=f"Predicted error of {name}")
        panel.spines[["top", "right"]].set_visible(False)
    figure.legend(*panels[0].get_legend_handles_labels(), loc="outside upper center", ncols=3, frameon=False)
    picture = BytesIO()
    figure.savefig(picture, format=form, dpi=150)
    return picture.getvalue()
