"""Tests of the thermal room."""
