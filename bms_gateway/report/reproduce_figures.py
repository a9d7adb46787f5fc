"""Figures of a reproduction as PNG files."""

import importlib
from typing import Any, BinaryIO

import numpy as np

from bms_gateway.errors import MissingExtraError
from bms_gateway.reproduce import Figure, Panel

INCHES = (9.0, 3.2)
"""Width of a figure and height of one panel."""
DPI = 110
FEW = 12
COLOURS = ("#0b5394", "#cc4125", "#38761d", "#b45f06", "#674ea7", "#444444")


def drawing() -> Any:
    """Load matplotlib's figure module; its types are absent where it is.

    Raises
    ------
    MissingExtraError
        No matplotlib.
    """
    try:
        return importlib.import_module("matplotlib.figure")
    except ImportError:
        raise MissingExtraError("drawing figures (--out)", "report") from None


def draw(figure: Figure, file: BinaryIO) -> None:
    """Draw a figure as PNG into an open file.

    Raises
    ------
    MissingExtraError
        No matplotlib.
    OSError
        The file cannot be written.
    """
    _drawn(drawing(), figure).savefig(file, format="png", dpi=DPI)


def _drawn(module: Any, figure: Figure) -> Any:
    width, height = INCHES
    drawn = module.Figure(figsize=(width, height * len(figure.panels) + 0.4), layout="constrained")
    axes = drawn.subplots(len(figure.panels), 1, squeeze=False)[:, 0]
    drawn.suptitle(figure.title, fontsize=12)
    for ax, panel in zip(axes, figure.panels, strict=True):
        _fill(ax, panel)
    return drawn


def _fill(ax: Any, panel: Panel) -> None:
    for i, c in enumerate(panel.curves):
        ax.plot(c.x, c.y, c.style, color=COLOURS[i % len(COLOURS)], label=c.label, linewidth=1.3, markersize=5)
    if panel.level is not None:
        ax.axhline(panel.level, color="#999999", linewidth=0.8)
    if panel.limits is not None:
        ax.set_ylim(*panel.limits)
    ax.set_title(panel.title, fontsize=10)
    ax.set_xlabel(panel.x_label)
    ax.set_ylabel(panel.y_label)
    ax.grid(visible=True, color="#e4e4e4", linewidth=0.6)
    x = panel.curves[0].x
    if len(x) <= FEW and np.array_equal(x, np.rint(x)):
        ax.set_xticks(x)  # cells are counted in whole numbers
    if len(panel.curves) > 1:
        ax.legend(fontsize=8, loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)  # hides no curve
