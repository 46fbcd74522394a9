"""The trackers of Table 1 of the paper, and other software, one module each."""
