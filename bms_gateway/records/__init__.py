"""Reads tables and logs of a user as records of one string: measured I, T_s and T_f of the paper."""
