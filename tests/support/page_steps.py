"""What a person sees of the page after a step."""

FIT_S = 300.0
ADDED = "+ reversible (entropic) heat (entropic_heat)"
"""What the step is called to which the effect was added that the packs hide."""


def seen_compared(page):
    page.wait("return document.querySelector('#cell-1')?.innerText.includes('K')", patience_s=FIT_S)
    page.wait("return Number(document.querySelector('#plot-core').dataset.traces) > 0", patience_s=FIT_S)


def seen_diagnosed(page):
    """Ask for a diagnosis, and wait for its verdict."""
    page.click("#tab-diagnose")
    page.click("#diagnose")
    page.wait("return document.querySelector('#panel-diagnose .verdict')", patience_s=FIT_S)


def seen_added(page):
    """Add the effect that the pack hides, and wait until nothing is at work any more."""
    page.idle(FIT_S)
    page.click("#tab-add")
    page.type("#effect-name", "entropic_heat")
    page.press("Enter")
    page.wait("return document.querySelectorAll('#panel-add .way li').length === 3", patience_s=FIT_S)
    page.idle(FIT_S)
