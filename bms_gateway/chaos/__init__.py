"""Fault injection: simulated traffic, one fault at a time, and the reaction of the gateway as another node sees it."""
