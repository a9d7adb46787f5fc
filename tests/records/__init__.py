"""Tests of bms_gateway.records."""
