"""What a person brings, tables and logs, as records of one string: the paper's measured I, T_s, T_f."""
