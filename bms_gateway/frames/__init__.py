"""Bytes on the bus and quantities of the pack."""
