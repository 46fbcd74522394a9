"""Data sets, measures, tables and figures, section 4 of the paper."""
