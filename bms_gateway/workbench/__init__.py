"""The workbench: one local page on which a model is held against measurements, and a live page of the pack.

What the paper leaves to the reader, who sees in its figures where a model departs from a cell: here one sees it, asks
which effect is missing (beyond Lin et al., Eq 1 and 16-18), adds it and watches the error fall. The engine is that of
the commands; this room only shows it.

Two processes: a server that never computes (`server`, `desk`), so that the page stays alive and a cancelled job ends at
once, and per tab of the browser one that does (`worker`, `bench`). They talk in lines of JSON.
"""
