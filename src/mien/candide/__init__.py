"""The face model CANDIDE-3 (Ahlberg 2001), section 2 of the paper."""
