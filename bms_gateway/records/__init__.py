"""Tables and logs that a person brings, as records of one string: the paper's measured I, T_s, T_f."""
