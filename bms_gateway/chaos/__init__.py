"""Faults on purpose: simulated traffic, one thing broken at a time, and what a bystander sees of the gateway."""
