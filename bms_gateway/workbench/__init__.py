"""The workbench: one local page on which a model is compared with measurements, and a live page of the pack.

In the paper, the reader sees in figures where a model differs from a cell. On this page, a user sees it, asks which
effect is missing (beyond Lin et al., Eq 1 and 16-18), adds the effect and watches the error fall. The engine is that of
the commands; this room only shows it.

There are two kinds of processes: a server that never computes (`server`, `desk`), so that the page always reacts and a
cancelled job ends at once, and one computing process per tab of the browser (`worker`, `bench`). They exchange lines of
JSON.
"""
