"""The trackers of the Table 1 of the paper, and peers, one file each."""
